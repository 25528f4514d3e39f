"""`clothfit evaluate --speed`: what accuracy does each second buy?"""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import asdict, dataclass
from typing import TYPE_CHECKING, Any

from clothfit.base.errors import InvalidInput
from clothfit.cli.common.console import Console
from clothfit.cli.common.output import STREAM, print_json, same_file, uninterrupted
from clothfit.cli.common.progress import PLAIN_INTERVAL
from clothfit.cli.common.scenes import frames_of, read_scene
from clothfit.cli.evaluating import speed_table

if TYPE_CHECKING:
    from clothfit.evaluation.fit_methods import FitRow
    from clothfit.evaluation.work_precision import Row, WorkPrecision
    from clothfit.scene.scene import Scene

Report = Callable[[float, str], None]


@dataclass(frozen=True)
class SpeedOptions:
    """The options of `--speed`; None where one is not given."""

    steps: int | None
    error: float | None  # m: the cheapest setting within it is recommended
    budget: float | None  # s to measure
    fit: bool  # whether the methods of estimation are compared too
    max_evaluations: int | None  # of each of them
    plot: str | None  # file of the diagram


def measure(scene_path: str, asked: SpeedOptions, as_json: bool, console: Console) -> int:
    """Measure integrators, and methods of estimation where asked; print and draw the result."""
    check_values(asked.error, asked.budget, asked.max_evaluations)
    scene = read_scene(scene_path, console)
    frames = frames_of(asked.steps, scene)
    if asked.plot is not None:
        check_plot(asked.plot, scene_path)
    if asked.fit:
        check_flags(scene)
    from clothfit.evaluation import work_precision as precision

    console.announce_compilation()
    with progress(console) as report:
        found = precision.work_precision(scene, frames, asked.budget or precision.MEASURE_SECONDS, report)
        fits = compare_fits(scene, asked.max_evaluations, report) if asked.fit else None
    if asked.plot is not None:
        from clothfit.pictures.diagram import save_diagram

        with uninterrupted():
            save_diagram(found, asked.plot, asked.error)
    if as_json:
        print_json("evaluate", summary(found, scene, asked, fits))
        return 0
    speed_table.show(found, scene, asked.error, console)
    if fits is not None:
        speed_table.show_fits(fits, console)
    if asked.plot is not None:
        console.say(f"diagram → {asked.plot}")
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

    if scene_path != STREAM and same_file(plot, scene_path):
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


def summary(found: WorkPrecision, scene: Scene, asked: SpeedOptions, fits: list[FitRow] | None) -> dict[str, Any]:
    """What --json prints."""
    best = None if asked.error is None else found.recommended(asked.error)
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
        "requested_error": asked.error,
        "recommended": best and plain_row(best),
        "fits": fits and [asdict(row) for row in fits],
        "plot": asked.plot,
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
