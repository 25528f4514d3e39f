"""`clothfit simulate`: move the cloth."""

from __future__ import annotations

import time
from typing import TYPE_CHECKING, Any

import click

from clothfit.base.errors import InvalidInput
from clothfit.cli.common import energy_table, motions, pictures, shared
from clothfit.cli.common import stability_warnings as trust
from clothfit.cli.common.console import Console

if TYPE_CHECKING:
    from clothfit.formats.convention import Convention
    from clothfit.motion.divergence import Diverged
    from clothfit.motion.energy import Energy
    from clothfit.motion.motion import Motion
    from clothfit.scene.scene import Scene


@shared.command("simulate")
@click.argument("scene_path", metavar="SCENE")
@click.option("--steps", type=int, metavar="N", help="Time steps.  [default: the scene's optimizationIterations - 1]")
@click.option("--tolerance", type=float, metavar="T", help="Of the linear solver.  [default: the scene's]")
@click.option("--energy", "with_energy", is_flag=True, help="Tell, and keep with the motion, where the energy is.")
@click.option("--dump", "dump_path", metavar="FILE", help="Where it diverges, keep the last states there (.npz).")
@click.option("-o", "--output", "path", metavar="MOTION", help="Of any format.  [default: <stem>.motion.npz]")
@motions.writes
@pictures.options
def command(
    scene_path: str,
    steps: int | None,
    tolerance: float | None,
    with_energy: bool,
    dump_path: str | None,
    path: str | None,
    convention: Convention,
    pictures: pictures.Pictures,
    as_json: bool,
    console: Console,
) -> int:
    """Move the cloths of SCENE as the editor's engine does and write their positions.

    \b
    clothfit simulate scene.json
    clothfit simulate scene.json --steps 500 -o long.npz
    clothfit simulate scene.json -o 'frames/cloth_*.obj'
    clothfit simulate scene.json --energy
    clothfit simulate scene.json --dump last.npz
    clothfit simulate scene.json --plot motion.png --gif motion.gif
    """
    shared.check_numbers(steps, tolerance)
    scene = shared.read_scene(scene_path, console)
    frames = shared.frames_of(steps, scene)
    out = shared.output(path, scene_path, ".motion.npz", ())
    motions.check(out, convention, (scene_path,), frames)
    dump = dump_of(dump_path, scene_path, out)
    pictures.check(scene_path, out.path, dump_path)
    import clothfit
    from clothfit.motion.divergence import Diverged

    trust.warn_of_steps(scene, frames, console)
    console.announce_compilation()
    began, error = time.perf_counter(), None
    try:
        motion = clothfit.simulate(scene, frames, tolerance)
    except Diverged as problem:
        if problem.motion is None:
            raise
        motion, error = problem.motion, problem
    seconds = time.perf_counter() - began
    console.detail("simulated")
    energy = energy_of(scene, motion, with_energy)
    motions.write(motion, out, scene, convention, console, energy_table.arrays(energy))
    if error is None:
        tell(scene, motion, seconds, out, console)
    else:
        console.say(f"the {len(motion.times)} frames before it are in {out.name}")
    dumped = keep(scene, error, dump, console)
    energy_table.show(energy, console)
    if as_json:
        summary = {
            "scene": scene.name,
            "frames": len(motion.times),
            "vertices": motion.positions.shape[1],
            "seconds": seconds,
            **motion.remedies._asdict(),
            "output": out.path,
            "diverged": error and place(scene, error),
            "dump": dumped,
            **energy_table.summary(energy),
        }
        shared.print_json("simulate", summary, out)
    pictures.simulated(scene, motion, energy, console)
    if error is not None:
        raise error
    return 0


def tell(scene: Scene, motion: Motion, seconds: float, out: shared.Output, console: Console) -> None:
    """Tell of a motion that stayed finite."""
    done = len(motion.times) - 1
    for sentence in motion.remedies.sentences(done * len(scene.cloths)):
        console.warn(sentence)
    trust.warn_of_stretch(scene, motion, console)
    console.say(f"{scene.name}: {done} steps of {scene.delta:.4g} s in {seconds:.2f} s → {out.name}")


def place(scene: Scene, error: Diverged) -> dict[str, Any]:
    """Where a motion diverged, for --json."""
    fault = error.fault
    where = {"object": None, "vertex": None} if fault is None else {"object": fault.cloth, "vertex": fault.vertex}
    return {"step": error.step, "time": error.step * scene.delta, **where}


def energy_of(scene: Scene, motion: Motion, wanted: bool) -> Energy | None:
    """Where the energy of the motion is, where that is asked for."""
    if not wanted:
        return None
    from clothfit.motion.energy import energies

    return energies(scene, motion)


def dump_of(path: str | None, scene_path: str, out: shared.Output) -> shared.Output | None:
    """Where the last states go, checked as any output. Raises InvalidInput."""
    if path is None:
        return None
    if path == shared.STREAM or (not out.is_stream and shared.same_file(path, out.path)):
        raise InvalidInput(f"--dump must be a file of its own; {path} was given")
    return shared.output(path, scene_path, "", ())


def keep(scene: Scene, error: Diverged | None, dump: shared.Output | None, console: Console) -> str | None:
    """Write the last states of a motion that diverged, where that is asked for; returns where they are."""
    if dump is None or error is None or error.fault is None:
        if dump is not None:
            console.say(f"it stayed finite, so nothing is written to {dump.name}")
        return None
    from clothfit.motion import divergence

    dump.write(divergence.dump(scene, error.fault))
    console.say(f"the last states and the first bad one of objects[{error.fault.cloth}] are in {dump.name}")
    return dump.path
