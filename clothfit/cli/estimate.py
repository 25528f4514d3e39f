"""`clothfit estimate`: fit the flagged parameters and write the scene back."""

from __future__ import annotations

import os
from dataclasses import asdict
from typing import TYPE_CHECKING, Any

import click

from clothfit.cli import shared
from clothfit.cli.console import Console, metres
from clothfit.errors import Diverged, InvalidInput
from clothfit.words import counted, owned

if TYPE_CHECKING:
    from clothfit.fit import Fit
    from clothfit.scene import Scene

EXIT_CODES = {"converged": 0, "stalled": 5, "limit": 5, "interrupted": 130}


@shared.command("estimate")
@click.argument("scene_path", metavar="SCENE")
@click.option("--target", "target_path", metavar="MOTION", help="What to match.  [default: the scene's own motion]")
@click.option(
    "--start",
    metavar="VALUE|SCENE",
    help="First guess.  [default: the scene's values with --target, else a coarse search]",
)
@click.option("--method", default="auto", metavar="NAME", help="auto, l-bfgs-b or another of SciPy's.  [default: auto]")
@click.option("--max-evaluations", type=int, default=1000, metavar="N", help="Of cost and gradient.  [default: 1000]")
@click.option("--rmse", type=float, default=1e-8, metavar="METRES", help="Good enough: stop there.  [default: 1e-8]")
@click.option("--tolerance", type=float, metavar="T", help="Of the linear solver.  [default: 1e-10]")
@click.option("-o", "--output", "path", metavar="SCENE", help="Fitted scene.  [default: <stem>.fitted<suffix>]")
@click.option("--in-place", is_flag=True, help="Write the fitted values into SCENE itself.")
def command(
    scene_path: str,
    target_path: str | None,
    start: str | None,
    method: str,
    max_evaluations: int,
    rmse: float,
    tolerance: float | None,
    path: str | None,
    in_place: bool,
    as_json: bool,
    console: Console,
) -> int:
    """Fit the parameters that SCENE flags and write the scene with only those numbers changed.

    Without --target the scene's own parameters are the truth, hidden from the fit: a trial of what can be recovered.

    \b
    clothfit estimate scene.json
    clothfit estimate scene.json --target capture.npz -o fitted.json
    clothfit estimate - < scene.json > fitted.json
    """
    check_values(max_evaluations, rmse, path, in_place, scene_path)
    start_path = None if start is None or is_number(start) else start
    shared.one_stream(scene_path, target_path, start_path)
    scene = shared.read_scene(scene_path, console)
    out = output(scene_path, path, in_place, (target_path, start_path))
    from clothfit import fit
    from clothfit.fit_vector import blocks

    fit.check_method(method)
    target = shared.read_motion(target_path, scene) if target_path is not None else None
    first = read_start(start, console)
    flagged = ", ".join(f"{owned(b.cloth, b.name)} ({b.mode})" for b in blocks(scene))
    console.detail(f"fitting {flagged or 'nothing'} over {scene.frames} frames")
    console.announce_compilation()
    with console.progress() as report:
        found = fit.estimate(
            scene,
            target,
            first,
            method,
            budget=max_evaluations,
            rmse_tolerance=rmse,
            tolerance=tolerance,
            report=report,
        )
    with shared.uninterrupted():
        return finish(scene, found, out, console, as_json)


def check_values(max_evaluations: int, rmse: float, path: str | None, in_place: bool, scene_path: str) -> None:
    """Raise InvalidInput on option values that cannot be."""
    if max_evaluations < 1:
        raise InvalidInput(f"--max-evaluations: {max_evaluations} is not possible, at least 1 is")
    if not rmse >= 0:
        raise InvalidInput(f"--rmse: {rmse:g} m is not possible, 0 or more is")
    if in_place and (path is not None or scene_path == shared.STREAM):
        raise InvalidInput("--in-place writes into the scene's file; it does not go with -o or standard input")


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
    for block in found.parameters:
        place = owned(block.object, block.name)
        if block.at_bound:
            console.warn(f"{place}: {len(block.at_bound)} of {block.count} at a bound: {indices(block.at_bound)}")
        if block.unidentifiable:
            lost = f"{len(block.unidentifiable)} of {block.count}"
            console.say(f"{place}: {lost} kept, no motion can reveal them: {indices(block.unidentifiable)}")


def indices(numbers: list[int]) -> str:
    """The first few of a list of indices."""
    return ", ".join(map(str, numbers[:8])) + (", …" if len(numbers) > 8 else "")


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
        "parameters": [asdict(block) for block in found.parameters],
        "warnings": found.warnings,
        "output": out.path,
    }
