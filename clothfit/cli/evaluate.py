"""`clothfit evaluate`: how good is a fitted scene?"""

from __future__ import annotations

import os
from dataclasses import asdict
from typing import TYPE_CHECKING, Any

import click

from clothfit.base.messages import metres, owned
from clothfit.cli.common import motions, pictures, scenes
from clothfit.cli.common.console import Console
from clothfit.cli.common.options import check_numbers, refuse, section, standard_command
from clothfit.cli.common.output import Output, page_beside, print_json
from clothfit.cli.parts import evaluate_speed
from clothfit.formats.registry import SUBSPACE, kind_of

if TYPE_CHECKING:
    from clothfit.evaluation.evaluate import Evaluation
    from clothfit.formats.axes import Reading
    from clothfit.subspace.judge import Compared, Judgement


@standard_command("evaluate")
@click.argument("scene_path", metavar="SCENE")
@click.argument("fitted_path", metavar="FITTED", required=False)
@section("What to compare")
@click.option("--target", "target_path", metavar="MOTION", help="Compare with this motion instead of SCENE's own.")
@click.option("--steps", type=int, metavar="N",
              help="Simulate N steps for the longer comparison.  [default: 499; with --speed those of SCENE]")
@scenes.forces
@section("The file of the target")
@motions.reads
@section("How fast and how exact (--speed)")
@click.option("--speed", is_flag=True, help="Measure the speed and error of integrators, steps and tolerances instead.")
@click.option("--error", type=float, metavar="METRES",
              help="With --speed: recommend the cheapest setting within this error.")
@click.option("--budget", type=float, metavar="SECONDS",
              help="With --speed: measure for about this long.  [default: 60]")
@section("A subspace (MODEL in place of FITTED)")
@click.option("--inputs", "inputs_path", metavar="FILE",
              help="Of a subspace: compare under these inputs over time (JSON).  [default: those of SCENE]")
@click.option("--report", "page_path", metavar="FILE",
              help="Of a subspace: write a page here that plays it over the full motion, side by side.")
@section("What is written")
@pictures.options
def command(
    scene_path: str, fitted_path: str | None, target_path: str | None, reading: Reading, steps: int | None,
    forces_path: str | None, speed: bool, error: float | None, budget: float | None, inputs_path: str | None,
    page_path: str | None, pictures: pictures.Pictures, console: Console,
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
        evaluate_speed.measure(scene_path, asked, console)
        return
    refuse({"--error": error, "--budget": budget}, "{} goes with --speed only")
    if fitted_path is None:
        context = click.get_current_context()
        missing = next(p for p in context.command.params if p.name == "fitted_path")
        raise click.MissingParameter(ctx=context, param=missing)
    if kind_of(fitted_path) == SUBSPACE:
        others: dict[str, object] = {"--target": target_path, "--forces": forces_path}
        refuse(others, "{} does not go with a subspace")
        judge(scene_path, fitted_path, inputs_path, steps, pictures, page_path, console)
        return
    refuse({"--inputs": inputs_path, "--report": page_path}, "{} goes with a subspace only")
    compare(scene_path, fitted_path, target_path, reading, steps, forces_path, pictures, console)


def compare(
    scene_path: str, fitted_path: str, target_path: str | None, reading: Reading, steps: int | None,
    forces_path: str | None, pictures: pictures.Pictures, console: Console,
) -> None:
    """Compare a fitted scene with the true one."""
    scenes.one_stream(scene_path, fitted_path, target_path)
    check_numbers(steps)
    paths = scene_path, fitted_path
    scenes.check_there(*paths)
    pictures.check(*paths, target_path, forces_path)
    truth, fitted = (scenes.under_forces(scenes.read_scene(each, console), forces_path) for each in paths)
    from clothfit.evaluation.evaluate import HORIZON, evaluate

    horizon = HORIZON if steps is None else scenes.frames_of(steps, truth)
    readings: list[dict[str, Any]] = []
    target = motions.read(target_path, truth, reading, console, readings) if target_path is not None else None
    for each in (truth, fitted) if target is None else (fitted,):
        scenes.warn_of_steps(each, max(truth.frames, horizon), console)
    console.announce_compilation()
    report = evaluate(truth, fitted, horizon=horizon, target=target)
    if not print_json(summary(report) | motions.readings_summary(readings)):
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


# ---- `clothfit evaluate SCENE MODEL`: how far a subspace is from the full simulation, and what both cost.

NORMALS = {"faces": "(of the faces)", "regression": "(by regression)"}
NAMES = {"regression": "(normals by regression)"}

ROUNDING = 1e-9
"""Relative energy that is none."""


def judge(
    scene_path: str, model_path: str, inputs_path: str | None, steps: int | None, pictures: pictures.Pictures,
    page_path: str | None, console: Console,
) -> None:  # fmt: skip
    """Compare a model with the scene's own simulation."""
    from clothfit.subspace.judge import compare
    from clothfit.subspace.model import load_model

    scenes.check_there(scene_path, model_path)
    pictures.check(scene_path, model_path, inputs_path, page_path)
    page = page_beside(page_path, (scene_path, model_path, inputs_path, *pictures.files))
    model = load_model(model_path)
    scene = scenes.with_inputs(scenes.read_scene(scene_path, console), inputs_path)
    console.announce_compilation()
    over = compare(model, scene, scenes.frames_of(steps, scene))
    for sentence in over.found.clamped:
        console.warn(sentence)
    if not print_json(asdict(over.found) | {"forgets": over.found.forgets}):
        show_judgement(over.found, console)
    draw(over, model_path, inputs_path, pictures, page, console)


def draw(
    over: Compared, model_path: str, inputs_path: str | None, pictures: pictures.Pictures, page: Output | None,
    console: Console,
) -> None:
    """Write the pictures and the page that are asked for."""
    pictures.drawn("comparison", (over,), console)
    pictures.animated(over.scene, over.full.times, over.own.positions, over.full.positions, console)
    if page is not None:
        from clothfit.cli import report
        from clothfit.report.page import page as page_of
        from clothfit.report.subspace_contents import subspace_content

        files: dict[str | None, object] = dict.fromkeys((model_path, inputs_path))
        origin = [report.command_line(click.get_current_context())], report.digests([over.scene], files)
        made = page_of(subspace_content(over, os.path.basename(model_path)), *origin)
        page.write(made)
        console.say(f"page, {len(made) / 1e6:.2g} MB → {page.name}")


def show_judgement(found: Judgement, console: Console) -> None:
    """Print the judgement as tables."""
    console.table([("frames", "RMSE until then"), *((str(end), metres(error)) for end, error in found.over_time)])
    console.result(f"{100 * found.relative_rmse:.2g} % of the motion's RMS, {metres(found.max_error)} at most")
    if found.chaotic:
        console.result(
            f"a small difference at the start grows {found.growth:.2g}-fold in the full simulation, and so does what a "
            "basis leaves out"
        )
    if found.forgets:
        console.result(
            f"the two motions have parted: compare their spectra and deviations, not their points: spectrum within "
            f"{100 * found.spectrum:.2g} %, standard deviations of the vertices within {100 * found.deviation:.2g} %"
        )
    if found.floor:
        from clothfit.subspace.judge import at_best

        console.result(at_best(found.floor))
    gain = "never more than was given"
    if found.energy_gain > ROUNDING:
        gain = f"at most {100 * found.energy_gain:.2g} % more than was given"
    energy = f"stored energy within {100 * found.energy:.2g} %, {gain}"
    console.result(f"drift {metres(found.drift)}, of the mean shape in the last fifth; {energy}")
    parts = [f"{value:.2g}° {NORMALS[name]}" for name, value in found.normals.items()]
    if parts:
        console.result(f"normals off by {', '.join(parts)}")
    rows = [(NAMES.get(name, name), f"{value:.0f} µs") for name, value in found.us_per_frame.items()]
    console.table([("a frame", "time"), *rows, ("together", f"{found.us_whole:.0f} µs"),
                   ("a full step", f"{found.full_us_per_step:.0f} µs")])  # fmt: skip
    faster = found.full_us_per_step / found.us_whole
    console.result(f"{found.megabytes:.2g} MB; {faster:.2g} times as fast as full steps")
    if faster <= 1.0:
        console.warn("the subspace does not pay: a frame of it takes longer than a full step")
