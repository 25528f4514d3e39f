"""The pictures of `simulate`, `estimate`, `control` and `evaluate`: a filmstrip, with charts and maps below it.

Each is a matplotlib figure without a window, unknown to pyplot; `picture_file.save` writes it.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import partial
from typing import TYPE_CHECKING, Any, NamedTuple

from clothfit.base.arrays import Array
from clothfit.control.course import Course
from clothfit.motion.energy import Energy
from clothfit.pictures import charts, maps
from clothfit.pictures import filmstrip as film
from clothfit.pictures.filmstrip import STRIP_FACES, STRIP_FRAMES
from clothfit.pictures.marks import Marks, marks
from clothfit.pictures.overlay import Overlay
from clothfit.pictures.palette import INK, QUIET
from clothfit.pictures.stage import good_part, stage
from clothfit.scene.scene import Scene

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure, SubFigure

    from clothfit.optimise.progress import Progress

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


def controlled(course: Course, summary: str) -> Figure:
    """The picture of a controlled motion: the keys and the forces, the distance from each key over time, and what each
    step takes. `summary` says how the search ended.
    """
    drawn = [Part(partial(charts.distances, course=course), 1.5 * CHART_SHARE)]
    if course.effort.any():
        drawn.append(Part(partial(charts.effort, course=course), 1.5 * CHART_SHARE))
    title, own = f"{course.scene.name}: controlled", marks(course)
    return composed(course.scene, course.times, course.own, own.keys, title, summary, [drawn], own)


def compared(over: Overlay, title: str, summary: str, drawn: list[Part], maps: list[Part]) -> Figure:
    """A fitted motion with its target, above charts and maps: in one row where there is room, else in two."""
    rows = [[*drawn, *maps]] if len(drawn) + len(maps) <= IN_A_ROW else [drawn, maps]
    return composed(over.scene, over.times, over.own, over.goal, title, summary, rows)


def values(scene: Scene, truth: Scene | None) -> list[Part]:
    """Maps and text that show the values of a scene, or how far they are from the true ones."""
    drawn = [Part(partial(maps.draw, shown=one), MAP_SHARE) for one in maps.maps(scene, truth)]
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

    times, x, over = good_part(times, x, over)
    beside = own.seen(x) if own is not None else [] if over is None else [over]
    on = stage(scene, [x, *beside], STRIP_FACES, times=times)
    top = HEAD_HEIGHT if over is None else HEAD_HEIGHT + LEGEND_HEIGHT
    strip = (PAGE_WIDTH / STRIP_FRAMES - 0.06) * on.camera.aspect + 0.33
    sizes = [top, strip, *[ROW_HEIGHT] * len(rows)]
    figure = Figure(figsize=(PAGE_WIDTH, sum(sizes)), facecolor="white")
    bands: Any = figure.subfigures(len(sizes), 1, height_ratios=sizes, squeeze=False)
    legend = () if over is None else names if own is None else CONTROLLED[: len(own.legend)]
    head(bands[0, 0], top, title, summary, legend)
    film.strip(bands[1, 0], on, times, x, over, own)
    for band, parts in zip(bands[2:, 0], rows, strict=True):
        place(band, parts)
    return figure


def place(band: SubFigure, parts: Sequence[Part]) -> None:
    """Draw the parts of a row side by side; a row of maps alone is not stretched to the whole width."""
    fractions = [part.share for part in parts]
    free = 0.0 if max(fractions) >= CHART_SHARE else max(0.0, IN_A_ROW * MAP_SHARE - sum(fractions))
    widths = [*fractions, free] if free else fractions
    right = 0.985 if fractions[-1] >= CHART_SHARE else 0.94  # room for colour bars and text beyond
    grid = band.add_gridspec(1, len(widths), width_ratios=widths, left=0.062, right=right,
                             bottom=0.165, top=0.845, wspace=0.24)  # fmt: skip
    for column, part in enumerate(parts):
        part.draw(band.add_subplot(grid[0, column]))


def head(
    band: SubFigure, height: float, title: str, summary: str, legend: Sequence[tuple[float, str, str]]
) -> None:
    """Write the title, the summary, and what the colours mean."""
    line = 1.0 - 0.6 * HEAD_HEIGHT / height
    band.text(0.012, line, title, fontsize=13, fontweight="bold", color=INK, va="center")
    band.text(0.988, line, summary, fontsize=9, color=QUIET, va="center", ha="right")
    for left, text, colour in legend:
        band.text(left, 0.5 * LEGEND_HEIGHT / height, text, fontsize=9, color=colour, va="center")
