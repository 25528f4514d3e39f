"""`clothfit check`: is the gradient right on this scene?"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import click

from clothfit.base.errors import ClothfitError, InvalidInput
from clothfit.base.messages import counted, owned
from clothfit.cli.common import motions
from clothfit.cli.common.console import Console
from clothfit.cli.common.motions import one_stream, read_scene, under_forces
from clothfit.cli.common.options import check_numbers, option, section, setting, standard_command
from clothfit.cli.common.output import attributes, print_json

if TYPE_CHECKING:
    from clothfit.evaluation.gradient_check import Finding, SceneCheck
    from clothfit.formats.axes import Reading
    from clothfit.scene.scene import Scene


@standard_command("check")
@click.argument("scene_path", metavar="SCENE")
@section("What to check")
@option("--steps N", "Simulate N time steps.  [default: the scene's, fewer for large cloths]", int)
@option("--target MOTION", "Motion to compare with.  [default: that of perturbed values]", name="target_path")
@motions.with_forces
@setting("--seed S", "Seed of the random directions.  [default: 0]", click.IntRange(0), default=0)
@setting("--memory SIZE", "Use at most this much memory, such as 200MB.  [default: half of what is free]")
@section("The file of the target")
@motions.reads
def command(
    scene_path: str, steps: int | None, target_path: str | None, reading: Reading, forces_path: str | None, seed: int,
    memory: str | None, console: Console,
) -> None:
    """Check the gradient that a fit of SCENE would follow, at the scene's own values.

    The Taylor and difference tests compare it with differences of the cost along a random direction; the dot product
    test compares the forward with the reverse sweep. Steps in which a contact switches are left out, because the cost
    has a kink there.

    \b
    clothfit check scene.json
    clothfit check scene.json --target capture.npz --steps 50
    """
    check_numbers(steps)
    one_stream(scene_path, target_path)
    scene = under_forces(read_scene(scene_path, console), forces_path)
    readings: list[dict[str, Any]] = []
    target = None if target_path is None else motions.read_motion(target_path, scene, reading, console, readings)
    from clothfit.evaluation.gradient_check import check_scene
    from clothfit.kernels.clock import elapsed

    console.announce_compilation()
    began = elapsed()
    found = check_scene(scene, target, None if steps is None else steps + 1, seed=seed, memory=memory)
    seconds = elapsed() - began
    show(found, scene, steps is not None, target_path, console)
    print_json({**summary(found, target_path), **motions.readings_summary(readings), "seconds": seconds})
    raise_verdict(found, console)


def show(found: SceneCheck, scene: Scene, chosen: bool, target_path: str | None, console: Console) -> None:
    """Say what is checked, and print a line for each test."""
    if not found.flagged:
        console.result(f"{found.scene} flags nothing to fit: checked by all masses and stiffnesses")
    if found.frames < scene.frames and not chosen:
        console.say(f"the first {found.frames - 1} of {scene.frames - 1} steps; --steps checks others")
    blocks = [(owned(b.cloth, b.name), b.mode, counted(b.count, "value", "values")) for b in found.blocks]
    values = ", ".join(f"{name} ({mode}, {count})" for name, mode, count in blocks)
    against = target_path or "the motion of values up to 10 % off"
    console.result(f"gradient by {values}; {counted(found.frames, 'frame', 'frames')}, against {against}")
    console.table([("test", "measured", "bar", "verdict"), *map(row, found.tests)])
    if found.left_out:
        console.result(found.left_out)
    for each in found.unseen:
        console.result(f"{each} did not act in these frames, so nothing is known of its derivatives; try more --steps")


def row(test: Finding) -> tuple[str, ...]:
    """A line of the table."""
    order = test.name == "Taylor"
    measured = "" if test.measured is None else f"{test.measured:.2f}" if order else f"{test.measured:.1e}"
    bar = f"above {test.bar:g}" if order else f"below {test.bar:g}"
    return test.name, measured, bar, f"{test.verdict}: {test.why}" if test.why else test.verdict


def raise_verdict(found: SceneCheck, console: Console) -> None:
    """Tell the verdict. Raises ClothfitError for a wrong gradient, which is a fault of the program, InvalidInput where
    this scene does not show whether it is one.
    """
    failed = [test.name for test in found.tests if test.verdict == "failed"]
    if failed:
        raise ClothfitError(
            f"{found.scene}: the gradient is wrong ({', '.join(failed)}): a fault of the program; please report it "
            "with the scene"
        )
    if found.verdict != "passed":
        raise InvalidInput(
            f"{found.scene}: whether the gradient is right cannot be seen here ({found.why}); try fewer or more --steps"
        )
    console.result(f"{found.scene}: the gradient is right")


def summary(found: SceneCheck, target_path: str | None) -> dict[str, Any]:
    """What --json prints."""
    blocks = [{"object": b.cloth, "name": b.name, "mode": b.mode, "count": b.count} for b in found.blocks]
    return {
        **attributes(found, "scene", "verdict", "frames", "flagged", "unseen"),
        "target": target_path,
        "parameters": blocks,
        "tests": [test._asdict() for test in found.tests],
        "longest_step": found.reach,
        "left_out": found.left_out or None,
    }
