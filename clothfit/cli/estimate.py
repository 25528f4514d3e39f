"""`clothfit estimate`: fit the flagged parameters and write the scene back."""

from __future__ import annotations

import os
from dataclasses import asdict
from typing import TYPE_CHECKING, Any

import click

from clothfit.cli import shared
from clothfit.cli.account import account, indices
from clothfit.cli.console import Console, metres
from clothfit.errors import Diverged, InvalidInput
from clothfit.words import counted, owned

if TYPE_CHECKING:
    from clothfit.motion import Motion
    from clothfit.result import Fit
    from clothfit.scene import Scene

EXIT_CODES = {"converged": 0, "stalled": 5, "limit": 5, "interrupted": 130}


@shared.command("estimate")
@click.argument("scene_path", metavar="SCENE")
@click.option(
    "--target",
    "target_paths",
    metavar="MOTION[@SCENE]",
    multiple=True,
    help="What to match, and the scene it was recorded in; may be repeated.  [default: the scene's own motion]",
)
@click.option(
    "--objective",
    "objectives",
    metavar="NAME[=WEIGHT]",
    multiple=True,
    help="What to compare: position, velocity, edge-length, spectrum; may be repeated.  [default: position]",
)
@click.option("--loss", default="linear", metavar="NAME", help="linear, soft_l1 or huber.  [default: linear]")
@click.option("--loss-scale", type=float, metavar="METRES", help="Gaps above it are outliers.  [default: 0.01]")
@click.option(
    "--start",
    metavar="VALUE|SCENE",
    help="First guess.  [default: the scene's values with --target, else a coarse search]",
)
@click.option(
    "--method",
    default="auto",
    metavar="NAME",
    help="auto, momentum, gauss-newton, l-bfgs-b or another of SciPy's.  [default: auto]",
)
@click.option("--max-evaluations", type=int, default=1000, metavar="N", help="Of cost and gradient.  [default: 1000]")
@click.option("--rmse", type=float, default=1e-8, metavar="METRES", help="Good enough: stop there.  [default: 1e-8]")
@click.option("--tolerance", type=float, metavar="T", help="Of the linear solver.  [default: 1e-10]")
@click.option("--checkpoint", metavar="FILE", help="Keep there how far the fit is.  [default: <output>.checkpoint]")
@click.option("--resume", is_flag=True, help="Go on from the checkpoint of a fit that was ended early.")
@click.option(
    "--prior",
    default="auto",
    metavar="TAU",
    help="Scatter around the start, in log parameters; none; auto: as the data say.  [default: auto]",
)
@click.option("--holdout", type=float, metavar="FRACTION", help="Keep it out of the fit, and judge the fit by it.")
@click.option(
    "--holdout-of", default="frames", metavar="WHAT", help="frames (the last), or vertices.  [default: frames]"
)
@click.option("--no-intervals", is_flag=True, help="Do not look at what the motion determines, nor how well.")
@click.option("-o", "--output", "path", metavar="SCENE", help="Fitted scene.  [default: <stem>.fitted<suffix>]")
@click.option("--in-place", is_flag=True, help="Write the fitted values into SCENE itself.")
def command(
    scene_path: str,
    target_paths: tuple[str, ...],
    objectives: tuple[str, ...],
    loss: str,
    loss_scale: float | None,
    start: str | None,
    method: str,
    max_evaluations: int,
    rmse: float,
    tolerance: float | None,
    checkpoint: str | None,
    resume: bool,
    prior: str,
    holdout: float | None,
    holdout_of: str,
    no_intervals: bool,
    path: str | None,
    in_place: bool,
    as_json: bool,
    console: Console,
) -> int:
    """Fit the parameters that SCENE flags and write the scene with only those numbers changed.

    Without --target the scene's own parameters are the truth, hidden from the fit: a trial of what can be recovered.
    Of several targets the costs add up, as do those of several objectives, each times its weight.

    \b
    clothfit estimate scene.json
    clothfit estimate scene.json --target capture.npz -o fitted.json
    clothfit estimate scene.json --target one.npz --target two.npz@windy.json --objective velocity=0.01
    clothfit estimate scene.json --target capture.npz --holdout 0.2
    clothfit estimate - < scene.json > fitted.json
    """
    check_values(max_evaluations, rmse, path, in_place, scene_path)
    start_path = None if start is None or is_number(start) else start
    pairs = [motion_and_scene(path) for path in target_paths]
    inputs = (*(path for pair in pairs for path in pair), start_path)
    shared.one_stream(scene_path, *inputs)
    shared.check_numbers(tolerance=tolerance)
    scene = shared.read_scene(scene_path, console)
    out = output(scene_path, path, in_place, inputs)
    from clothfit import fit
    from clothfit.cli import checkpoints
    from clothfit.fit_vector import blocks

    fit.check_method(method)
    kept = checkpoints.chosen(checkpoint, resume, out, (scene_path, *inputs), console)
    targets = [read_target(pair, scene, console) for pair in pairs]
    first = read_start(start, console)
    flagged = ", ".join(f"{owned(b.cloth, b.name)} ({b.mode})" for b in blocks(scene))
    console.detail(f"fitting {flagged or 'nothing'} over {scene.frames} frames")
    console.announce_compilation()
    with console.progress() as report:
        found = fit.estimate(
            scene,
            targets or None,
            first,
            method,
            budget=max_evaluations,
            rmse_tolerance=rmse,
            tolerance=tolerance,
            report=report,
            objective=weights(objectives),
            loss=loss,
            loss_scale=loss_scale,
            checkpoint=kept,
            resume=resume,
            prior=prior,
            holdout=holdout,
            holdout_of=holdout_of,
            intervals=not no_intervals,
        )
    with shared.uninterrupted():
        code = finish(scene, found, out, console, as_json)
        checkpoints.closed(kept, checkpoint is not None, found.status, in_place, console)
        return code


def check_values(max_evaluations: int, rmse: float, path: str | None, in_place: bool, scene_path: str) -> None:
    """Raise InvalidInput on option values that cannot be."""
    if max_evaluations < 1:
        raise InvalidInput(f"--max-evaluations: {max_evaluations} is not possible, at least 1 is")
    if not rmse >= 0:
        raise InvalidInput(f"--rmse: {rmse:g} m is not possible, 0 or more is")
    if in_place and (path is not None or scene_path == shared.STREAM):
        raise InvalidInput("--in-place writes into the scene's file; it does not go with -o or standard input")


def motion_and_scene(path: str) -> tuple[str, str | None]:
    """The paths in a --target: of a motion, or of a motion and a scene, split at the last @."""
    if os.path.exists(path) or "@" not in path:
        return path, None
    motion, _, scene = path.rpartition("@")
    return motion, scene


def read_target(
    paths: tuple[str, str | None], scene: Scene, console: Console
) -> Motion | tuple[Motion, Scene]:
    """What a --target names."""
    motion, own = paths
    if own is None:
        return shared.read_motion(motion, scene)
    other = shared.read_scene(own, console)
    return shared.read_motion(motion, other), other


def weights(objectives: tuple[str, ...]) -> dict[str, float]:
    """The weight of each --objective, 1 where it has none."""
    found = {}
    for text in objectives or ("position",):
        name, equals, weight = text.partition("=")
        if name in found:
            raise InvalidInput(f"--objective: {name} is given twice")
        if equals and not is_number(weight):
            raise InvalidInput(f"--objective: {text}: the weight is not a number, as in {name}=0.01")
        found[name] = float(weight) if equals else 1.0
    return found


def read_start(start: str | None, console: Console) -> float | Scene | None:
    """What --start says: a value, or a scene's file."""
    if start is None:
        return None
    return float(start) if is_number(start) else shared.read_scene(start, console)


def is_number(text: str) -> bool:
    """Whether a --start is a value, not a file."""
    try:
        float(text)
    except ValueError:
        return False
    return True


def output(scene_path: str, path: str | None, in_place: bool, inputs: tuple[str | None, ...]) -> shared.Output:
    """Where the fitted scene goes: by default beside the input, with the input's suffix."""
    if in_place:
        return shared.output(scene_path, scene_path, "", (), overwrite=True)
    suffix = os.path.splitext(scene_path)[1]
    return shared.output(path, scene_path, f".fitted{suffix}", inputs, text=True)


def finish(scene: Scene, found: Fit, out: shared.Output, console: Console, as_json: bool) -> int:
    """Write the result and tell about it; returns the exit code."""
    from clothfit.scene import dumps

    for warning in found.warnings:
        console.warn(f"{scene.name}: {warning}")
    if found.status == "diverged":
        if as_json:
            shared.print_json("estimate", summary(scene, found, out) | {"output": None}, out)
        raise Diverged(
            f"{scene.name}: no values that were tried gave a simulation that stays finite; nothing is written", 0
        )
    out.write(dumps(found.scene))
    describe(found, out, console)
    if as_json:
        shared.print_json("estimate", summary(scene, found, out), out)
    return EXIT_CODES[found.status]


def describe(found: Fit, out: shared.Output, console: Console) -> None:
    """Tell the result in a few lines."""
    console.say(
        f"{found.status}: RMSE {metres(found.rmse)} over {found.frames} frames, "
        f"{counted(found.evaluations, 'evaluation', 'evaluations')} in {found.seconds:.1f} s → {out.name}"
    )
    if found.holdout:
        kept = counted(found.holdout.observations, "position", "positions")
        console.say(f"holdout: RMSE {metres(found.holdout.rmse)} over {kept} kept out of the fit")
    for block in found.parameters:
        place = owned(block.object, block.name)
        if block.at_bound:
            console.warn(f"{place}: {len(block.at_bound)} of {block.count} at a bound: {indices(block.at_bound)}")
        if told := account(block):
            console.say(f"{place}: {told}")


def summary(scene: Scene, found: Fit, out: shared.Output) -> dict[str, Any]:
    """What --json prints."""
    return {
        "scene": scene.name,
        "status": found.status,
        "method": found.method,
        "cost": found.cost,
        "rmse": found.rmse,
        "frames": found.frames,
        "evaluations": found.evaluations,
        "seconds": found.seconds,
        "rank": found.rank,
        "sigma": found.sigma,
        "prior": found.prior and [asdict(scatter) for scatter in found.prior],
        "holdout": found.holdout and asdict(found.holdout),
        "parameters": [asdict(block) for block in found.parameters],
        "warnings": found.warnings,
        "output": out.path,
    }
