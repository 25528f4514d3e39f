"""`clothfit evaluate`: how good is a fitted scene?"""

from __future__ import annotations

import os
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import asdict
from typing import TYPE_CHECKING, Any

import click

from clothfit.base.messages import counted, metres, owned
from clothfit.cli.common import motions, pictures
from clothfit.cli.common.console import Console
from clothfit.cli.common.options import check_numbers, option, refuse, section, setting, standard_command
from clothfit.cli.common.output import PAGE, Output, attributes, companion_file, print_json, uninterrupted
from clothfit.cli.common.progress import now_and_then
from clothfit.formats.axes import Reading, positive
from clothfit.formats.registry import SUBSPACE, kind_of

if TYPE_CHECKING:
    from clothfit.evaluation.evaluate import Evaluation
    from clothfit.evaluation.work_precision import Row, WorkPrecision
    from clothfit.scene.scene import Scene
    from clothfit.subspace.validation import Compared, Validation


@standard_command("evaluate")
@click.argument("scene_path", metavar="SCENE")
@click.argument("fitted_path", metavar="FITTED", required=False)
@section("What to compare")
@option("--target MOTION", "Compare with this motion instead of SCENE's own.", name="target_path")
@option("--steps N", "Simulate N steps for the longer comparison.  [default: 499; with --speed those of SCENE]", int)
@motions.with_forces
@section("The file of the target")
@motions.reads
@section("How fast and how exact (--speed)")
@option("--speed", "Measure the speed and error of integrators, steps and tolerances instead.")
@setting("--error METRES", "With --speed: recommend the cheapest setting within this error.", float)
@option("--budget SECONDS", "With --speed: measure for about this long.  [default: 60]", float)
@section("A subspace (MODEL in place of FITTED)")
@setting("--inputs FILE", "Of a subspace: compare under these inputs over time (JSON).  [default: those of SCENE]",
        name="inputs_path")
@option("--report FILE", "Of a subspace: write a page here that plays it over the full motion, side by side.",
        name="page_path")
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
    clothfit evaluate scene.json --speed --set error=0.02 --set plot=speed.svg
    clothfit evaluate scene.json scene.model.npz --json
    """
    if speed:
        alone: dict[str, object] = {"FITTED": fitted_path, "--target": target_path, "--gif": pictures.gif}
        refuse(alone | {"--forces": forces_path}, "--speed takes one scene; {} does not go with it")
        measure(scene_path, steps, error, budget, pictures, console)
        return
    refuse({"--error": error, "--budget": budget}, "{} goes with --speed only")
    if fitted_path is None:
        context = click.get_current_context()
        missing = next(p for p in context.command.params if p.name == "fitted_path")
        raise click.MissingParameter(ctx=context, param=missing)
    if kind_of(fitted_path) == SUBSPACE:
        others: dict[str, object] = {"--target": target_path, "--forces": forces_path}
        refuse(others, "{} does not go with a subspace")
        compare_model(scene_path, fitted_path, inputs_path, steps, pictures, page_path, console)
        return
    refuse({"--inputs": inputs_path, "--report": page_path}, "{} goes with a subspace only")
    compare(scene_path, fitted_path, target_path, reading, steps, forces_path, pictures, console)


def compare(
    scene_path: str, fitted_path: str, target_path: str | None, reading: Reading, steps: int | None,
    forces_path: str | None, pictures: pictures.Pictures, console: Console,
) -> None:
    """Compare a fitted scene with the true one."""
    motions.one_stream(scene_path, fitted_path, target_path)
    check_numbers(steps)
    paths = scene_path, fitted_path
    motions.check_there(*paths)
    pictures.check(*paths, target_path, forces_path)
    truth, fitted = (motions.under_forces(motions.read_scene(each, console), forces_path) for each in paths)
    from clothfit.evaluation.evaluate import HORIZON, evaluate

    horizon = HORIZON if steps is None else motions.frames_of(steps, truth)
    readings: list[dict[str, Any]] = []
    target = motions.read_motion(target_path, truth, reading, console, readings) if target_path is not None else None
    for each in (truth, fitted) if target is None else (fitted,):
        motions.warn_of_steps(each, max(truth.frames, horizon), console)
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
    return asdict(report.fitted) | attributes(report, "horizon", "diverged", "parameters")


def show(report: Evaluation, console: Console) -> None:
    """Print the report as two tables."""
    parts = (("fitted", report.fitted), ("horizon", report.horizon))
    rows = [(name, str(part.frames), metres(part.rmse), metres(part.max_error)) for name, part in parts]
    console.table([("motion", "frames", "RMSE", "largest error"), *rows])
    if report.parameters:
        console.result("")
        table = [["parameters", "count", "median deviation", "largest deviation"]]
        for d in report.parameters:
            deviations = (d.median_relative_deviation, d.max_relative_deviation)
            values = ["not identifiable" if value is None else f"{value:.2g}" for value in deviations]
            table.append([f"{owned(d.object, d.name)} ({d.mode})", str(d.count), *values])
        console.table(table)


# ---- `clothfit evaluate SCENE MODEL`: how far a subspace is from the full simulation, and what both cost.

NORMALS = {"faces": "(of the faces)", "regression": "(by regression)"}
NAMES = {"regression": "(normals by regression)"}

ROUNDING = 1e-9
"""Relative energy that is none."""


def compare_model(
    scene_path: str, model_path: str, inputs_path: str | None, steps: int | None, pictures: pictures.Pictures,
    page_path: str | None, console: Console,
) -> None:  # fmt: skip
    """Compare a model with the scene's own simulation."""
    from clothfit.subspace.model import load_model
    from clothfit.subspace.validation import compare

    motions.check_there(scene_path, model_path)
    pictures.check(scene_path, model_path, inputs_path, page_path)
    page = companion_file("--report", page_path, (scene_path, model_path, inputs_path, *pictures.files), text=PAGE)
    model = load_model(model_path)
    scene = motions.with_inputs(motions.read_scene(scene_path, console), inputs_path)
    console.announce_compilation()
    over = compare(model, scene, motions.frames_of(steps, scene))
    console.warn(*over.found.clamped)
    if not print_json(asdict(over.found) | {"forgets": over.found.forgets}):
        show_validation(over.found, console)
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
        report.put(page_of(subspace_content(over, os.path.basename(model_path)), *origin), page, console)


def show_validation(found: Validation, console: Console) -> None:
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
        from clothfit.subspace.validation import at_best

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


# ---- `clothfit evaluate --speed`: what accuracy does each second buy? A table, what its errors mean, and advice.

SPEED_COLUMNS = (
    "integrator", "step", "tolerance", "Newton", "ms per step", "s per simulated s", "error", "largest error", "",
)  # fmt: skip


def measure(
    scene_path: str, steps: int | None, error: float | None, budget: float | None, pictures: pictures.Pictures,
    console: Console,
) -> None:
    """Measure integrators for about `budget` seconds; print and draw the result, with the cheapest setting within an
    `error`, m.
    """
    positive("--error", error)
    positive("--budget", budget)
    scene = motions.read_scene(scene_path, console)
    frames = motions.frames_of(steps, scene)
    pictures.check(scene_path)
    from clothfit.evaluation import work_precision as precision

    console.announce_compilation()
    with measuring(console) as report:
        study = precision.work_precision(scene, frames, budget or precision.MEASURE_SECONDS, report)
    if pictures.plot is not None:
        from clothfit.pictures.diagram import save_diagram

        with uninterrupted():
            save_diagram(study, pictures.plot, error)
    if print_json(speed_summary(study, scene, error) | {"plot": pictures.plot}):
        return
    show_speed(study, scene, error, console)
    if pictures.plot is not None:
        console.say(f"diagram → {pictures.plot}")


@contextmanager
def measuring(console: Console) -> Iterator[Callable[[float, str], None] | None]:
    """Show what is being measured while the block runs; gives what to call with it."""
    if console.quiet:
        yield None
    elif console.animated:
        from rich.console import Console as RichConsole

        with RichConsole(stderr=True).status("measuring") as status:
            yield lambda seconds, what: status.update(f"{what} ({seconds:.0f} s)")
    else:
        tell = now_and_then(console.say)
        yield lambda seconds, what: tell(lambda: f"{seconds:6.1f} s  {what}")


def speed_summary(study: WorkPrecision, scene: Scene, error: float | None) -> dict[str, Any]:
    """What --json prints."""
    best = None if error is None else study.recommended(error)
    reference = study.reference
    return {
        **attributes(study, "scene", "delta"),
        "frames": len(reference.positions),
        "simulated_frames": study.frames,
        "vertices": sum(scene.vertex_counts),
        "reference": attributes(reference, "integrator", "step", "order", "error"),
        "rows": [plain_row(row) for row in study.rows],
        "own": plain_row(study.own),
        "requested_error": error,
        "recommended": best and plain_row(best),
    }


def plain_row(row: Row) -> dict[str, Any]:
    """A row as JSON has it: with its setting's values beside its own."""
    values = asdict(row)
    setting: dict[str, Any] = values.pop("setting")
    setting["newton_iterations"] = setting.pop("newton")
    values["seconds_per_simulated_second"] = values.pop("seconds_per_second")
    return setting | values


def show_speed(study: WorkPrecision, scene: Scene, error: float | None, console: Console) -> None:
    """Print table and advice."""
    done = [row for row in study.rows if row.status == "done"]
    short = [row for row in done if row.pareto or row.own or row.setting.tolerance in (None, scene.tolerance)]
    shown = done if console.verbose else short
    if shown:
        console.table([SPEED_COLUMNS, *map(cells, shown)])
    if len(shown) < len(done):
        console.result(f"{len(done) - len(shown)} more, with other tolerances and not Pareto-best, by -v and --json")
    for status in ("diverged", "skipped"):
        if settings := without_result(study, status):
            console.result(f"{status}: {settings}")
    console.result("")
    show_reference(study, console)
    show_advice(study, scene, error, console)


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


def without_result(study: WorkPrecision, status: str) -> str:
    """The settings that ended so, by integrator: which steps, of how many settings each."""
    ended = []
    for name in dict.fromkeys(row.setting.integrator for row in study.rows):
        rows = [row for row in study.rows if row.setting.integrator == name and row.status == status]
        steps = [row.setting.step_name for row in rows]
        counts = {step: steps.count(step) for step in steps}
        if rows:
            parts = [step if count == 1 else f"{step} ({count} settings)" for step, count in counts.items()]
            ended.append(f"{name} {', '.join(parts)}")
    return "; ".join(ended)


def show_reference(study: WorkPrecision, console: Console) -> None:
    """Say what the errors are measured against, and how well that is known."""
    reference = study.reference
    frames = len(reference.positions)
    order = "" if reference.order is None else f", order {reference.order:.1f}"
    how = f"{reference.integrator}, {1e3 * reference.step:.3g} ms a step{order}"
    console.result(
        f"error: distance to the motion of h → 0, root mean square over all vertices and {frames} frames; that motion "
        f"is known to {metres(reference.error)} ({how})"
    )
    if frames < study.frames:
        console.warn(
            f"{study.scene}: frames from {frames} on (t = {frames * study.delta:.4g} s) are not judged: the motion of "
            "h → 0 is not known well enough there, as it is chaotic or needs more --budget"
        )


def show_advice(study: WorkPrecision, scene: Scene, error: float | None, console: Console) -> None:
    """Recommend a setting, and say which one a fit must use."""
    own = study.own
    if error is not None:
        best, nearest = study.recommended(error), study.nearest
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
    better = [r for r in study.rows if all(a < b for a, b in zip(r.cost_and_error, own.cost_and_error, strict=True))]
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
