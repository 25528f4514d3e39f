"""What `clothfit evaluate --speed` prints: a table, what its errors mean, and advice."""

from __future__ import annotations

from typing import TYPE_CHECKING

from clothfit.base.messages import counted, metres
from clothfit.cli.common.console import Console

if TYPE_CHECKING:
    from clothfit.evaluation.fit_methods import FitRow
    from clothfit.evaluation.work_precision import Row, WorkPrecision
    from clothfit.scene.scene import Scene

SPEED_COLUMNS = (
    "integrator", "step", "tolerance", "Newton", "ms per step", "s per simulated s", "error", "largest error", "",
)  # fmt: skip


def show(found: WorkPrecision, scene: Scene, error: float | None, console: Console) -> None:
    """Print table and advice."""
    done = [row for row in found.rows if row.status == "done"]
    shown = [row for row in done if console.verbose or is_shown(row, scene)]
    if shown:
        console.table([SPEED_COLUMNS, *map(cells, shown)])
    if len(shown) < len(done):
        console.result(f"{len(done) - len(shown)} more, with other tolerances and not Pareto-best, by -v and --json")
    for status in ("diverged", "skipped"):
        if settings := without_result(found, status):
            console.result(f"{status}: {settings}")
    console.result("")
    show_reference(found, console)
    show_advice(found, scene, error, console)


def is_shown(row: Row, scene: Scene) -> bool:
    """Whether a row is in the short table."""
    return row.pareto or row.own or row.setting.tolerance in (None, scene.tolerance)


def cells(row: Row) -> tuple[str, ...]:
    """A row of the table, one that is done."""
    setting = row.setting
    marks = ["Pareto-best"] * row.pareto + ["the scene's own"] * row.own
    return (
        setting.integrator,
        f"{setting.step_name} = {1e3 * row.step:.4g} ms",
        "" if setting.tolerance is None else f"{setting.tolerance:.3g}",
        "" if setting.newton is None else str(setting.newton),
        f"{row.ms_per_step:.3g}",
        f"{row.seconds_per_second:.3g}",
        metres(row.error or 0.0),
        metres(row.max_error or 0.0),
        ", ".join(marks),
    )


def without_result(found: WorkPrecision, status: str) -> str:
    """The settings that ended so, by integrator: which steps, of how many settings each."""
    ended = []
    for name in dict.fromkeys(row.setting.integrator for row in found.rows):
        rows = [row for row in found.rows if row.setting.integrator == name and row.status == status]
        steps = [row.setting.step_name for row in rows]
        counts = {step: steps.count(step) for step in steps}
        if rows:
            parts = [step if count == 1 else f"{step} ({count} settings)" for step, count in counts.items()]
            ended.append(f"{name} {', '.join(parts)}")
    return "; ".join(ended)


def show_reference(found: WorkPrecision, console: Console) -> None:
    """Say what the errors are measured against, and how well that is known."""
    reference = found.reference
    frames = len(reference.positions)
    order = "" if reference.order is None else f", order {reference.order:.1f}"
    how = f"{reference.integrator}, {1e3 * reference.step:.3g} ms a step, extrapolated{order}"
    console.result(
        f"error: distance to the motion of h → 0, root mean square over all vertices and {frames} frames; that motion "
        f"is known to {metres(reference.error)} ({how})"
    )
    if frames < found.frames:
        console.warn(
            f"{found.scene}: frames from {frames} on (t = {frames * found.delta:.4g} s) are not judged: the motion of "
            "h → 0 is not known well enough there, as it is chaotic or needs more --budget"
        )


def show_advice(found: WorkPrecision, scene: Scene, error: float | None, console: Console) -> None:
    """Recommend a setting, and say which one a fit must use."""
    own = found.own
    if error is not None:
        best, nearest = found.recommended(error), found.nearest
        if best is not None:
            console.result(f"cheapest within {metres(error)}: {described(best)}")
        elif nearest is None:
            console.warn(f"no setting comes within {metres(error)}: none came through")
        else:
            console.warn(f"no setting comes within {metres(error)}; the nearest is {described(nearest)}")
    console.result(
        f"the editor plays this scene with {described(own)}: a fit must use the same "
        f"(integrationMethod {scene.method}, delta {scene.delta:.4g}), as its values make up for part of that error "
        "and are wrong with any other"
    )
    better = [r for r in found.rows if all(a < b for a, b in zip(r.cost_and_error, own.cost_and_error, strict=True))]
    if better and own.status == "done":
        console.result(f"cheaper and nearer than that: {described(min(better, key=lambda r: r.cost_and_error[::-1]))}")


def described(row: Row) -> str:
    """A row in words."""
    setting = row.setting
    parts = [f"{setting.integrator} steps of {setting.step_name} = {1e3 * row.step:.4g} ms"]
    if setting.newton is not None:
        parts.append(f"tolerance {setting.tolerance:.3g}")
        parts.append(counted(setting.newton, "Newton iteration", "Newton iterations"))
    text = ", ".join(parts)
    if row.error is None:
        return f"{text} ({row.status})"
    return f"{text} ({metres(row.error)}, {row.seconds_per_second:.3g} s per simulated second)"


def show_fits(fits: list[FitRow], console: Console) -> None:
    """Print the table of methods."""
    rows = [("method", "ends", "seconds", "evaluations", "RMSE", "median deviation", "")]
    for row in fits:
        rmse = "" if row.rmse is None else metres(row.rmse)
        deviation = "" if row.median_relative_deviation is None else f"{row.median_relative_deviation:.2g}"
        counts = (f"{row.seconds:.2f}", str(row.evaluations))
        rows.append((row.method, row.status, *counts, rmse, deviation, "Pareto-best" if row.pareto else ""))
    console.result("")
    console.table(rows)
