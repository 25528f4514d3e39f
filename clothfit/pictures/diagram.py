"""The work–precision diagram: the error of each way to simulate against its cost. Needs matplotlib, the extra `plot`.

Both axes are logarithmic: seconds of computing per simulated second to the right, error upwards; lower left is better.
Each integrator and number of Newton iterations has a line through its steps at the scene's own tolerance; lines for
other tolerances are faint. Each line has a marker of its own as well as a colour.
"""

from __future__ import annotations

import os
from collections.abc import Iterable, Iterator
from functools import partial
from typing import TYPE_CHECKING, NamedTuple

from clothfit.base.messages import counted, metres
from clothfit.evaluation.work_precision import Row, WorkPrecision
from clothfit.pictures.charts import logarithmic_ticks
from clothfit.pictures.picture_file import BLUE, GREEN, INK, ORANGE, PURPLE, QUIET, RED, SKY, save

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

DIAGRAM_SIZE = (9.2, 5.2)  # inches
REQUESTED_ERROR = "#a01c1c"
STYLES = {"explicit": (ORANGE, "^"), "symplectic": (BLUE, "o")}
NEWTON_STYLES = ((GREEN, "s"), (PURPLE, "D"), (RED, "v"), (SKY, "P"))


class Line(NamedTuple):
    """Rows that differ in their time step only."""

    label: str
    colour: str
    marker: str
    rows: list[Row]  # with status "done"
    main: bool  # whether at the scene's own tolerance, or without one


def save_diagram(study: WorkPrecision, path: str | os.PathLike[str], error: float | None = None) -> None:
    """Write the diagram to a .png, .svg or .pdf, whole or not at all, with a line at the requested `error`, m.

    Raises InvalidInput when the diagram cannot be drawn or written.
    """
    save(path, partial(draw, study, error))


def draw(study: WorkPrecision, error: float | None = None) -> Figure:
    """The diagram as a figure without a window, unknown to pyplot."""
    from matplotlib.figure import Figure

    figure = Figure(figsize=DIAGRAM_SIZE, layout="constrained")
    axes = figure.add_subplot(xscale="log", yscale="log")
    positive = [row.error for row in study.rows if row.error]
    floor = 0.5 * min(positive) if positive else 1e-6  # where errors of 0 are drawn, which have no logarithm
    for line in lines(study):
        draw_line(axes, line, floor)
    axes.plot([], [], color=QUIET, marker="s", markersize=3, linewidth=0.7, alpha=0.5, label="faint: other tolerances")
    draw_front(axes, study, floor)
    frame(axes, study)
    draw_levels(axes, study, error, floor)
    draw_own(axes, study, floor)
    axes.legend(loc="upper left", bbox_to_anchor=(1.01, 1.0), fontsize=8.5, frameon=False, borderaxespad=0.0)
    return figure


def lines(study: WorkPrecision) -> Iterator[Line]:
    """The lines of the diagram, the faint ones first so that the others lie above them."""
    kinds = list(dict.fromkeys(row.setting.kind for row in study.rows))
    iterations = sorted({newton for _, _, newton in kinds if newton is not None})
    for kind in sorted(kinds, key=lambda kind: kind[1] in (None, study.tolerance)):
        name, tolerance, newton = kind
        rows = [row for row in study.rows if row.setting.kind == kind and row.status == "done"]
        colour, marker = STYLES.get(name) or NEWTON_STYLES[iterations.index(newton or 1) % len(NEWTON_STYLES)]
        label = name if newton is None else f"{name}, {counted(newton, 'iteration', 'iterations')}"
        if rows:
            yield Line(label, colour, marker, rows, tolerance in (None, study.tolerance))


def places(rows: Iterable[Row], floor: float) -> tuple[list[float], list[float]]:
    """The costs and the errors of rows, these `floor` at least."""
    points = [row.cost_and_error for row in rows]
    return [cost for cost, _ in points], [max(error, floor) for _, error in points]


def draw_line(axes: Axes, line: Line, floor: float) -> None:
    """Draw a line with its markers; a main line is named in the legend."""
    x, y = places(line.rows, floor)
    if line.main:
        axes.plot(x, y, color=line.colour, marker=line.marker, markersize=6, linewidth=1.6, label=line.label, zorder=3,
                  markeredgecolor="white", markeredgewidth=0.8)
    else:
        axes.plot(x, y, color=line.colour, marker=line.marker, markersize=3, linewidth=0.7, alpha=0.35, zorder=2)


def draw_front(axes: Axes, study: WorkPrecision, floor: float) -> None:
    """Draw the Pareto front of all rows and name the time steps on it."""
    best = sorted((row for row in study.rows if row.pareto), key=lambda row: row.cost_and_error)
    if not best:
        return
    x, y = places(best, floor)
    axes.step(x, y, where="post", color=INK, linewidth=6, alpha=0.13, zorder=1, label="Pareto-best")
    before = ""
    for row, a, b in zip(best, x, y, strict=True):
        name = row.setting.step_name
        if name != before:  # rows of the same step lie close together, and their names would overlap
            axes.annotate(name, (a, b), xytext=(-5, -11), textcoords="offset points", fontsize=8, color=INK, ha="right",
                          zorder=5)
        before = name


def frame(axes: Axes, study: WorkPrecision) -> None:
    """Draw title, axes with units, and grid."""
    frames = len(study.reference.positions)
    axes.set_title(f"{study.scene}: speed against error", loc="left", fontsize=12, fontweight="bold", color=INK)
    axes.set_title(f"{frames} frames, h = {1e3 * study.delta:.4g} ms", loc="right", fontsize=9, color=QUIET)
    axes.set_xlabel("seconds of computing per simulated second")
    axes.set_ylabel("distance to the motion of h → 0, root mean square, m")
    axes.grid(which="major", color="#dddddd", linewidth=0.7)
    axes.grid(which="minor", color="#f1f1f1", linewidth=0.5)
    logarithmic_ticks(axes.xaxis, (1.0, 2.0, 5.0), 20)
    logarithmic_ticks(axes.yaxis, (1.0,), 20)
    axes.set_axisbelow(True)
    axes.spines[["top", "right"]].set_visible(False)
    axes.margins(x=0.08, y=0.1)
    if study.nearest is None:
        axes.set(xlim=(1e-3, 1.0), ylim=(1e-4, 1.0))  # an empty logarithmic axis has no limits of its own


def draw_levels(axes: Axes, study: WorkPrecision, error: float | None, floor: float) -> None:
    """Draw the requested error, and the reference's own: as a line where it is near the others, else as a remark."""
    if error is not None:
        axes.axhline(error, color=REQUESTED_ERROR, linewidth=1.2, linestyle=(0, (6, 3)), zorder=2,
                     label=f"asked for: {metres(error)}")
    own = study.reference.error
    name = f"the reference's own error: {metres(own)}"
    if own > 0.1 * floor:
        axes.axhline(own, color=QUIET, linewidth=1.2, linestyle=":", zorder=2, label=name)
    else:
        zeros = "; errors of 0 are drawn at the lower edge" if any(row.error == 0 for row in study.rows) else ""
        axes.annotate(f"↓ {name}{zeros}", (0.01, 0.015), xycoords="axes fraction", fontsize=8, color=QUIET)


def draw_own(axes: Axes, study: WorkPrecision, floor: float) -> None:
    """Draw a ring around the scene's own setting."""
    if study.own.status != "done":
        return
    (x,), (y,) = places([study.own], floor)
    axes.plot([x], [y], marker="o", markersize=14, fillstyle="none", color=INK, zorder=6)
    ground = {"boxstyle": "round,pad=0.15", "facecolor": "white", "edgecolor": "none", "alpha": 0.85}
    axes.annotate("the scene's own", (x, y), xytext=(10, 10), textcoords="offset points", fontsize=9, color=INK,
                  fontweight="bold", zorder=6, bbox=ground)
