"""`clothfit estimate`: fit the flagged parameters and write the scene back."""

from __future__ import annotations

from dataclasses import replace
from functools import partial
from typing import TYPE_CHECKING, Any

import click

from clothfit.base import interrupts
from clothfit.base.deferred import LINEAR_ALGEBRA, defer
from clothfit.base.errors import InvalidInput
from clothfit.base.limits import duration
from clothfit.base.messages import owned
from clothfit.cli import report
from clothfit.cli.common import motions, output, pictures, running
from clothfit.cli.common.console import Console
from clothfit.cli.common.motions import read_scene, under_forces, unlikely, warn_of_steps
from clothfit.cli.common.options import check_least, check_numbers, gathered, option, refuse, section, standard_command
from clothfit.cli.common.progress import progress
from clothfit.cli.parts import estimate_files, estimate_results
from clothfit.cli.parts.estimate_files import Effort, Files, bounds_of, filled, read_start, read_target, weights
from clothfit.cli.parts.estimate_results import Page, Recording
from clothfit.fit.options import FitOptions, asked_fit
from clothfit.many.job import INTERRUPTED
from clothfit.optimise.status import Status

if TYPE_CHECKING:
    from clothfit.fit.hints import Hint
    from clothfit.scene.scene import Scene

@standard_command("estimate")
@click.argument("scene_paths", metavar="SCENE...", nargs=-1, required=True)
@section("What to fit to")
@option("--target MOTION[@SCENE]", "Motion to match, and the scene it was recorded in; may be repeated. Of a drape "
        "also outline=FILE, x and z of its shadow in each line, or coefficient=NUMBER.  [default: the scene's own "
        "motion]",
        name="target_paths", multiple=True)
@motions.forces
@option("--objective NAME[=WEIGHT]", "Quantity to compare: position, velocity, edge-length or spectrum; "
        "of shadows outline or coverage; may be repeated.  [default: position, or what --target shows]",
        name="objectives", multiple=True)
@option("--loss NAME", "Loss of a distance: linear, soft_l1 or huber.  [default: linear]", default="linear")
@option("--loss-scale METRES", "Distances above this count as outliers.  [default: 0.01]", float)
@option("--fit-time", "Fit the rate and the offset of the target's clock too.")
@option("--fit-placement", "Fit how the target is turned and moved too.")
@option("--fit-scale", "Fit how large the target's unit is too.")
@option("--hold", "Keep fixed vertices still, also where they move in the target.  [default: they follow it]")
@option("--keep-markers", "Take the target's markers as they are, also where they are swapped or show no vertex.")
@section("The file of the target")
@motions.reads
@option("--bind HOW", "What its points are: order, the vertices of SCENE in order; surface, places on it, as the first "
        "frame shows; scan, others in each frame; or auto, whichever fits.  [default: auto]")
@section("How to fit")
@option("--model MODEL", "How to fit the masses, stiffnesses and rest lengths that SCENE flags: F, one factor on their "
        "values; R, a factor for each family and region; M, smooth maps; G, one value; L, each by itself; or auto: the "
        "simplest of F, R, M and L, unless a freer one is clearly better on frames that are kept out. With --simulator "
        "xpbd L fits the values of each constraint.  [default: the flags]")
@option("--fit KIND[=LETTER]", "Fit this in place of what SCENE flags, such as wind, stiffness=R or two letters as new "
        "has them; may be repeated. With auto the fit chooses.  [default: the flags]", name="fits", multiple=True)
@option("--substeps K", "Time steps to a frame of the target, or auto, which takes more where the fit gains by them.  "
        "[default: auto for scenes with BDF2, else the scene's step]")
@option("--keep-step", "Keep the scene's time step and integrator.")
@option("--windows N", "Compare windows of N frames, each of which begins in the target's own state: for motions that "
        "are chaotic, or of another model.  [default: the whole motion]", int)
@option("--start VALUE|SCENE", "Values to start from.  [default: the scene's values with --target, else a coarse "
        "search]")
@option("--bounds KIND=LOW:HIGH", "Bounds of a kind of value in its unit, such as stiffness=1:1e6; may be repeated.  "
        "[default: the scene's, else 1e-4 to 1e4, or more where its values lie outside]", name="bounds", multiple=True)
@option("--method NAME", "Optimiser: auto, momentum, gauss-newton, l-bfgs-b or another one of SciPy.  [default: auto]",
        default="auto")
@option("--budget SECONDS", "Stop after this time, such as 30, 30s, 2m or 1h, with the best so far.  [default: none; "
        "54s where the model falls short of the target]", name="time_budget")
@option("--max-evaluations N", "Stop after N evaluations of the cost.  [default: 1000]", int, default=1000)
@option("--rmse METRES", "Stop when the RMSE is below this.  [default: 1e-8, or the rounding of the target's numbers]",
        float)
@option("--tolerance T", "Relative tolerance of the linear solver.  [default: 1e-10]", float)
@option("--prior TAU", "Prior width of the values around the start, in their logarithms; or none; or auto, which the "
        "data determine.  [default: auto]", default="auto")
@section("How far to trust it")
@option("--holdout FRACTION", "Exclude this share of the target, and report the error on it.", float)
@option("--holdout-of WHAT", "Exclude the last frames, or vertices.  [default: frames]", default="frames")
@option("--no-intervals", "Skip the analysis of which parameters the motion determines, and the 95 % intervals.")
@section("What is written")
@option("-o --output SCENE", "File of the fitted scene.  [default: <stem>.fitted<suffix>]", name="path")
@option("--cache MOTION", "Write the fitted motion too, with the target's frames, axes and unit; for a USD target a "
        "copy of its file with the fitted cloth in it.")
@option("--report FILE", "Write a page that shows the fit, as clothfit report does.", name="report_path")
@option("--in-place", "Write the fitted values into SCENE itself.")
@option("--log FILE", "Write a line of JSON for each iteration, and the summary.")
@pictures.options
@section("Long and large fits")
@option("--checkpoint FILE", "Save the state of the fit here.  [default: <output>.checkpoint]")
@option("--resume", "Continue an interrupted fit from its checkpoint.")
@option("--memory SIZE", "Use at most this much memory, such as 200MB.  [default: half of what is free]")
@running.option("Fit again, from the last result,", start=True)
@running.ends_with_input
@section("In another tool")
@estimate_files.simulator_options
@section("Many fits")
@option("--starts K", "Fit from K starts and keep the best result.  [default: 1]", int, default=1)
@option("--seed S", "Seed of the random starts after the first.  [default: 0]", int, default=0)
@option("--jobs N", "Run N fits at a time.  [default: one per core]", int)
@option("--cluster ADDRESS", "Run the fits on a Dask cluster; tcp://host:port of its scheduler.")
@gathered("files", Files)
@gathered("effort", Effort)
def command(
    scene_paths: tuple[str, ...], files: Files, objectives: tuple[str, ...], substeps: str | None,
    time_budget: str | None, bounds: tuple[str, ...], fits: tuple[str, ...], no_intervals: bool,
    report_path: str | None, effort: Effort,
    log: str | None, pictures: pictures.Pictures, tool: estimate_files.Asked, console: Console, **as_given: Any,
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
    check_least(1, max_evaluations=as_given["max_evaluations"])
    effort.check()
    if (rmse := as_given["rmse"]) is not None and not rmse >= 0:
        raise InvalidInput(f"--rmse must be at least 0; {rmse:g} m was given")
    check_numbers(tolerance=as_given["tolerance"])
    if any(as_given[name] for name in ("fit_time", "fit_placement", "fit_scale")) and not files.target_paths:
        raise click.UsageError("--fit-time, --fit-placement and --fit-scale are for the motion of --target; add that")
    tool.check(as_given["model"])
    refuse({"--fit": fits if fits and tool.simulator else None}, "{} is for a fit of this program's own cloth")
    if tool.simulator:
        return estimate_files.fit_by_simulator(scene_paths, files, tool, substeps, as_given["model"], console)
    options = FitOptions(
        objective=weights(objectives, files.target_paths), intervals=not no_intervals, bounds=bounds_of(bounds),
        substeps=substeps_of(substeps), budget=duration(time_budget, "--budget"), **asked_fit(fits), **as_given,
    )  # fmt: skip
    single = len(scene_paths) == 1 and effort.starts == 1 and effort.cluster is None
    estimate_results.check_page(report_path, scene_paths, single, files)
    if not single:
        alone = {
            "--cache": files.cache, "--plot": pictures.plot, "--gif": pictures.gif, "--log": log,
            "--forces": files.forces_path,
        }  # fmt: skip
        refuse(alone, "{} is for one scene fitted from one start on this machine")
        from clothfit.cli.parts import estimate_many

        return estimate_many.fit(scene_paths, files, options, effort, console)
    return fit_one(scene_paths[0], files.of(scene_paths[0]), options, Recording(pictures, log), report_path, console)


def fit_one(
    scene_path: str, files: Files, options: FitOptions, recording: Recording, report_path: str | None, console: Console
) -> int:
    """Fit one scene in this process; returns the exit code."""
    files.check(scene_path)
    scene = under_forces(read_scene(scene_path, console), files.forces_path)
    out = files.output(scene_path)
    used = [scene_path, *files.inputs, out.path]
    cache = estimate_files.cache_place(files, used)
    used += [cache.path] if cache else []
    place = output.beside("--report", report_path and filled(report_path, scene_path), used, text=output.PAGE)
    page = place and Page(place, report.command_line(click.get_current_context()))
    defer(LINEAR_ALGEBRA)
    from clothfit.cli.parts import checkpoints
    from clothfit.fit import estimate as fitting
    from clothfit.fit.flags import reflagged
    from clothfit.optimise.checkpoint import Checkpoint
    from clothfit.registration.record import Registration

    options.check()
    recording = recording.of(scene_path)
    recording.check((*used, files.checkpoint, place.path if place else None), files.resume, console)
    kept = checkpoints.chosen(
        files.checkpoint, files.resume, out, (scene_path, *files.inputs), console, Checkpoint
    )
    readings: list[dict[str, Any]] = []
    targets = [read_target(pair, scene, files.reading, console, readings) for pair in files.pairs]
    named = bool(unlikely(scene)) or any("--" in (each["advice"] or "") for each in readings)
    first = read_start(files.start, console)
    scene = reflagged(scene, options)
    check_start(scene, first)
    flagged = ", ".join(f"{owned(b.cloth, b.name)} ({b.mode})" for b in scene.blocks)
    console.detail(f"fitting {flagged or 'nothing'} over {scene.frames} frames")
    warn_of_steps(scene, scene.frames, console)
    console.announce_compilation()
    with interrupts.deferred():
        with progress(console) as show:
            told = recording.report(show, page.note if page else None)
            own = replace(
                options, on_progress=told, checkpoint=kept, resume=files.resume,
                on_memory=lambda needs: (console.detail if needs.snapshots is None else console.say)(str(needs)),
                on_hint=partial(tell, named=named, console=console), on_found=partial(output.keep_scene, out=out),
            )  # fmt: skip
            found = fitting.by_options(scene, targets or None, first, own)
        with output.uninterrupted(), checkpoints.named_if_lost(kept):
            more = motions.readings_summary(readings)
            code = estimate_results.finish(scene, found, out, console, more, recording.log)
            checkpoints.of_fit(kept, files, found.status, console)
        if cache and found.status != Status.DIVERGED:
            known = found.registration[0] if found.registration else Registration()
            estimate_files.write_cache(found.scene, files, known, cache, console)
        late = interrupts.requested() and found.status != Status.INTERRUPTED
    if late:
        return INTERRUPTED
    targets = estimate_results.as_compared(targets, found, scene)
    recording.pictures.estimated(found, scene, targets, recording.history, console)
    if page:
        page.write(scene_path, scene, found, files, out, targets, console)
    return code


def tell(hint: Hint, named: bool, console: Console) -> None:
    """Say what a target shows before a fit; not again where reading has named the unit or the axes that would fit."""
    if not (named and hint.code in estimate_results.OF_UNITS):
        console.say(f"hint: {hint.text}")


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
