"""`clothfit simulate`: move the cloth."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict
from typing import TYPE_CHECKING, Any

import click

import clothfit
from clothfit.base.messages import counted
from clothfit.cli.common import motions, pictures, running
from clothfit.cli.common.console import Console
from clothfit.cli.common.options import check_numbers, option, section, setting, standard_command
from clothfit.cli.common.output import Output, companion_file, output_for, print_json

if TYPE_CHECKING:
    from clothfit.base.arrays import Array
    from clothfit.evaluation.touches import Touching
    from clothfit.formats.axes import Convention
    from clothfit.motion.divergence import Diverged
    from clothfit.motion.energy import Energy
    from clothfit.motion.motion import Motion
    from clothfit.scene.scene import Scene


STORED = ("kinetic", "elastic", "gravity", "contact", "total")
FLOWS = ("wind", "moved", "damping", "drag", "numerical")
OPTIONAL = ("contact", "wind", "moved", "damping", "drag")  # columns without a place in the table where they are 0
MOST_TOUCHING = 8  # lines on what touches what
MOST_ROWS = 10  # of the table, besides the start
ENERGY_ROUNDING = 1e-12  # share of the largest energy in one place below which an energy counts as 0


@standard_command("simulate")
@click.argument("scene_path", metavar="SCENE")
@section("What to simulate")
@option("--steps N", "Simulate N time steps.  [default: the scene's optimizationIterations - 1]", int)
@setting("--tolerance T", "Relative tolerance of the linear solver.  [default: the scene's]", float)
@motions.forces
@setting("--feedback", "With --forces: pull a disturbed cloth back to the motion that they were found for.")
@section("What is written")
@option("--energy", "Print a table of the energies, and store them with the motion.", name="with_energy")
@setting("--dump FILE", "If the motion diverges, write its last states here (.npz).", name="dump_path")
@option("-o --output MOTION", "File of the motion, in any format.  [default: <stem>.motion.npz]", name="path")
@running.option("Simulate again")
@pictures.options
@section("The file of the motion")
@motions.writes
def command(
    scene_path: str, steps: int | None, tolerance: float | None, forces_path: str | None, feedback: bool,
    with_energy: bool, dump_path: str | None, path: str | None, convention: Convention, pictures: pictures.Pictures,
    console: Console,
) -> None:
    """Simulate the cloths of SCENE and write their positions.

    \b
    clothfit simulate scene.json
    clothfit simulate scene.json --steps 500 -o long.npz
    clothfit simulate scene.json -o 'frames/cloth_*.obj'
    clothfit simulate scene.json --energy
    clothfit simulate scene.json --forces scene.forces.npz --set feedback=yes
    clothfit simulate scene.json --set dump=last.npz
    """
    check_numbers(steps, tolerance)
    if feedback and forces_path is None:
        raise click.UsageError("--feedback goes with --forces only")
    scene = motions.under_forces(motions.read_scene(scene_path, console), forces_path, feedback)
    frames = motions.frames_of(steps, scene)
    out = output_for(path, scene_path, ".motion.npz", (forces_path,))
    motions.check_output(out, convention, (scene_path,), frames)
    dump = companion_file("--dump", dump_path, (scene_path, out.path))
    pictures.check(scene_path, out.path, dump_path)
    motions.warn_of_steps(scene, frames, console)
    console.announce_compilation()
    from clothfit.evaluation.touches import touches
    from clothfit.kernels.clock import elapsed

    began = elapsed()
    motion, error = moved(scene, frames, tolerance)
    seconds = elapsed() - began
    console.detail("simulated")
    energy = clothfit.energies(scene, motion) if with_energy else None
    kept = {} if energy is None else {f"energy_{name}": array for name, array in energy_columns(energy).items()}
    motions.write_motion(motion, out, scene, convention, console, kept)
    motions.warn_of_energy(scene, motion, console, energy)
    touching = touches(scene, motion)
    if error is None:
        report(scene, motion, touching, seconds, out, console)
    else:
        console.say(f"the {len(motion.times)} frames before it are in {out.name}")
    dumped = keep(scene, error, dump, console)
    show_energy(energy, console)
    own = {"dump": dumped, "touching": [each._asdict() for each in touching]}
    print_json(summary(scene, motion, seconds, out, error) | own | energy_summary(energy))
    pictures.simulated(scene, motion, energy, console)
    if error is not None:
        raise error


def moved(scene: Scene, frames: int, tolerance: float | None) -> tuple[Motion, Diverged | None]:
    """The motion; where it diverges, the frames before that, and the error."""
    from clothfit.motion.divergence import Diverged

    try:
        return clothfit.simulate(scene, frames, tolerance), None
    except Diverged as error:
        if error.motion is None:
            raise
        return error.motion, error


def report(
    scene: Scene, motion: Motion, touching: Sequence[Touching], seconds: float, out: Output, console: Console
) -> None:
    """Print what a motion that stayed finite took, and warn of what it needed."""
    done = len(motion.times) - 1
    console.warn(*motion.remedies.sentences(done * len(scene.groups)))
    motions.warn_of_stretch(scene, motion, console)
    console.say(*(each.sentence for each in touching[:MOST_TOUCHING]))
    steps = counted(done, "step", "steps")
    console.say(f"{scene.name}: {steps} of {scene.delta:.4g} s in {seconds:.2f} s → {out.name}")


def summary(scene: Scene, motion: Motion, seconds: float, out: Output, error: Diverged | None) -> dict[str, Any]:
    """What --json prints of a motion."""
    import numpy as np

    return {
        "scene": scene.name,
        "frames": len(motion.times),
        "vertices": motion.positions.shape[1],
        "seconds": seconds,
        **motion.remedies._asdict(),
        "first_order": [] if motion.steps is None else np.flatnonzero(motion.steps.euler.any(axis=0)).tolist(),
        "output": out.path,
        "diverged": error and place(scene, error),
    }


def place(scene: Scene, error: Diverged) -> dict[str, Any]:
    """Where a motion diverged, for --json."""
    fault = error.fault
    where = {"object": None, "vertex": None} if fault is None else {"object": fault.cloth, "vertex": fault.vertex}
    return {"step": error.step, "time": error.step * scene.delta, **where}


def keep(scene: Scene, error: Diverged | None, dump: Output | None, console: Console) -> str | None:
    """Write the last states of a motion that diverged, where that is asked for; returns where they are."""
    if dump is None or error is None or error.fault is None:
        if dump is not None:
            console.say(f"it stayed finite, so nothing is written to {dump.name}")
        return None
    from clothfit.motion import divergence

    dump.write(divergence.dump(scene, error.fault))
    console.say(f"the last states and the first bad one of objects[{error.fault.cloth}] are in {dump.name}")
    return dump.path


def energy_columns(energy: Energy) -> dict[str, Array]:
    """All energies of each frame, (frames,) J each."""
    own = {name: array for name, array in asdict(energy).items() if name != "times"}
    return {**own, "total": energy.total, "dissipated": energy.dissipated, "numerical": energy.numerical}


def show_energy(energy: Energy | None, console: Console) -> None:
    """Print the energies of some frames, and how far the integrator raised their total."""
    if energy is None:
        return
    values, least = energy_columns(energy), ENERGY_ROUNDING * energy.scale
    names = [name for name in (*STORED, *FLOWS) if name not in OPTIONAL or abs(values[name]).max() > least]
    last = len(energy.times) - 1
    frames = sorted({round(last * i / MOST_ROWS) for i in range(MOST_ROWS + 1)})
    what = "stored at each frame; until then added by wind and what moves, lost to damping, air and integrator"
    console.result(f"energy in J: {what}")
    table = [[str(k), f"{energy.times[k]:.4g} s", *(joules(values[name][k], least) for name in names)] for k in frames]
    console.table([["frame", "time", *names], *table])
    rise, frame = energy.largest_rise
    if rise > least:
        share = f": {100 * rise / energy.scale:.2g} % of the largest energy in one place" if energy.scale > 0 else ""
        gain = f"by up to {rise:.3g} J in a step (frame {frame}) beyond the work of wind and what moves"
        console.result(f"the total rises {gain}{share}; by {energy.excess:.3g} J in all steps")
    else:
        console.result("the total never rises in a step by more than the work of wind and what moves")


def joules(value: float, least: float) -> str:
    """A cell of the table; rounding errors become 0."""
    return "0" if abs(value) <= least else f"{value:.4g}"


def energy_summary(energy: Energy | None) -> dict[str, Any]:
    """What --json prints of the energies."""
    if energy is None:
        return {}
    values, (rise, frame) = energy_columns(energy), energy.largest_rise
    ends = {end: {name: float(values[name][k]) for name in STORED} for end, k in (("start", 0), ("end", -1))}
    flows = {name: float(values[name][-1]) for name in (*FLOWS, "dissipated")}
    rises = {"largest_rise": rise, "largest_rise_frame": frame, "excess": energy.excess}
    return {"energy": {**ends, **flows, **rises, "scale": energy.scale}}
