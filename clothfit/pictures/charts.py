"""Charts of a motion and of a fit, drawn with matplotlib: energy, convergence, error over time."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import TYPE_CHECKING

import numpy as np

from clothfit.base.arrays import Array
from clothfit.base.messages import metres
from clothfit.control.control import ControlledMotion
from clothfit.motion.energy import Energy
from clothfit.pictures.camera import Camera
from clothfit.pictures.picture_file import BLUE, GREEN, GROUND, INK, ORANGE, PURPLE, QUIET, RED, SKY

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.axis import Axis

    from clothfit.optimise.progress import Progress

TITLE_PAD = 20.0  # points between a chart and its title: room for a legend
SMALLEST_LENGTH = 1e-15  # m: lengths below it are rounding, and a logarithmic axis omits them

MOST_LINES = 4
"""Keys of more times have one line together."""

LINES = (BLUE, ORANGE, PURPLE, SKY)

ENERGIES = (
    ("kinetic", ORANGE), ("elastic", BLUE), ("gravity", PURPLE), ("contact", SKY), ("total", INK),
    ("dissipated", RED),
)  # fmt: skip


def convergence(axes: Axes, history: Sequence[Progress]) -> None:
    """The error of the best point so far, over all frames and over the window where that is shorter; `history` is not
    empty.
    """
    from matplotlib.ticker import MaxNLocator

    label(axes, "convergence", "evaluations of the cost", "RMSE")
    x = np.array([one.evaluations for one in history], float)
    y = np.array([max(one.rmse, SMALLEST_LENGTH) for one in history])
    logarithmic(axes, y)
    part = [one for one in history if 0 < one.window < one.frames and one.window_rmse > SMALLEST_LENGTH]
    if part:
        axes.plot([one.evaluations for one in part], [one.window_rmse for one in part], ".", color=ORANGE, markersize=5,
                  label="in a window of fewer frames")  # fmt: skip
    axes.step(x, y, where="post", color=BLUE, linewidth=1.6, marker="o" if len(x) < 60 else "", markersize=3.5,
              label="best, all frames")  # fmt: skip
    axes.annotate(metres(float(y[-1])), (x[-1], y[-1]), xytext=(-4, 6), textcoords="offset points", fontsize=8,
                  color=INK, ha="right")  # fmt: skip
    if part:
        above(axes)
    if x[0] == x[-1]:
        axes.set_xlim(x[0] - 1.0, x[0] + 1.0)
    axes.xaxis.set_major_locator(MaxNLocator(integer=True))


def error(axes: Axes, times: Array, rmse: Array, largest: Array, fitted: float, horizon: float | None = None) -> None:
    """The error of each frame at `times` (F,), s: root mean square and largest, m.

    `fitted` and `horizon` are the ends, s, of the fitted frames and of a longer comparison.
    """
    errors(axes, "distance to the target", times, rmse, largest, SKY)
    axes.axvspan(float(times[0]), fitted, color=BLUE, alpha=0.07, linewidth=0, label="fitted frames", zorder=0)
    if horizon is not None:
        axes.axvline(horizon, color=RED, linestyle=(0, (5, 3)), linewidth=1.4, clip_on=False, label="horizon")
    above(axes)
    axes.set_xlim(float(times[0]), max(float(times[-1]), fitted) + 1e-9)


def errors(axes: Axes, title: str, times: Array, rmse: Array, largest: Array, colour: str) -> None:
    """Both lines of an error: root mean square, and largest in a colour."""
    label(axes, title, "time, s", "m")
    logarithmic(axes, np.concatenate([rmse, largest]))
    axes.plot(times, valid(largest), color=colour, linewidth=1.1, label="largest")
    axes.plot(times, valid(rmse), color=BLUE, linewidth=1.7, label="root mean square")


def distances(axes: Axes, motion: ControlledMotion) -> None:
    """How far a controlled motion is from each of its keys over time; of more than `MOST_LINES` from the next one."""
    label(axes, "distance from the keys", "time, s", "m")
    least = motion.distance[motion.distance > SMALLEST_LENGTH]
    logarithmic(axes, np.maximum(motion.distance, float(least.min()) if len(least) else 0.0))
    steps = np.array([key.step for key in motion.keys])
    if len(steps) > MOST_LINES:
        frames = np.arange(len(motion.times))
        coming = np.minimum(np.searchsorted(steps, frames), len(steps) - 1)
        axes.plot(motion.times, valid(motion.distance[coming, frames]), color=BLUE, linewidth=1.4, label="the next key")
    for key, values, colour in zip(motion.keys, motion.distance, LINES, strict=False):
        if len(steps) <= MOST_LINES:
            name = f"key at {motion.times[key.step]:.4g} s"
            axes.plot(motion.times, valid(values), color=colour, linewidth=1.6, label=name)
    at = [valid(values)[step] for values, step in zip(motion.distance, steps, strict=True)]
    axes.plot(motion.times[steps], at, "o", color=GREEN, markersize=5, zorder=4)
    due(axes, motion)


def effort(axes: Axes, motion: ControlledMotion) -> None:
    """What each step of a controlled motion takes."""
    label(axes, f"effort of each step, {motion.effort.sum():.4g} N² s in all", "time, s", "N² s")
    axes.stairs(motion.effort[:-1], motion.times, color=RED, fill=True, alpha=0.25)
    axes.stairs(motion.effort[:-1], motion.times, color=RED, linewidth=1.4, baseline=None)
    axes.set_ylim(0.0, 1.08 * float(motion.effort.max()) or 1.0)
    due(axes, motion, above_it=False)


def due(axes: Axes, motion: ControlledMotion, above_it: bool = True) -> None:
    """Lines at the times of the keys."""
    for i, time in enumerate(motion.times[motion.due]):
        axes.axvline(float(time), color=GREEN, linestyle=(0, (5, 3)), linewidth=1.1, zorder=1,
                     label="" if i or above_it else "keys")  # fmt: skip
    axes.set_xlim(float(motion.times[0]), 1.01 * float(motion.times[-1]) + 1e-9)
    above(axes)


def valid(values: Array) -> Array:
    """The values that a logarithmic axis can show; NaN in place of the others."""
    return np.where(values > SMALLEST_LENGTH, values, np.nan)


def above(axes: Axes) -> None:
    """Put the legend between the title and the chart."""
    axes.legend(fontsize=7.5, frameon=False, ncols=8, loc="lower left", bbox_to_anchor=(-0.01, 1.0), columnspacing=1.2,
                handlelength=1.4, borderaxespad=0.0, handletextpad=0.5)  # fmt: skip


def energies(axes: Axes, energy: Energy) -> None:
    """The energy at each frame, what has been dissipated, and the work of the wind."""
    label(axes, "energy", "time, s", "J")
    for name, colour in ENERGIES:
        values = getattr(energy, name)
        if np.abs(values).max() > 1e-12 * energy.scale:
            heavy = name == "total"
            axes.plot(energy.times, values, color=colour, linewidth=2.0 if heavy else 1.3, label=name, zorder=3 + heavy)
    if energy.wind.any():
        axes.plot(energy.times, energy.wind, color=GREEN, linewidth=1.3, linestyle=":", label="work of the wind")
    above(axes)
    axes.set_xlim(float(energy.times[0]), float(energy.times[-1]) + 1e-9)


def text(axes: Axes, title: str, lines: Sequence[str]) -> None:
    """Write some lines instead of a chart."""
    axes.set_axis_off()
    axes.set_title(title, loc="left", fontsize=10, color=INK, pad=TITLE_PAD)
    axes.text(0.0, 0.97, "\n".join(lines), transform=axes.transAxes, va="top", fontsize=9, color=INK, linespacing=1.6)


def label(axes: Axes, title: str, x: str, y: str) -> None:
    """Set the title and the names of the axes, and draw a faint grid."""
    axes.set_title(title, loc="left", fontsize=10, color=INK, pad=TITLE_PAD)
    axes.set_xlabel(x, fontsize=8.5, color=INK)
    axes.set_ylabel(y, fontsize=8.5, color=INK)
    axes.tick_params(labelsize=8)
    axes.grid(which="major", color="#e4e6ea", linewidth=0.7)
    axes.set_axisbelow(True)
    axes.spines[["top", "right"]].set_visible(False)


def logarithmic(axes: Axes, values: Array) -> None:
    """Make the vertical axis, of lengths in m, logarithmic where any value is above 0."""
    own = values[np.isfinite(values) & (values > SMALLEST_LENGTH)]
    if not len(own):
        axes.set(xticks=[], yticks=[])
        axes.annotate("no difference", (0.5, 0.5), xycoords="axes fraction", ha="center", fontsize=9, color=QUIET)
        return
    axes.set_yscale("log")
    decades = np.log10(own.max() / own.min())
    logarithmic_ticks(axes.yaxis, (1.0,) if decades > 2.5 else (1.0, 2.0, 5.0), 9, metres)
    axes.set_ylabel("")
    axes.set_ylim(0.6 * float(own.min()), 1.7 * float(own.max()))


def logarithmic_ticks(
    axis: Axis, parts: Sequence[float], count: int, name: Callable[[float], str] = "{:g}".format
) -> None:
    """Label a logarithmic axis at `parts` of each power of ten, with about `count` ticks at most."""
    from matplotlib.ticker import FuncFormatter, LogLocator, NullFormatter

    axis.set_major_locator(LogLocator(subs=parts, numticks=count))
    axis.set_major_formatter(FuncFormatter(lambda value, _: name(value)))
    axis.set_minor_formatter(NullFormatter())


def blank(axes: Axes, camera: Camera) -> None:
    """Make axes of the camera's view, without numbers."""
    (left, bottom), (right, top) = camera.low, camera.high
    axes.set(xlim=(left, right), ylim=(bottom, top), xticks=[], yticks=[], aspect="equal", facecolor=GROUND)
    axes.spines[:].set_visible(False)
