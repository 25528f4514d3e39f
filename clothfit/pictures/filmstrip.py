"""A filmstrip: frames of a motion side by side, drawn with matplotlib, the extra `plot`."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from clothfit.base.arrays import Array
from clothfit.pictures.camera import Camera
from clothfit.pictures.marks import ARROW, Marks, arrows, dots
from clothfit.pictures.palette import FIXED_VERTEX, GROUND, INK, QUIET, TARGET_COLOUR
from clothfit.pictures.stage import Stage, bare, drawn, pins, sightings, wind

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import SubFigure

STRIP_FRAMES = 6

STRIP_FACES = 6000
"""Most faces in a frame; larger meshes are thinned."""

STILL_WIDTH = 800
"""Pixels across a frame."""

DOT_SIZE = 1.8  # points, of a vertex


def strip(
    figure: SubFigure, on: Stage, times: Array, x: Array, over: Array | None = None, marks: Marks | None = None
) -> list[Axes]:
    """Draw some frames of a motion x (F, n, 3), at `times` (F,) s, with the target `over` (F, n, 3) over it, and the
    marks of a controlled one.
    """
    due = [] if marks is None else marks.held.tolist()
    shown = chosen(len(x), due)
    panels: Any = figure.subplots(1, len(shown), squeeze=False)
    figure.subplots_adjust(left=0.012, right=0.988, bottom=0.09, top=0.98, wspace=0.03)
    for axes, frame in zip(panels[0], shown, strict=True):
        still(axes, on, int(frame), x[frame], None if over is None else over[frame])
        if marks is not None:
            mark(axes, on, int(frame), x[frame], marks)
        label = f"{times[frame]:.2f} s" + (" – key" if frame in due else "")
        axes.set_xlabel(label, fontsize=9, color=INK if frame in due else QUIET, labelpad=3)
    blown = len(shown) if np.ptp(on.wind, axis=0).any() else 1
    for axes, frame in list(zip(panels[0], shown, strict=True))[:blown]:
        draw_wind(axes, on, int(frame))
    return list(panels[0])


def chosen(frames: int, due: Sequence[int] = ()) -> Sequence[int]:
    """The frames in a strip: the first, the last, and others evenly between them; frames that are `due` in the place of
    the nearest ones.
    """
    found = [int(i) for i in np.unique(np.linspace(0, frames - 1, STRIP_FRAMES).round())]
    for frame in due if len(due) <= len(found) else []:
        free = [i for i, each in enumerate(found) if each not in due]
        if frame not in found and free:
            found[min(free, key=lambda i: abs(found[i] - frame))] = frame
    return sorted(found)


def mark(axes: Axes, on: Stage, frame: int, x: Array, marks: Marks) -> None:
    """Draw forces as arrows, and the places that means are to be at."""
    tails, tips = arrows(on, frame, x, marks)
    if len(tails):
        way: Any = {"angles": "xy", "scale_units": "xy", "scale": 1.0, "headwidth": 4.0, "headlength": 4.5}
        axes.quiver(*tails.T, *(tips - tails).T, **way, width=0.006, minlength=0.0, color=ARROW, zorder=3)
    axes.plot(*dots(on, frame, marks).T, "o", color=TARGET_COLOUR, markersize=6.0, markeredgecolor=INK, zorder=4)


def still(axes: Axes, on: Stage, frame: int, x: Array, over: Array | None) -> None:
    """Draw a frame with positions x (n, 3) into its axes."""
    (left, bottom), (right, top) = on.camera.low.tolist(), on.camera.high.tolist()
    picture = drawn(on, frame, x, over, STILL_WIDTH)
    axes.imshow(picture, extent=(left, right, bottom, top), interpolation="antialiased", zorder=2)
    alone, colours = bare(on, frame, x)
    axes.scatter(alone[:, 0], alone[:, 1], s=(2.0 * DOT_SIZE) ** 2, c=colours, linewidths=0, zorder=2)
    if over is not None:
        dots_at = sightings(on, frame, over)
        axes.plot(*dots_at.T, "o", color=TARGET_COLOUR, markersize=DOT_SIZE, markeredgewidth=0, zorder=3)
    fixed_at = pins(on, frame, x)
    axes.plot(*fixed_at.T, "o", color=FIXED_VERTEX, markersize=DOT_SIZE + 0.6, markeredgewidth=0, zorder=3)
    blank(axes, on.camera)


def blank(axes: Axes, camera: Camera) -> None:
    """Make axes of the camera's view, without numbers."""
    (left, bottom), (right, top) = camera.low, camera.high
    axes.set(xlim=(left, right), ylim=(bottom, top), xticks=[], yticks=[], aspect="equal", facecolor=GROUND)
    axes.spines[:].set_visible(False)


def draw_wind(axes: Axes, on: Stage, frame: int) -> None:
    """Draw an arrow along the wind in the corner of a picture, with its speed."""
    found = wind(on, frame)
    if found is None:
        return
    way, speed = found
    size = on.camera.high - on.camera.low
    middle = on.camera.low + size * (0.17, 0.13)
    half = 0.09 * float(size.min()) * way
    style = {"arrowstyle": "-|>", "color": QUIET, "linewidth": 1.2}
    axes.annotate("", tuple(middle + half), tuple(middle - half), arrowprops=style, zorder=4)
    box = {"facecolor": GROUND, "alpha": 0.8, "linewidth": 0, "pad": 1.0}  # the cloth may lie behind it
    words: dict[str, Any] = {"fontsize": 7, "color": QUIET, "va": "center", "bbox": box, "zorder": 5}
    axes.annotate(f"wind {speed:.3g} m/s", (0.34, 0.13), xycoords="axes fraction", **words)
