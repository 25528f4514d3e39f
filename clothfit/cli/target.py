"""`clothfit target`: record what a fit should reproduce."""

from __future__ import annotations

import click

from clothfit.base.limits import check_capture
from clothfit.base.messages import metres
from clothfit.cli.common import motions
from clothfit.cli.common.console import Console
from clothfit.cli.common.options import check_numbers, option, section, setting, standard_command
from clothfit.cli.common.output import output_for, print_json
from clothfit.formats.axes import Convention


@standard_command("target")
@click.argument("scene_path", metavar="SCENE")
@section("What to simulate")
@option("--steps N", "Simulate N time steps.  [default: the scene's optimizationIterations - 1]", int)
@setting("--tolerance T", "Relative tolerance of the linear solver.  [default: as tight as a fit's]", float)
@motions.with_forces
@section("What a capture sees of it")
@option("--noise METRES", "Add noise of this standard deviation per coordinate.  [default: 0]", float, default=0.0)
@setting("--observed FRACTION", "Keep this share of the vertices, drawn at random.  [default: 1]", float, default=1.0)
@setting("--every K", "Keep every K-th frame.  [default: 1]", int, default=1)
@option("--fps F", "Record F frames per second, interpolated between steps.  [default: all steps]", float)
@setting("--seed S", "Seed of the random numbers.  [default: 0]", click.IntRange(0), default=0)
@section("What is written")
@option("-o --output MOTION", "File of the motion, in any format.  [default: <stem>.target.npz]", name="path")
@section("The file of the motion")
@motions.writes
def command(
    scene_path: str, steps: int | None, noise: float, observed: float, every: int, fps: float | None, seed: int,
    tolerance: float | None, forces_path: str | None, path: str | None, convention: Convention, console: Console,
) -> None:
    """Record the motion of SCENE with its own parameters, perfect or as a capture would see it.

    With --fps frames may lie between time steps. They are interpolated linearly between the states, as a fit does when
    it compares them.

    \b
    clothfit target scene.json
    clothfit target scene.json --noise 0.001 --set observed=0.25 --set every=2 -o capture.npz
    clothfit target scene.json --noise 0.001 --fps 30 -o capture.npz
    """
    check_capture(noise, observed, every, fps)
    check_numbers(steps, tolerance)
    scene = motions.under_forces(motions.read_scene(scene_path, console), forces_path)
    frames = motions.frames_of(steps, scene)
    out = output_for(path, scene_path, ".target.npz", (forces_path,))
    motions.check_output(out, convention, (scene_path,), gaps=observed < 1)
    from clothfit.fit.estimate import record_target
    from clothfit.motion.degrade import degrade

    motions.warn_of_steps(scene, frames, console)
    console.announce_compilation()
    recorded = record_target(scene, frames, tolerance)
    motions.warn_of_stretch(scene, recorded, console)
    motions.warn_of_energy(scene, recorded, console)
    motion = degrade(recorded, noise, observed, every, seed, fps)
    motions.write_motion(motion, out, scene, convention, console)
    seen = 1.0 if motion.observed is None else float(motion.observed.mean())
    spoiled = f"noise {metres(noise)}" if noise else "no noise"
    console.say(f"{scene.name}: {len(motion.times)} frames, {seen:.0%} seen, {spoiled} → {out.name}")
    counts = {"frames": len(motion.times), "observed": seen, "noise": noise}
    print_json({"scene": scene.name, **counts, "output": out.path})
