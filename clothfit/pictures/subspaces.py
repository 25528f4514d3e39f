"""The charts of a motion on a subspace beside the full one: coordinates, error, energy, spectra, deviations."""

from __future__ import annotations

from functools import partial
from typing import TYPE_CHECKING

import numpy as np

from clothfit.base.messages import metres
from clothfit.pictures import charts
from clothfit.pictures.palette import BLUE, INK, ORANGE, PURPLE, QUIET
from clothfit.pictures.plots import CHART_SHARE, Part, composed
from clothfit.subspace.judge import Compared, bands

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

NAMES = ((0.012, "solid: on the subspace", "#4669a8"), (0.155, "translucent green: in full", "#1a8f4a"))

SHOWN = 3
"""First coordinates."""


def comparison(over: Compared) -> Figure:
    """The picture of a comparison: both motions, the first coordinates against those of the full motion, and, unless
    the two have parted, error and energy; else spectra and standard deviations.
    """
    rows = [[Part(partial(coordinates, over=over, c=c), 2.0 * CHART_SHARE) for c in range(len(over.coordinates))][:2]]
    if over.found.forgets:
        rows.append([Part(partial(spectra, over=over)), Part(partial(deviations, over=over))])
    else:
        rows.append([Part(partial(error, over=over)), Part(partial(energy, over=over))])
    found = over.found
    said = f"{100 * found.relative_rmse:.2g} % of the motion's RMS over {found.frames} frames"
    if found.forgets:
        said = f"{found.parted}: spectrum within {100 * found.spectrum:.2g} %, deviations within "
        said += f"{100 * found.deviation:.2g} %"
    own, full, title = over.own.positions, over.full.positions, f"{over.scene.name}: on a subspace"
    return composed(over.scene, over.full.times, own, full, title, said, rows, names=NAMES)


def coordinates(axes: Axes, over: Compared, c: int) -> None:
    """The first coordinates of an object over time, and those of the full motion."""
    of = "" if len(over.coordinates) == 1 else f" of objects[{c}]"
    charts.label(axes, f"first coordinates{of}: on the subspace (lines), of the full motion (dots)", "time, s", "√kg m")
    own, true = over.coordinates[c], over.projected(c)
    every = max(1, len(true) // 90)
    for k, colour in zip(range(min(SHOWN, own.shape[1])), (BLUE, ORANGE, PURPLE), strict=False):
        axes.plot(over.full.times[::every], true[::every, k], ".", color=colour, markersize=4, alpha=0.6)
        axes.plot(over.full.times, own[:, k], color=colour, linewidth=1.5, label=f"q{k + 1}")
    charts.above(axes)


def error(axes: Axes, over: Compared) -> None:
    """The error of each frame."""
    gaps = np.linalg.norm(over.own.positions - over.full.positions, axis=2)
    rmse, largest = np.sqrt((gaps**2).mean(axis=1)), gaps.max(axis=1)
    charts.label(axes, "distance to the full motion", "time, s", "m")
    charts.logarithmic(axes, np.concatenate([rmse, largest]))
    axes.plot(over.full.times, charts.shown(largest), color=ORANGE, linewidth=1.1, label="largest")
    axes.plot(over.full.times, charts.shown(rmse), color=BLUE, linewidth=1.7, label="root mean square")
    charts.above(axes)


def energy(axes: Axes, over: Compared) -> None:
    """The stored energy of both."""
    own, full = over.energies
    charts.label(axes, "stored energy", "time, s", "J")
    axes.plot(full.times, full.total, color=INK, linewidth=2.6, alpha=0.35, label="in full")
    axes.plot(own.times, own.total, color=BLUE, linewidth=1.3, label="on the subspace")
    charts.above(axes)


def spectra(axes: Axes, over: Compared) -> None:
    """The amplitudes of both, by frequency."""
    charts.label(axes, "spectrum, mean of the vertices", "frequency, Hz", "m")
    for motion, colour, name in ((over.full, QUIET, "in full"), (over.own, BLUE, "on the subspace")):
        frequency, amplitude = bands(motion.positions)
        axes.plot(frequency / motion.times[-1], amplitude / len(motion.times), "o-", color=colour, label=name,
                  linewidth=1.4, markersize=3.5)  # fmt: skip
    axes.set(xscale="log", yscale="log")
    charts.above(axes)


def deviations(axes: Axes, over: Compared) -> None:
    """The standard deviation of each vertex over time, on the subspace over in full."""
    own, full = (np.sqrt(x.positions.var(axis=0).sum(axis=1)) for x in (over.own, over.full))
    charts.label(axes, "standard deviation of each vertex", "in full, m", "on the subspace, m")
    top = float(max(own.max(), full.max(), 1e-9))
    axes.plot([0, top], [0, top], color=QUIET, linewidth=0.9)
    axes.plot(full, own, ".", color=BLUE, markersize=3.5, alpha=0.6)
    axes.annotate(f"largest {metres(top)}", (0.98, 0.03), xycoords="axes fraction", ha="right", fontsize=8, color=INK)
