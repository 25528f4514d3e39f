"""`clothfit evaluate`: how good is a fitted scene?"""

from __future__ import annotations

from dataclasses import asdict
from typing import TYPE_CHECKING, Any

import click

from clothfit.base.messages import metres, owned
from clothfit.cli.common import motions, pictures, scenes
from clothfit.cli.common.console import Console
from clothfit.cli.common.options import check_numbers, standard_command
from clothfit.cli.common.output import print_json
from clothfit.cli.common.scenes import check_there, frames_of, one_stream, read_scene, under_forces, warn_of_steps
from clothfit.cli.parts import evaluate_speed

if TYPE_CHECKING:
    from clothfit.evaluation.evaluate import Evaluation
    from clothfit.formats.axes import Reading


SPEED_OPTIONS = ("--speed", "--error", "--budget")


SECTIONS = {
    "What to compare": ("--target", "--steps", "--forces"),
    "The file of the target": motions.FILE_OPTIONS,
    "How fast and how exact (--speed)": SPEED_OPTIONS,
    "A subspace (MODEL in place of FITTED)": ("--inputs", "--report"),
    "What is written": ("--plot", "--gif"),
}


@standard_command("evaluate", SECTIONS)
@click.argument("scene_path", metavar="SCENE")
@click.argument("fitted_path", metavar="FITTED", required=False)
@click.option("--target", "target_path", metavar="MOTION", help="Compare with this motion instead of SCENE's own.")
@motions.reads
@click.option("--steps", type=int, metavar="N",
              help="Simulate N steps for the longer comparison.  [default: 499; with --speed those of SCENE]")
@scenes.forces
@click.option("--speed", is_flag=True, help="Measure the speed and error of integrators, steps and tolerances instead.")
@click.option("--error", type=float, metavar="METRES",
              help="With --speed: recommend the cheapest setting within this error.")
@click.option("--budget", type=float, metavar="SECONDS",
              help="With --speed: measure for about this long.  [default: 60]")
@click.option("--inputs", "inputs_path", metavar="FILE",
              help="Of a subspace: compare under these inputs over time (JSON).  [default: those of SCENE]")
@click.option("--report", "page_path", metavar="FILE",
              help="Of a subspace: write a page here that plays it over the full motion, side by side.")
@pictures.options
def command(
    scene_path: str, fitted_path: str | None, target_path: str | None, reading: Reading, steps: int | None,
    forces_path: str | None, speed: bool, error: float | None, budget: float | None, inputs_path: str | None,
    page_path: str | None, pictures: pictures.Pictures, as_json: bool, console: Console,
) -> None:
    """Measure how far the motion and the parameters of FITTED are from those of SCENE.

    With --speed and without FITTED, compare ways to simulate SCENE: the error and the time of each. With a MODEL of
    clothfit subspace in place of FITTED, compare its motion and its time with those of the full simulation.

    \b
    clothfit evaluate scene.json scene.fitted.json
    clothfit evaluate scene.json scene.fitted.json --target capture.npz --json
    clothfit evaluate scene.json scene.fitted.json --plot error.png --gif error.gif
    clothfit evaluate scene.json --speed --error 0.02 --plot speed.svg
    clothfit evaluate scene.json scene.model.npz --json
    """
    if speed:
        alone: dict[str, object] = {"FITTED": fitted_path, "--target": target_path, "--gif": pictures.gif}
        refuse(alone | {"--forces": forces_path}, "--speed takes one scene; {} does not go with it")
        asked = evaluate_speed.SpeedOptions(steps, error, budget, pictures.plot)
        evaluate_speed.measure(scene_path, asked, as_json, console)
        return
    refuse({"--error": error, "--budget": budget}, "{} goes with --speed only")
    if fitted_path is None:
        context = click.get_current_context()
        missing = next(p for p in context.command.params if p.name == "fitted_path")
        raise click.MissingParameter(ctx=context, param=missing)
    if of_subspace(fitted_path):
        others: dict[str, object] = {"--target": target_path, "--forces": forces_path}
        refuse(others, "{} does not go with a subspace")
        from clothfit.cli.parts import evaluate_subspace

        evaluate_subspace.measure(
            scene_path, fitted_path, inputs_path, steps, pictures, page_path, as_json, console
        )
        return
    refuse({"--inputs": inputs_path, "--report": page_path}, "{} goes with a subspace only")
    compare(scene_path, fitted_path, target_path, reading, steps, forces_path, pictures, as_json, console)


def of_subspace(path: str) -> bool:
    """Whether a file is a subspace."""
    from clothfit.formats.registry import SUBSPACE, kind_of

    return kind_of(path) == SUBSPACE


def refuse(given: dict[str, object], why: str) -> None:
    """Raise a usage error, with the name in it, at the first argument that is given."""
    for name, value in given.items():
        if value is not None:
            raise click.UsageError(why.format(name), click.get_current_context())


def compare(
    scene_path: str, fitted_path: str, target_path: str | None, reading: Reading, steps: int | None,
    forces_path: str | None, pictures: pictures.Pictures, as_json: bool, console: Console,
) -> None:
    """Compare a fitted scene with the true one."""
    one_stream(scene_path, fitted_path, target_path)
    check_numbers(steps)
    check_there(scene_path, fitted_path)
    pictures.check(scene_path, fitted_path, target_path, forces_path)
    truth, fitted = (under_forces(read_scene(each, console), forces_path) for each in (scene_path, fitted_path))
    from clothfit.evaluation.evaluate import HORIZON, evaluate

    horizon = HORIZON if steps is None else frames_of(steps, truth)
    readings: list[dict[str, Any]] = []
    target = motions.read(target_path, truth, reading, console, readings) if target_path is not None else None
    for each in (truth, fitted) if target is None else (fitted,):
        warn_of_steps(each, max(truth.frames, horizon), console)
    console.announce_compilation()
    report = evaluate(truth, fitted, horizon=horizon, target=target)
    if as_json:
        print_json("evaluate", summary(report) | motions.readings_summary(readings))
    else:
        show(report, console)
    pictures.evaluated(truth, fitted, target, horizon, report, console)
    if report.diverged:
        from clothfit.motion.divergence import Diverged

        raise Diverged(f"{report.diverged}; the horizon ends before that", report.horizon.frames)


def summary(report: Evaluation) -> dict[str, Any]:
    """What --json prints."""
    return {
        **asdict(report.fitted),
        "horizon": asdict(report.horizon),
        "diverged": report.diverged,
        "parameters": [asdict(deviation) for deviation in report.parameters],
    }


def show(report: Evaluation, console: Console) -> None:
    """Print the report as two tables."""
    rows: list[tuple[str, ...]] = [("motion", "frames", "RMSE", "largest error")]
    for name, part in (("fitted", report.fitted), ("horizon", report.horizon)):
        rows.append((name, str(part.frames), metres(part.rmse), metres(part.max_error)))
    console.table(rows)
    if report.parameters:
        console.result("")
        rows = [("parameters", "count", "median deviation", "largest deviation")]
        for d in report.parameters:
            values = [
                "not identifiable" if v is None else f"{v:.2g}"
                for v in (d.median_relative_deviation, d.max_relative_deviation)
            ]
            rows.append((f"{owned(d.object, d.name)} ({d.mode})", str(d.count), *values))
        console.table(rows)
