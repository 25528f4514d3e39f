"""The pictures of `simulate`, `estimate`, `control`, `evaluate` and of a subspace: a filmstrip, with charts and maps
below it: frames of a motion side by side.

Each is a matplotlib figure without a window, unknown to pyplot; `picture_file.save` writes it.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import partial
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from clothfit.base.arrays import Array
from clothfit.base.messages import metres
from clothfit.control.control import ControlledMotion
from clothfit.evaluation.evaluate import Overlay
from clothfit.motion.energy import Energy
from clothfit.pictures import charts, maps
from clothfit.pictures import stage as scenery
from clothfit.pictures.picture_file import BLUE, FIXED_VERTEX, GROUND, INK, ORANGE, PURPLE, QUIET, TARGET_COLOUR
from clothfit.pictures.stage import ARROW, Marks, Stage
from clothfit.scene.scene import Scene

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure, SubFigure

    from clothfit.optimise.progress import Progress
    from clothfit.subspace.validation import Compared

PAGE_WIDTH, HEAD_HEIGHT, LEGEND_HEIGHT, ROW_HEIGHT = 12.0, 0.42, 0.2, 3.0  # inches
CHART_SHARE, MAP_SHARE, TEXT_SHARE = 1.25, 1.1, 0.85  # of the width of a row

COMPARED = ((0.012, "solid: fitted", "#4669a8"), (0.09, "translucent green: target", "#1a8f4a"))
CONTROLLED = (
    (0.012, "solid: cloth", "#4669a8"), (0.09, "translucent green: next key", "#1a8f4a"),
    (0.26, "arrows: forces", "#b34f00"),
)  # fmt: skip
"""What the colours mean: where from the left, text, colour."""

IN_A_ROW = 3
"""Most charts and maps in one row."""

SUBSPACE = ((0.012, "solid: on the subspace", "#4669a8"), (0.155, "translucent green: in full", "#1a8f4a"))

COORDINATES = 3
"""First coordinates."""

STRIP_FRAMES = 6

STRIP_FACES = 6000
"""Most faces in a frame; larger meshes are thinned."""

FRAME_WIDTH = 800
"""Pixels across a frame."""

DOT_SIZE = 1.8  # points, of a vertex


def strip(
    figure: SubFigure, on: Stage, times: Array, x: Array, over: Array | None = None, marks: Marks | None = None
) -> None:
    """Draw some frames of a motion x (F, n, 3), at `times` (F,) s, with the target `over` (F, n, 3) over it, and the
    marks of a controlled one.
    """
    due = [] if marks is None else marks.held.tolist()
    shown = chosen(len(x), due)
    panels: Any = figure.subplots(1, len(shown), squeeze=False)
    figure.subplots_adjust(left=0.012, right=0.988, bottom=0.09, top=0.98, wspace=0.03)
    for axes, frame in zip(panels[0], shown, strict=True):
        frame_picture(axes, on, int(frame), x[frame], None if over is None else over[frame])
        if marks is not None:  # forces as arrows, and the places that means are to be at
            tails, tips = scenery.arrows(on, int(frame), x[frame], marks)
            if len(tails):
                way: Any = {"angles": "xy", "scale_units": "xy", "scale": 1.0, "headwidth": 4.0, "headlength": 4.5}
                axes.quiver(*tails.T, *(tips - tails).T, **way, width=0.006, minlength=0.0, color=ARROW, zorder=3)
            means = scenery.dots(on, int(frame), marks)
            axes.plot(*means.T, "o", color=TARGET_COLOUR, markersize=6.0, markeredgecolor=INK, zorder=4)
        label = f"{times[frame]:.2f} s" + (" – key" if frame in due else "")
        axes.set_xlabel(label, fontsize=9, color=INK if frame in due else QUIET, labelpad=3)
    blown = len(shown) if np.ptp(on.wind, axis=0).any() else 1
    for axes, frame in list(zip(panels[0], shown, strict=True))[:blown]:
        draw_wind(axes, on, int(frame))


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


def frame_picture(axes: Axes, on: Stage, frame: int, x: Array, over: Array | None) -> None:
    """Draw a frame with positions x (n, 3) into its axes."""
    (left, bottom), (right, top) = on.camera.low.tolist(), on.camera.high.tolist()
    picture = scenery.drawn(on, frame, x, over, FRAME_WIDTH)
    axes.imshow(picture, extent=(left, right, bottom, top), interpolation="antialiased", zorder=2)
    alone, colours = scenery.bare(on, frame, x)
    axes.scatter(alone[:, 0], alone[:, 1], s=(2.0 * DOT_SIZE) ** 2, c=colours, linewidths=0, zorder=2)
    if over is not None:
        dots_at = scenery.sightings(on, frame, over)
        axes.plot(*dots_at.T, "o", color=TARGET_COLOUR, markersize=DOT_SIZE, markeredgewidth=0, zorder=3)
    fixed_at = scenery.pins(on, frame, x)
    axes.plot(*fixed_at.T, "o", color=FIXED_VERTEX, markersize=DOT_SIZE + 0.6, markeredgewidth=0, zorder=3)
    charts.blank(axes, on.camera)


def draw_wind(axes: Axes, on: Stage, frame: int) -> None:
    """Draw an arrow along the wind in the corner of a picture, with its speed."""
    found = scenery.wind(on, frame)
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


class Part(NamedTuple):
    """A chart, map or text in a row below the filmstrip."""

    draw: Callable[[Axes], None]
    share: float = CHART_SHARE


def simulation(scene: Scene, times: Array, x: Array, energy: Energy | None = None) -> Figure:
    """The picture of a motion x (F, n, 3), m, at `times` (F,), s."""
    rows = [] if energy is None else [[Part(lambda axes: charts.energies(axes, energy))]]
    steps = f"{len(times)} frames, h = {1e3 * scene.delta:.4g} ms"
    return composed(scene, times, x, None, f"{scene.name}: simulated", steps, rows)


def estimation(over: Overlay, summary: str, history: Sequence[Progress], fitted: float) -> Figure:
    """The picture of a fit: the fitted motion and its target, convergence, error and the values found.

    `summary` says how the fit ended; `fitted` is the end, s, of the fitted frames. A fit that is known without a search
    has no convergence.
    """
    searched = len({one.evaluations for one in history}) > 1
    drawn = [Part(lambda axes: charts.convergence(axes, history))] if searched else []
    share = CHART_SHARE if searched else 2.0 * CHART_SHARE
    drawn.append(Part(lambda axes: charts.error(axes, over.times, over.rmse, over.largest, fitted), share))
    return compared(over, f"{over.scene.name}: fitted", summary, drawn, values(over.scene, None))


def evaluation(over: Overlay, truth: Scene, summary: str, fitted: float, horizon: float) -> Figure:
    """The picture of a fitted scene beside the true one: both motions, their distance, the deviation of the values.

    `fitted` and `horizon` are the ends, s, of the fitted frames and of the longer comparison.
    """
    errors = (over.times, over.rmse, over.largest, fitted, horizon)
    drawn = [Part(lambda axes: charts.error(axes, *errors), 2.0 * CHART_SHARE)]
    return compared(over, f"{over.scene.name} against {truth.name}", summary, drawn, values(over.scene, truth))


def controlled(motion: ControlledMotion, summary: str) -> Figure:
    """The picture of a controlled motion: the keys and the forces, the distance from each key over time, and what each
    step takes. `summary` says how the search ended.
    """
    drawn = [Part(partial(charts.distances, motion=motion), 1.5 * CHART_SHARE)]
    if motion.effort.any():
        drawn.append(Part(partial(charts.effort, motion=motion), 1.5 * CHART_SHARE))
    title, own = f"{motion.scene.name}: controlled", scenery.marks(motion)
    return composed(motion.scene, motion.times, motion.own, own.keys, title, summary, [drawn], own)


def compared(over: Overlay, title: str, summary: str, drawn: list[Part], maps: list[Part]) -> Figure:
    """A fitted motion with its target, above charts and maps: in one row where there is room, else in two."""
    rows = [[*drawn, *maps]] if len(drawn) + len(maps) <= IN_A_ROW else [drawn, maps]
    return composed(over.scene, over.times, over.own, over.goal, title, summary, rows)


def values(scene: Scene, truth: Scene | None) -> list[Part]:
    """Maps and text that show the values of a scene, or how far they are from the true ones."""
    drawn = [Part(partial(maps.draw, field=one), MAP_SHARE) for one in maps.maps(scene, truth)]
    lines = maps.single_values(scene, truth)
    return [*drawn, Part(partial(charts.text, title="values", lines=lines), TEXT_SHARE)] if lines else drawn


def composed(
    scene: Scene, times: Array, x: Array, over: Array | None, title: str, summary: str, rows: Sequence[Sequence[Part]],
    own: Marks | None = None, names: Sequence[tuple[float, str, str]] = COMPARED,
) -> Figure:  # fmt: skip
    """A filmstrip of x (F, n, 3) with the target `over` (F, n, 3) over it, and marks; and rows of parts below. `names`
    say what the colours of x and `over` mean.
    """
    from matplotlib.figure import Figure

    times, x, over = scenery.good_part(times, x, over)
    beside = own.seen(x) if own is not None else [] if over is None else [over]
    on = scenery.stage(scene, [x, *beside], STRIP_FACES, times=times)
    top = HEAD_HEIGHT if over is None else HEAD_HEIGHT + LEGEND_HEIGHT
    height = (PAGE_WIDTH / STRIP_FRAMES - 0.06) * on.camera.aspect + 0.33
    sizes = [top, height, *[ROW_HEIGHT] * len(rows)]
    figure = Figure(figsize=(PAGE_WIDTH, sum(sizes)), facecolor="white")
    bands: Any = figure.subfigures(len(sizes), 1, height_ratios=sizes, squeeze=False)
    head, line = bands[0, 0], 1.0 - 0.6 * HEAD_HEIGHT / top
    head.text(0.012, line, title, fontsize=13, fontweight="bold", color=INK, va="center")
    head.text(0.988, line, summary, fontsize=9, color=QUIET, va="center", ha="right")
    for left, text, colour in () if over is None else names if own is None else CONTROLLED[: len(own.legend)]:
        head.text(left, 0.5 * LEGEND_HEIGHT / top, text, fontsize=9, color=colour, va="center")
    strip(bands[1, 0], on, times, x, over, own)
    for band, parts in zip(bands[2:, 0], rows, strict=True):  # a row of maps alone is not stretched to the whole width
        fractions = [part.share for part in parts]
        free = 0.0 if max(fractions) >= CHART_SHARE else max(0.0, IN_A_ROW * MAP_SHARE - sum(fractions))
        widths = [*fractions, free] if free else fractions
        right = 0.985 if fractions[-1] >= CHART_SHARE else 0.94  # room for colour bars and text beyond
        grid = band.add_gridspec(1, len(widths), width_ratios=widths, left=0.062, right=right,
                                 bottom=0.165, top=0.845, wspace=0.24)  # fmt: skip
        for column, part in enumerate(parts):
            part.draw(band.add_subplot(grid[0, column]))
    return figure


def comparison(over: Compared) -> Figure:
    """The picture of a comparison: both motions, the first coordinates against those of the full motion, and, unless
    the two have parted, error and energy; else spectra and standard deviations.
    """
    found = over.found
    rows = [[Part(partial(coordinates, over=over, c=c), 2.0 * CHART_SHARE) for c in range(len(over.coordinates))][:2]]
    drawn = (spectra, deviations) if found.forgets else (error, energy)
    rows.append([Part(partial(draw, over=over)) for draw in drawn])
    said = f"{100 * found.relative_rmse:.2g} % of the motion's RMS over {found.frames} frames"
    if found.forgets:
        said = f"{found.parted}: spectrum within {100 * found.spectrum:.2g} %, deviations within "
        said += f"{100 * found.deviation:.2g} %"
    own, full, title = over.own.positions, over.full.positions, f"{over.scene.name}: on a subspace"
    return composed(over.scene, over.full.times, own, full, title, said, rows, names=SUBSPACE)


def coordinates(axes: Axes, over: Compared, c: int) -> None:
    """The first coordinates of an object over time, and those of the full motion."""
    of = "" if len(over.coordinates) == 1 else f" of objects[{c}]"
    charts.label(axes, f"first coordinates{of}: on the subspace (lines), of the full motion (dots)", "time, s", "√kg m")
    own, true = over.coordinates[c], over.projected(c)
    every = max(1, len(true) // 90)
    for k, colour in zip(range(min(COORDINATES, own.shape[1])), (BLUE, ORANGE, PURPLE), strict=False):
        axes.plot(over.full.times[::every], true[::every, k], ".", color=colour, markersize=4, alpha=0.6)
        axes.plot(over.full.times, own[:, k], color=colour, linewidth=1.5, label=f"q{k + 1}")
    charts.above(axes)


def error(axes: Axes, over: Compared) -> None:
    """The error of each frame."""
    gaps = np.linalg.norm(over.own.positions - over.full.positions, axis=2)
    rmse, largest = np.sqrt((gaps**2).mean(axis=1)), gaps.max(axis=1)
    charts.errors(axes, "distance to the full motion", over.full.times, rmse, largest, ORANGE)
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
    from clothfit.subspace.validation import bands  # which few pictures need

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
