"""`clothfit evaluate --speed`: what accuracy does each second buy? A table, what its errors mean, and advice."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import asdict, dataclass
from typing import TYPE_CHECKING, Any

from clothfit.base.errors import InvalidInput
from clothfit.base.messages import counted, metres
from clothfit.cli.common.console import Console
from clothfit.cli.common.output import STREAM, print_json, same_file, uninterrupted
from clothfit.cli.common.progress import PLAIN_INTERVAL
from clothfit.cli.common.scenes import frames_of, read_scene

if TYPE_CHECKING:
    from clothfit.evaluation.work_precision import Row, WorkPrecision
    from clothfit.scene.scene import Scene

SPEED_COLUMNS = (
    "integrator", "step", "tolerance", "Newton", "ms per step", "s per simulated s", "error", "largest error", "",
)  # fmt: skip

Report = Callable[[float, str], None]


@dataclass(frozen=True)
class SpeedOptions:
    """The options of `--speed`; None where one is not given."""

    steps: int | None
    error: float | None  # m: the cheapest setting within it is recommended
    budget: float | None  # s to measure
    plot: str | None  # file of the diagram


def measure(scene_path: str, asked: SpeedOptions, console: Console) -> None:
    """Measure integrators; print and draw the result."""
    check_values(asked.error, asked.budget)
    scene = read_scene(scene_path, console)
    frames = frames_of(asked.steps, scene)
    if asked.plot is not None:
        check_plot(asked.plot, scene_path)
    from clothfit.evaluation import work_precision as precision

    console.announce_compilation()
    with progress(console) as report:
        found = precision.work_precision(scene, frames, asked.budget or precision.MEASURE_SECONDS, report)
    if asked.plot is not None:
        from clothfit.pictures.diagram import save_diagram

        with uninterrupted():
            save_diagram(found, asked.plot, asked.error)
    if print_json(summary(found, scene, asked)):
        return
    show(found, scene, asked.error, console)
    if asked.plot is not None:
        console.say(f"diagram → {asked.plot}")


def check_values(error: float | None, budget: float | None) -> None:
    """Raise InvalidInput on option values that cannot be."""
    for name, value, unit in (("--error", error, "m"), ("--budget", budget, "s")):
        if value is not None and not 0 < value < float("inf"):
            raise InvalidInput(f"{name} must be above 0 and finite; {value:g} {unit} was given")


def check_plot(plot: str, scene_path: str) -> None:
    """Raise InvalidInput, before long work, when the diagram cannot be made or written there."""
    from clothfit.pictures.picture_file import check

    if scene_path != STREAM and same_file(plot, scene_path):
        raise InvalidInput(f"cannot write {plot}: it is an input, which is never written over")
    check(plot)


@contextmanager
def progress(console: Console) -> Iterator[Report | None]:
    """Show what is being measured while the block runs; gives what to call with it."""
    if console.quiet:
        yield None
    elif console.animated:
        from rich.console import Console as RichConsole

        with RichConsole(stderr=True).status("measuring") as status:
            yield lambda seconds, what: status.update(f"{what} ({seconds:.0f} s)")
    else:
        last = [time.perf_counter()]

        def show(seconds: float, what: str) -> None:
            if time.perf_counter() - last[0] >= PLAIN_INTERVAL:
                last[0] = time.perf_counter()
                console.say(f"{seconds:6.1f} s  {what}")

        yield show


def summary(found: WorkPrecision, scene: Scene, asked: SpeedOptions) -> dict[str, Any]:
    """What --json prints."""
    best = None if asked.error is None else found.recommended(asked.error)
    reference = found.reference
    return {
        "scene": found.scene,
        "delta": found.delta,
        "frames": len(reference.positions),
        "simulated_frames": found.frames,
        "vertices": sum(scene.vertex_counts),
        "reference": {name: getattr(reference, name) for name in ("integrator", "step", "order", "error")},
        "rows": [plain_row(row) for row in found.rows],
        "own": plain_row(found.own),
        "requested_error": asked.error,
        "recommended": best and plain_row(best),
        "plot": asked.plot,
    }


def plain_row(row: Row) -> dict[str, Any]:
    """A row as JSON has it: with its setting's values beside its own."""
    values = asdict(row)
    setting: dict[str, Any] = values.pop("setting")
    setting["newton_iterations"] = setting.pop("newton")
    values["seconds_per_simulated_second"] = values.pop("seconds_per_second")
    return setting | values


def show(found: WorkPrecision, scene: Scene, error: float | None, console: Console) -> None:
    """Print table and advice."""
    done = [row for row in found.rows if row.status == "done"]
    short = [row for row in done if row.pareto or row.own or row.setting.tolerance in (None, scene.tolerance)]
    shown = done if console.verbose else short
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
    how = f"{reference.integrator}, {1e3 * reference.step:.3g} ms a step{order}"
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
