"""`clothfit evaluate --speed`: what accuracy does each second buy?"""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import asdict
from typing import TYPE_CHECKING, Any

from clothfit.base.errors import InvalidInput
from clothfit.cli.common import shared
from clothfit.cli.common.console import Console
from clothfit.cli.common.progress import PLAIN_INTERVAL
from clothfit.cli.evaluating import speed_table

if TYPE_CHECKING:
    from clothfit.evaluation.fit_methods import FitRow
    from clothfit.evaluation.work_precision import Row, WorkPrecision
    from clothfit.scene.scene import Scene

Report = Callable[[float, str], None]


def command(
    scene_path: str,
    steps: int | None,
    error: float | None,
    plot: str | None,
    budget: float | None,
    fit: bool,
    max_evaluations: int | None,
    as_json: bool,
    console: Console,
) -> int:
    """Measure, tell, draw."""
    check_values(error, budget, max_evaluations)
    scene = shared.read_scene(scene_path, console)
    frames = shared.frames_of(steps, scene)
    if plot is not None:
        check_plot(plot, scene_path)
    if fit:
        check_flags(scene)
    from clothfit.evaluation import work_precision as precision

    console.announce_compilation()
    with progress(console) as report:
        found = precision.work_precision(scene, frames, budget or precision.MEASURE_SECONDS, report)
        fits = compare_fits(scene, max_evaluations, report) if fit else None
    if plot is not None:
        from clothfit.pictures.diagram import save_diagram

        with shared.uninterrupted():
            save_diagram(found, plot, error)
    if as_json:
        shared.print_json("evaluate", summary(found, scene, error, fits, plot))
    else:
        speed_table.show(found, scene, error, console)
        if fits is not None:
            speed_table.show_fits(fits, console)
        if plot is not None:
            console.say(f"diagram → {plot}")
    return 0


def check_values(error: float | None, budget: float | None, max_evaluations: int | None) -> None:
    """Raise InvalidInput on option values that cannot be."""
    for name, value, unit in (("--error", error, "m"), ("--budget", budget, "s")):
        if value is not None and not 0 < value < float("inf"):
            raise InvalidInput(f"{name} must be above 0 and finite; {value:g} {unit} was given")
    if max_evaluations is not None and max_evaluations < 1:
        raise InvalidInput(f"--max-evaluations must be at least 1; {max_evaluations} was given")


def check_plot(plot: str, scene_path: str) -> None:
    """Raise InvalidInput, before long work, when the diagram cannot be made or written there."""
    from clothfit.pictures.picture_file import check

    if scene_path != shared.STREAM and shared.same_file(plot, scene_path):
        raise InvalidInput(f"cannot write {plot}: it is an input, which is never written over")
    check(plot)


def check_flags(scene: Scene) -> None:
    """Raise InvalidInput, before long work, when there is nothing to fit."""

    if not scene.blocks:
        raise InvalidInput(f"{scene.name}: --fit: no object flags anything to fit; set its optimizationSettings")


def compare_fits(scene: Scene, max_evaluations: int | None, report: Report | None) -> list[FitRow]:
    """The methods of estimation against each other."""
    from clothfit.evaluation import fit_methods

    return fit_methods.compare_methods(scene, evaluations=max_evaluations or fit_methods.FIT_EVALUATIONS, report=report)


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


def summary(
    found: WorkPrecision, scene: Scene, error: float | None, fits: list[FitRow] | None, plot: str | None
) -> dict[str, Any]:
    """What --json prints."""
    best = None if error is None else found.recommended(error)
    reference = found.reference
    return {
        "scene": found.scene,
        "delta": found.delta,
        "frames": len(reference.positions),
        "simulated_frames": found.frames,
        "vertices": sum(scene.vertex_counts),
        "reference": {
            "integrator": reference.integrator,
            "step": reference.step,
            "order": reference.order,
            "error": reference.error,
        },
        "rows": [plain_row(row) for row in found.rows],
        "own": plain_row(found.own),
        "requested_error": error,
        "recommended": best and plain_row(best),
        "fits": fits and [asdict(row) for row in fits],
        "plot": plot,
    }


def plain_row(row: Row) -> dict[str, Any]:
    """A row as JSON has it."""
    return {
        "integrator": row.setting.integrator,
        "step": row.step,
        "ratio": row.setting.ratio,
        "tolerance": row.setting.tolerance,
        "newton_iterations": row.setting.newton,
        "status": row.status,
        "runs": row.runs,
        "ms_per_step": row.ms_per_step,
        "seconds_per_simulated_second": row.seconds_per_second,
        "error": row.error,
        "max_error": row.max_error,
        "own": row.own,
        "pareto": row.pareto,
    }
