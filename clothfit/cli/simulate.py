"""`clothfit simulate`: move the cloth."""

from __future__ import annotations

import time
from typing import TYPE_CHECKING

import click

from clothfit.cli import energy_table, shared
from clothfit.cli.console import Console
from clothfit.errors import Diverged

if TYPE_CHECKING:
    from clothfit.energy import Energy
    from clothfit.motion import Motion
    from clothfit.scene import Scene


@shared.command("simulate")
@click.argument("scene_path", metavar="SCENE")
@click.option("--steps", type=int, metavar="N", help="Time steps.  [default: the scene's optimizationIterations - 1]")
@click.option("--tolerance", type=float, metavar="T", help="Of the linear solver.  [default: the scene's]")
@click.option("--energy", "with_energy", is_flag=True, help="Tell, and keep with the motion, where the energy is.")
@click.option("-o", "--output", "path", metavar="MOTION", help="Motion file.  [default: <stem>.motion.npz]")
def command(
    scene_path: str,
    steps: int | None,
    tolerance: float | None,
    with_energy: bool,
    path: str | None,
    as_json: bool,
    console: Console,
) -> int:
    """Move the cloths of SCENE as the editor's engine does and write their positions.

    \b
    clothfit simulate scene.json
    clothfit simulate scene.json --steps 500 -o long.npz
    clothfit simulate scene.json --energy
    """
    shared.check_numbers(steps, tolerance)
    scene = shared.read_scene(scene_path, console)
    frames = shared.frames_of(steps, scene)
    out = shared.output(path, scene_path, ".motion.npz", ())
    import clothfit

    console.announce_compilation()
    began = time.perf_counter()
    try:
        motion = clothfit.simulate(scene, frames, tolerance)
    except Diverged as error:
        if error.motion is not None:
            energy = energy_of(scene, error.motion, with_energy)
            out.write(shared.motion_data(error.motion, energy_table.arrays(energy)))
            console.say(f"the {len(error.motion.times)} frames before it are in {out.name}")
            energy_table.show(energy, console)
        raise
    seconds = time.perf_counter() - began
    console.detail("simulated")
    energy = energy_of(scene, motion, with_energy)
    out.write(shared.motion_data(motion, energy_table.arrays(energy)))
    done = len(motion.times) - 1
    for sentence in motion.remedies.sentences(done * len(scene.cloths)):
        console.warn(sentence)
    console.say(f"{scene.name}: {done} steps of {scene.delta:.4g} s in {seconds:.2f} s → {out.name}")
    energy_table.show(energy, console)
    if as_json:
        summary = {
            "scene": scene.name,
            "frames": done + 1,
            "vertices": motion.positions.shape[1],
            "seconds": seconds,
            **motion.remedies._asdict(),
            "output": out.path,
            **energy_table.summary(energy),
        }
        shared.print_json("simulate", summary, out)
    return 0


def energy_of(scene: Scene, motion: Motion, wanted: bool) -> Energy | None:
    """Where the energy of the motion is, where that is asked for."""
    if not wanted:
        return None
    from clothfit.energy import energies

    return energies(scene, motion)
