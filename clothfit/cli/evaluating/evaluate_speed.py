"""`clothfit evaluate --speed`: what accuracy does each second buy?"""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import asdict, dataclass
from typing import TYPE_CHECKING, Any

from clothfit.base.errors import InvalidInput
from clothfit.cli.common.console import Console
from clothfit.cli.common.options import check_least
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


def measure(scene_path: str, asked: SpeedOptions, as_json: bool, console: Console) -> None:
    """Measure integrators, and methods of estimation where asked; print and draw the result."""
    check_values(asked.error, asked.budget, asked.max_evaluations)
    scene = read_scene(scene_path, console)
    frames = frames_of(asked.steps, scene)
    if asked.plot is not None:
        check_plot(asked.plot, scene_path)
    if asked.fit and not scene.blocks:
        raise InvalidInput(f"{scene.name}: --fit: no object flags anything to fit; set its optimizationSettings")
    from clothfit.evaluation import fit_methods
    from clothfit.evaluation import work_precision as precision

    console.announce_compilation()
    with progress(console) as report:
        found = precision.work_precision(scene, frames, asked.budget or precision.MEASURE_SECONDS, report)
        evaluations = asked.max_evaluations or fit_methods.FIT_EVALUATIONS
        fits = fit_methods.compare_methods(scene, evaluations=evaluations, report=report) if asked.fit else None
    if asked.plot is not None:
        from clothfit.pictures.diagram import save_diagram

        with uninterrupted():
            save_diagram(found, asked.plot, asked.error)
    if as_json:
        print_json("evaluate", summary(found, scene, asked, fits))
        return
    speed_table.show(found, scene, asked.error, console)
    if fits is not None:
        speed_table.show_fits(fits, console)
    if asked.plot is not None:
        console.say(f"diagram → {asked.plot}")


def check_values(error: float | None, budget: float | None, max_evaluations: int | None) -> None:
    """Raise InvalidInput on option values that cannot be."""
    for name, value, unit in (("--error", error, "m"), ("--budget", budget, "s")):
        if value is not None and not 0 < value < float("inf"):
            raise InvalidInput(f"{name} must be above 0 and finite; {value:g} {unit} was given")
    check_least(1, max_evaluations=max_evaluations)


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
        "reference": {name: getattr(reference, name) for name in ("integrator", "step", "order", "error")},
        "rows": [plain_row(row) for row in found.rows],
        "own": plain_row(found.own),
        "requested_error": asked.error,
        "recommended": best and plain_row(best),
        "fits": fits and [asdict(row) for row in fits],
        "plot": asked.plot,
    }


def plain_row(row: Row) -> dict[str, Any]:
    """A row as JSON has it: with its setting's values beside its own."""
    values = asdict(row)
    setting: dict[str, Any] = values.pop("setting")
    setting["newton_iterations"] = setting.pop("newton")
    values["seconds_per_simulated_second"] = values.pop("seconds_per_second")
    return setting | values
