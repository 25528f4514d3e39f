"""`clothfit estimate`: fit the flagged parameters and write the scene back."""

from __future__ import annotations

from dataclasses import replace
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
from clothfit.cli.common.options import (
    check_least,
    check_numbers,
    gathered,
    option,
    refuse,
    section,
    setting,
    standard_command,
)
from clothfit.cli.common.progress import progress
from clothfit.cli.parts import estimate_files, estimate_results
from clothfit.cli.parts.estimate_files import Effort, Files, bounds_of, filled, read_start, read_target, weights
from clothfit.cli.parts.estimate_results import Page, Recording
from clothfit.fit.observer import Observer
from clothfit.fit.options import Request
from clothfit.many.job import INTERRUPTED
from clothfit.optimise.status import Status

if TYPE_CHECKING:
    from collections.abc import Callable

    from clothfit.fit.hints import Hint
    from clothfit.objective.memory_needs import Needs
    from clothfit.optimise.progress import Progress
    from clothfit.scene.scene import Scene

@standard_command("estimate")
@click.argument("scene_paths", metavar="SCENE...", nargs=-1, required=True)
@section("What to fit to")
@option("--target MOTION[@SCENE]", "Motion to match; without it, the scene's own. It may be repeated, with the scene "
        "it was recorded in after an @. Of a drape also outline=FILE, x and z of its shadow in each line, or "
        "coefficient=NUMBER.", name="target_paths", multiple=True)
@motions.with_forces
@setting("--objective NAME[=WEIGHT]", "Quantity to compare: position, velocity, edge-length or spectrum; of shadows "
         "outline or coverage; may be repeated, each with =WEIGHT.  [default: position, or what --target shows]",
         name="objectives", multiple=True)
@setting("--loss NAME", "Loss of a distance: linear, soft_l1 or huber.  [default: linear]", default="linear")
@setting("--loss-scale METRES", "Distances above this count as outliers.  [default: 0.01]", float)
@option("--fit-time", "Fit the rate and the offset of the target's clock too.")
@option("--fit-placement", "Fit how the target is turned and moved too.")
@option("--fit-scale", "Fit how large the target's unit is too.")
@option("--hold", "Fixed vertices stay where they are. Else they follow the target.")
@setting("--keep-markers", "Take the target's markers as they are, also where they are swapped or show no vertex.")
@section("How its file is read")
@motions.reads
@option("--bind HOW", "Its points are in order, on a surface or a scan. In order they are the vertices of SCENE; of a "
        "surface, places on it, as the first frame shows; of a scan, others in each frame; auto finds out.  [default: "
        "auto]")
@section("How to fit")
@option("--fit KIND[=LETTER]", "Fit this in place of SCENE's flags, or auto. KIND is stiffness, wind … as in new; two "
        "letters are for masses and stiffnesses; it may be repeated. With auto the fit chooses.", name="fits",
        multiple=True)
@option("--model MODEL", "F, R, M, G, L or auto, in place of the flags'. F is one factor on the values of masses, "
        "stiffnesses and rest lengths; R, a factor for each family and region; M, smooth maps; G, one value; L, each "
        "by itself; auto: the simplest of F, R, M and L, unless a freer one is clearly better on frames that are kept "
        "out. With --simulator xpbd L fits the values of each constraint.")
@option("--substeps K", "Time steps to a frame of the target, or auto, which takes more where the fit gains by them.  "
        "[default: auto for scenes with BDF2, else the scene's step]")
@option("--keep-step", "Keep the scene's time step and integrator.")
@setting("--windows N", "Compare windows of N frames, each of which begins in the target's own state: for motions that "
         "are chaotic, or of another model.  [default: the whole motion]", int)
@option("--start VALUE|SCENE", "Values to start from.  [default: the scene's with --target, else a coarse search]")
@option("--bounds KIND=LOW:HIGH", "Bounds of a kind of value in its unit, such as stiffness=1:1e6; may be repeated.  "
        "[default: the scene's, else 1e-4 to 1e4, or more where its values lie outside]", name="bounds", multiple=True)
@option("--method NAME", "Optimiser: auto, momentum, gauss-newton, l-bfgs-b or another one of SciPy.  [default: auto]",
        default="auto")
@option("--budget SECONDS", "Stop after this time, such as 30 or 2m. The best so far is the result. Without it a fit "
        "ends after 54s where the model falls short of the target.", name="time_budget")
@setting("--max-evaluations N", "Stop after N evaluations of the cost.  [default: 1000]", int, default=1000)
@setting("--rmse METRES", "Stop when the RMSE is below this.  [default: 1e-8, or the rounding of the target's numbers]",
         float)
@setting("--tolerance T", "Relative tolerance of the linear solver.  [default: 1e-10]", float)
@setting("--prior TAU", "Prior width of the values around the start, in their logarithms; or none; or auto, which the "
         "data determine.  [default: auto]", default="auto")
@section("How far to trust it")
@option("--holdout FRACTION", "Keep this share of the target out, to judge by.", float)
@setting("--holdout-of WHAT", "Keep the last frames out, or vertices.  [default: frames]", default="frames")
@setting("--intervals/--no-intervals", "No: skip the analysis of which parameters the motion determines, and the 95 % "
         "intervals.",
         is_flag=True, default=True)
@section("What is written")
@option("-o --output SCENE", "Fitted scene.  [default: <stem>.fitted<suffix>]", name="path")
@option("--cache MOTION", "Fitted motion, in the target's frames and axes. For a USD target it is a copy of its file "
        "with the fitted cloth in it.")
@option("--report FILE", "Page that plays the fit over the target.", name="report_path")
@option("--in-place", "Write the fitted values into SCENE itself.")
@option("--log FILE", "Write a line of JSON for each iteration, and the summary.")
@pictures.options
@section("Long and large fits")
@setting("--checkpoint FILE", "Save the state of the fit here.  [default: <output>.checkpoint]")
@option("--resume", "Continue an interrupted fit from its checkpoint.")
@setting("--memory SIZE", "Use at most this much memory, such as 200MB.  [default: half of what is free]")
@running.option("Fit again, from the last result,", start=True)
@running.ends_with_input
@section("In another tool")
@estimate_files.simulator_options
@section("Many fits")
@option("--starts K", "Fit from K starts and keep the best result.  [default: 1]", int, default=1)
@setting("--seed S", "Seed of the random starts after the first.  [default: 0]", int, default=0)
@option("--jobs N", "Run N fits at a time.  [default: one per core]", int)
@option("--cluster ADDRESS", "Run the fits on a Dask cluster; tcp://host:port of its scheduler.")
@gathered("files", Files)
@gathered("effort", Effort)
def command(
    scene_paths: tuple[str, ...], files: Files, objectives: tuple[str, ...], substeps: str | None,
    time_budget: str | None, bounds: tuple[str, ...], fits: tuple[str, ...],
    report_path: str | None, effort: Effort,
    log: str | None, pictures: pictures.Pictures, tool: estimate_files.Given, console: Console, **as_given: Any,
) -> int:
    """Fit the values that SCENE flags to a motion; write the scene with only those numbers changed.

    Without --target, the fit tries to recover the scene's own parameters from its own motion. The costs of several
    targets are added; so are those of several objectives, each multiplied by its weight.

    Several scenes are fitted in parallel, one per core. In --target, --start, --set checkpoint and -o, {stem} stands
    for the name of each scene without its suffix and {folder} for its folder.

    \b
    clothfit estimate scene.json --target capture.npz -o fitted.json
    clothfit estimate scene.json --target 'frames/cloth_*.obj' --fps 30 --holdout 0.2
    clothfit estimate scene.json --target shot.usd --fit auto --report fit.html
    clothfit estimate scene.json --target capture.c3d --set map=markers.csv --set loss=huber
    clothfit estimate *.json --target 'captures/{stem}.npz' -o fitted/
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
    options = Request(
        objective=weights(objectives, files.target_paths), bounds=bounds_of(bounds), substeps=substeps_of(substeps),
        time_limit=duration(time_budget, "--budget"), fit=fits, **as_given,
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
    scene_path: str, files: Files, options: Request, recording: Recording, report_path: str | None, console: Console
) -> int:
    """Fit one scene in this process; returns the exit code."""
    files.check(scene_path)
    scene = under_forces(read_scene(scene_path, console), files.forces_path)
    out = files.output(scene_path)
    used = [scene_path, *files.inputs, out.path]
    cache = estimate_files.cache_place(files, used)
    used += [cache.path] if cache else []
    place = output.companion_file("--report", report_path and filled(report_path, scene_path), used, text=output.PAGE)
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
    if not (options.fit_placement or options.fit_scale):
        estimate_files.check_read(readings, files.reading)
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
            tell = recording.report(show, page.note if page else None)
            own = replace(
                options, checkpoint=kept, resume=files.resume, observer=Watching(tell, named, out, console)
            )
            fit = fitting.by_request(scene, targets or None, first, own)
        with output.uninterrupted(), checkpoints.named_if_lost(kept):
            more = motions.readings_summary(readings)
            code = estimate_results.finish(scene, fit, out, console, more, recording.log)
            checkpoints.of_fit(kept, files, fit.status, console)
        if cache and fit.status != Status.DIVERGED:
            known = fit.registration[0] if fit.registration else Registration()
            estimate_files.write_cache(fit.scene, files, known, cache, console)
        late = interrupts.requested() and fit.status != Status.INTERRUPTED
    if late:
        return INTERRUPTED
    targets = estimate_results.as_compared(targets, fit, scene)
    recording.pictures.estimated(fit, scene, targets, recording.history, console)
    if page:
        page.write(scene_path, scene, fit, files, out, targets, console)
    return code


class Watching(Observer):
    """Says what a fit finds while it runs, and keeps its scene."""

    def __init__(
        self, report: Callable[[Progress], None] | None, named: bool, out: output.Output, console: Console
    ) -> None:
        """`named`: whether reading has named the unit or the axes that would fit, which a hint need not do again."""
        self.report, self.named, self.out, self.console = report, named, out, console

    def progress(self, progress: Progress) -> None:
        if self.report:
            self.report(progress)

    def hint(self, hint: Hint) -> None:
        if not (self.named and hint.code in estimate_results.OF_UNITS):
            self.console.say(f"hint: {hint.text}")

    def memory(self, needs: Needs) -> None:
        (self.console.detail if needs.snapshots is None else self.console.say)(str(needs))

    def result(self, scene: Scene) -> None:
        output.keep_scene(scene, out=self.out)


def check_start(scene: Scene, start: Any) -> None:
    """Raise InvalidInput where numbers to start from cannot be, before anything is compiled."""
    from clothfit.fit.start import given_start
    from clothfit.scene.fit_vector import parameters
    from clothfit.scene.scene import Scene as Values

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
