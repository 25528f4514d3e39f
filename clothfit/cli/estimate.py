"""`clothfit estimate`: fit the flagged parameters and write the scene back."""

from __future__ import annotations

from dataclasses import replace
from functools import partial
from typing import TYPE_CHECKING, Any

import click

from clothfit.base import interrupts
from clothfit.base.deferred import LINEAR_ALGEBRA, defer
from clothfit.base.errors import InvalidInput
from clothfit.base.messages import owned
from clothfit.cli.common import motions, pictures, running, scenes
from clothfit.cli.common.console import Console
from clothfit.cli.common.options import check_least, check_numbers, duration, refuse, section, standard_command
from clothfit.cli.common.output import keep_scene, uninterrupted
from clothfit.cli.common.progress import progress
from clothfit.cli.common.scenes import read_scene, under_forces, warn_of_steps
from clothfit.cli.parts import estimate_results, estimate_simulator
from clothfit.cli.parts.estimate_files import Files, bounds_of, read_start, read_target, weights
from clothfit.cli.parts.estimate_records import Recording
from clothfit.fit.options import FitOptions
from clothfit.many.job import INTERRUPTED
from clothfit.optimise.status import Status

if TYPE_CHECKING:
    from clothfit.formats.axes import Reading
    from clothfit.scene.scene import Scene


MOST_STARTS = 10_000
"""Of one scene; each is kept until the end."""


@standard_command("estimate")
@click.argument("scene_paths", metavar="SCENE...", nargs=-1, required=True)
@section("What to fit to")
@click.option("--target", "target_paths", metavar="MOTION[@SCENE]", multiple=True,
              help="Motion to match, and the scene it was recorded in; may be repeated.  "
              "[default: the scene's own motion]")
@scenes.forces
@click.option("--objective", "objectives", metavar="NAME[=WEIGHT]", multiple=True,
              help="Quantity to compare: position, velocity, edge-length or spectrum; may be repeated.  "
              "[default: position]")
@click.option("--loss", default="linear", metavar="NAME",
              help="Loss of a distance: linear, soft_l1 or huber.  [default: linear]")
@click.option("--loss-scale", type=float, metavar="METRES",
              help="Distances above this count as outliers.  [default: 0.01]")
@click.option("--fit-time", is_flag=True,
              help="Fit the rate and the offset of the target's clock too.")
@click.option("--fit-placement", is_flag=True,
              help="Fit how the target is turned and moved too.")
@click.option("--fit-scale", is_flag=True,
              help="Fit how large the target's unit is too.")
@click.option("--keep-markers", is_flag=True,
              help="Take the target's markers as they are, also where they are swapped or show no vertex.")
@section("The file of the target")
@motions.reads
@section("How to fit")
@click.option("--model", metavar="MODEL",
              help="How to fit the masses, stiffnesses and rest lengths that SCENE flags: F, one factor on their "
              "values; R, a factor for each family and region; M, smooth maps; G, one value; L, each by itself; or "
              "auto: the simplest of F, R, M and L, unless a freer one is clearly better on frames that are kept out. "
              "With --simulator xpbd L fits the values of each constraint.  "
              "[default: the flags]")
@click.option("--substeps", metavar="K",
              help="Time steps to a frame of the target, or auto, which takes more where the fit gains by them.  "
              "[default: auto for scenes with BDF2, else the scene's step]")
@click.option("--keep-step", is_flag=True, help="Keep the scene's time step and integrator.")
@click.option("--windows", type=int, metavar="N",
              help="Compare windows of N frames, each of which begins in the target's own state: for motions that are "
              "chaotic, or of another model.  [default: the whole motion]")
@click.option("--start", metavar="VALUE|SCENE",
              help="Values to start from.  [default: the scene's values with --target, else a coarse search]")
@click.option("--bounds", "bounds", metavar="KIND=LOW:HIGH", multiple=True,
              help="Bounds of a kind of value in its unit, such as stiffness=1:1e6; may be repeated.  "
              "[default: the scene's, else 1e-4 to 1e4, or more where its values lie outside]")
@click.option("--method", default="auto", metavar="NAME",
              help="Optimiser: auto, momentum, gauss-newton, l-bfgs-b or another one of SciPy.  [default: auto]")
@click.option("--budget", "time_budget", metavar="SECONDS",
              help="Stop after this time, such as 30, 30s, 2m or 1h, with the best so far.  "
              "[default: none; 30s where the model falls short of the target]")
@click.option("--max-evaluations", type=int, default=1000, metavar="N",
              help="Stop after N evaluations of the cost.  [default: 1000]")
@click.option("--rmse", type=float, metavar="METRES",
              help="Stop when the RMSE is below this.  [default: 1e-8, or the rounding of the target's numbers]")
@click.option("--tolerance", type=float, metavar="T", help="Relative tolerance of the linear solver.  [default: 1e-10]")
@click.option("--prior", default="auto", metavar="TAU",
              help="Prior width of the values around the start, in their logarithms; or none; or auto, which the data "
              "determine.  [default: auto]")
@section("How far to trust it")
@click.option("--holdout", type=float, metavar="FRACTION",
              help="Exclude this share of the target, and report the error on it.")
@click.option("--holdout-of", default="frames", metavar="WHAT",
              help="Exclude the last frames, or vertices.  [default: frames]")
@click.option("--no-intervals", is_flag=True,
              help="Skip the analysis of which parameters the motion determines, and the 95 % intervals.")
@section("What is written")
@click.option("-o", "--output", "path", metavar="SCENE",
              help="File of the fitted scene.  [default: <stem>.fitted<suffix>]")
@click.option("--report", "report_path", metavar="FILE",
              help="Write a page that shows the fit, as clothfit report does.")
@click.option("--in-place", is_flag=True, help="Write the fitted values into SCENE itself.")
@click.option("--log", metavar="FILE", help="Write a line of JSON for each iteration, and the summary.")
@pictures.options
@section("Long and large fits")
@click.option("--checkpoint", metavar="FILE", help="Save the state of the fit here.  [default: <output>.checkpoint]")
@click.option("--resume", is_flag=True, help="Continue an interrupted fit from its checkpoint.")
@click.option("--memory", metavar="SIZE",
              help="Use at most this much memory, such as 200MB.  [default: half of what is free]")
@running.option("Fit again, from the last result,", start=True)
@running.ends_with_input
@section("In another tool")
@estimate_simulator.options
@section("Many fits")
@click.option("--starts", type=int, default=1, metavar="K",
              help="Fit from K starts and keep the best result.  [default: 1]")
@click.option("--seed", type=int, default=0, metavar="S",
              help="Seed of the random starts after the first.  [default: 0]")
@click.option("--jobs", type=int, metavar="N", help="Run N fits at a time.  [default: one per core]")
@click.option("--cluster", metavar="ADDRESS", help="Run the fits on a Dask cluster; tcp://host:port of its scheduler.")
def command(
    scene_paths: tuple[str, ...], target_paths: tuple[str, ...], reading: Reading, forces_path: str | None,
    objectives: tuple[str, ...], start: str | None, substeps: str | None, time_budget: str | None,
    bounds: tuple[str, ...], max_evaluations: int, rmse: float | None, tolerance: float | None, checkpoint: str | None,
    resume: bool, no_intervals: bool, path: str | None, report_path: str | None, in_place: bool, starts: int, seed: int,
    jobs: int | None, cluster: str | None, log: str | None, pictures: pictures.Pictures, tool: estimate_simulator.Asked,
    console: Console, **as_given: Any,
) -> int:
    """Fit the parameters that SCENE flags and write the scene with only those numbers changed.

    Without --target, the fit tries to recover the scene's own parameters from its own motion. The costs of several
    targets are added; so are those of several objectives, each multiplied by its weight.

    Several scenes are fitted in parallel, one per core. In --target, --start, --checkpoint and -o, {stem} stands for
    the name of each scene without its suffix and {folder} for its folder.

    \b
    clothfit estimate scene.json
    clothfit estimate scene.json --target capture.npz -o fitted.json
    clothfit estimate scene.json --target one.npz --target two.npz@windy.json --objective velocity=0.01
    clothfit estimate scene.json --target 'frames/cloth_*.obj' --fps 30
    clothfit estimate scene.json --target capture.npz --holdout 0.2
    clothfit estimate scene.json --target capture.npz --plot fit.png --gif fit.gif --log fit.jsonl
    clothfit estimate *.json --target 'captures/{stem}.npz' -o fitted/
    clothfit estimate scene.json --target capture.npz --starts 8
    clothfit estimate scene.json --simulator xpbd --iterations 5
    clothfit estimate - < scene.json > fitted.json
    """
    check_values(max_evaluations, rmse, starts, seed, jobs)
    check_numbers(tolerance=tolerance)
    if any(as_given[name] for name in ("fit_time", "fit_placement", "fit_scale")) and not target_paths:
        raise click.UsageError("--fit-time, --fit-placement and --fit-scale are for the motion of --target; add that")
    tool.check(as_given["model"])
    if tool.simulator:
        files = Files(target_paths, start, path, in_place, checkpoint, resume, reading, forces_path)
        return estimate_simulator.fit(scene_paths, files, tool, substeps, as_given["model"], console)
    options = FitOptions(
        max_evaluations=max_evaluations, rmse=rmse, tolerance=tolerance, objective=weights(objectives),
        intervals=not no_intervals, bounds=bounds_of(bounds), substeps=substeps_of(substeps),
        budget=duration(time_budget, "--budget"), **as_given,
    )  # fmt: skip
    files = Files(target_paths, start, path, in_place, checkpoint, resume, reading, forces_path)
    single = len(scene_paths) == 1 and starts == 1 and cluster is None
    page = estimate_results.page_of(report_path, scene_paths, single, files)
    if not single:
        alone = {"--plot": pictures.plot, "--gif": pictures.gif, "--log": log, "--forces": forces_path}
        refuse(alone, "{} is for one scene fitted from one start on this machine")
        from clothfit.cli.parts import estimate_many

        effort = estimate_many.Effort(starts, seed, jobs, cluster)
        return estimate_many.fit(scene_paths, files, options, effort, console)
    recording = Recording(pictures, log)
    own = files.of(scene_paths[0])
    return fit_one(scene_paths[0], own, options, recording, page, console)


def fit_one(
    scene_path: str, files: Files, options: FitOptions, recording: Recording, page: estimate_results.Page | None,
    console: Console,
) -> int:
    """Fit one scene in this process; returns the exit code."""
    files.check(scene_path)
    scene = under_forces(read_scene(scene_path, console), files.forces)
    out = files.output(scene_path)
    if page:
        page.output(scene_path, files, out)
    defer(LINEAR_ALGEBRA)
    from clothfit.cli.parts import checkpoints
    from clothfit.fit import estimate as fitting
    from clothfit.optimise.checkpoint import Checkpoint

    options.check()
    recording = recording.of(scene_path)
    others = (scene_path, *files.inputs, out.path, files.checkpoint, page.path if page else None)
    recording.check(others, files.resume, console)
    inputs = scene_path, *files.inputs
    kept = checkpoints.chosen(files.checkpoint, files.resume, out, inputs, console, Checkpoint)
    readings: list[dict[str, Any]] = []
    targets = [read_target(pair, scene, files.reading, console, readings) for pair in files.pairs]
    first = read_start(files.start, console)
    check_start(scene, first)
    flagged = ", ".join(f"{owned(b.cloth, b.name)} ({b.mode})" for b in scene.blocks)
    console.detail(f"fitting {flagged or 'nothing'} over {scene.frames} frames")
    warn_of_steps(scene, scene.frames, console)
    console.announce_compilation()
    with interrupts.deferred():
        with progress(console) as show:
            report = page.listening(recording.report(show)) if page else recording.report(show)
            own = replace(
                options, on_progress=report, checkpoint=kept, resume=files.resume,
                on_memory=lambda needs: (console.detail if needs.snapshots is None else console.say)(str(needs)),
                on_hint=lambda hint: console.say(f"hint: {hint.text}"), on_found=partial(keep_scene, out=out),
            )  # fmt: skip
            found = fitting.fit(scene, targets or None, first, own)
        with uninterrupted(), checkpoints.named_if_lost(kept):
            more = motions.readings_summary(readings)
            code = estimate_results.finish(scene, found, out, console, more, recording.log)
            checkpoints.closed(kept, files.checkpoint is not None, found.status, files.in_place, console)
        late = interrupts.requested() and found.status != Status.INTERRUPTED
    if late:
        return INTERRUPTED
    targets = estimate_results.as_compared(targets, found, scene)
    recording.draw(found, scene, targets, console)
    if page:
        page.write(scene_path, scene, found, files, out, targets, console)
    return code


def check_start(scene: Scene, start: Any) -> None:
    """Raise InvalidInput where numbers to start from cannot be, before anything is compiled."""
    from clothfit.scene.fit_vector import parameters
    from clothfit.scene.scene import Scene as Values
    from clothfit.strategy.start import given_start

    if start is not None and not isinstance(start, Values):
        given_start(scene, start, parameters(scene))


def substeps_of(text: str | None) -> int | str | None:
    """The number of time steps to a frame, or "auto". Raises InvalidInput."""
    if text is None or text == "auto":
        return text
    try:
        return int(text)
    except ValueError:
        raise InvalidInput(f"--substeps must be auto or a whole number from 1 on; {text!r} was given") from None


def check_values(max_evaluations: int, rmse: float | None, starts: int, seed: int, jobs: int | None) -> None:
    """Raise InvalidInput on option values that cannot be."""
    check_least(1, max_evaluations=max_evaluations, starts=starts, jobs=jobs)
    check_least(0, seed=seed)
    if rmse is not None and not rmse >= 0:
        raise InvalidInput(f"--rmse must be at least 0; {rmse:g} m was given")
    if starts > MOST_STARTS:
        raise InvalidInput(f"--starts must be at most {MOST_STARTS}; {starts} was given")
