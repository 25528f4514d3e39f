"""`clothfit convert`: a motion from one format to another."""

from __future__ import annotations

import os
from dataclasses import replace
from typing import TYPE_CHECKING, Any

import click

from clothfit.base.errors import InvalidInput
from clothfit.base.messages import metres
from clothfit.cli.common import motions
from clothfit.cli.common.console import Console
from clothfit.cli.common.motions import one_stream, read_scene
from clothfit.cli.common.options import option, section, setting, standard_command
from clothfit.cli.common.output import STREAM, Output, output_for, print_json
from clothfit.formats.axes import SCENE, Axes, Convention, Reading
from clothfit.formats.registry import foreign, format_of

if TYPE_CHECKING:
    from clothfit.base.arrays import Indices
    from clothfit.motion.foreign import Loaded
    from clothfit.scene.scene import Scene


LEAST_ROUNDING = 1e-12
"""m: a rounding that is worth a word."""


@standard_command("convert")
@click.argument("in_path", metavar="IN")
@click.argument("out_path", metavar="OUT")
@section("The scene or the mesh of the motion")
@option("--scene SCENE", "Scene of the motion: checks it, and gives times and faces.", name="scene_path")
@option("--mesh FILE", "Mesh whose faces are written, in any format that has faces.", name="mesh_path")
@option("--bind MESH", "Write the motion of this mesh, which lies on the scene's in the first frame: a render mesh.",
        name="bind_path")
@section("The file IN")
@motions.reads
@section("The file OUT")
@motions.axes("to-", "OUT", declared=setting)
def command(
    in_path: str, out_path: str, scene_path: str | None, mesh_path: str | None, bind_path: str | None, reading: Reading,
    to_scale: float | None, to_up: str | None, to_handedness: str | None, console: Console,
) -> None:
    """Convert a motion from the format of IN to that of OUT; their suffixes name the formats.

    A sequence of OBJ files has one name, with * in place of the frame number. --scale, --up, --handedness, --fps,
    --frames and --map describe IN.

    \b
    clothfit convert scene.motion.npz 'frames/cloth_*.obj' --scene scene.json
    clothfit convert 'frames/cloth_*.obj' capture.npz --scene scene.json --fps 30
    clothfit convert shirt.pc2 shirt.mdd --fps 24 --frames 0:100
    clothfit convert fitted.npz render.pc2 --scene fitted.json --bind render.obj
    clothfit convert shirt.pc2 shirt.usd --mesh shirt.obj --fps 24 --to-scale 0.01 --to-up z
    """
    try:
        convention = Convention(to_scale, to_up, to_handedness)
    except InvalidInput as error:
        raise InvalidInput(f"--to-{error}") from None
    one_stream(in_path, scene_path)
    if bind_path is not None and (scene_path is None or mesh_path is not None):
        raise click.UsageError("--bind goes with --scene, and not with --mesh", click.get_current_context())
    scene = None if scene_path is None else read_scene(scene_path, console)
    others = (scene_path, mesh_path, bind_path, None if reading.markers is None else os.fspath(reading.markers))
    if out_path != STREAM:
        format_of(out_path, writing=True)
    out = output_for(out_path, in_path, "", others)
    motions.check_output(out, convention, (in_path, *others))
    mesh = None if mesh_path is None else mesh_faces(mesh_path)
    loaded = motions.load(in_path, scene, reading, console)
    if scene is not None:
        loaded = of_scene(loaded, scene, out) if bind_path is None else bound(loaded, scene, bind_path)
    faces = chosen_faces(mesh, loaded, mesh_path)
    output = written(loaded, out, scene, faces, convention, console)
    taken = loaded.interpretation.summary()
    summary = {name: taken[name] for name in ("frames", "points")}
    summary |= {"seconds": taken["duration"], "reading": [taken], **output, "output": out.path}
    print_json(summary)


def mesh_faces(path: str) -> tuple[int, Indices]:
    """The number of points, and the faces in the scene's axes, of a mesh. Raises InvalidInput where it has none."""
    from clothfit.motion.foreign import load

    mesh = load(path, None, Reading(frames=":1"))
    if mesh.triangles is None:
        raise InvalidInput(f"--mesh: {path} has no faces")
    return mesh.interpretation.points, mesh.triangles


def bound(loaded: Loaded, scene: Scene, path: str) -> Loaded:
    """The motion of a mesh that lies on the scene's in the first frame. Raises InvalidInput, InvalidMotion."""
    from clothfit.motion.correspondence import embedded
    from clothfit.motion.foreign import load

    mesh, motion = load(path, None, Reading(frames=":1")), loaded.motion
    if motion.observed is not None:
        raise InvalidInput(f"{motion.name}: has gaps; a mesh can be bound to a whole motion only")
    x = embedded(motion.positions, scene, mesh.motion.positions[0], os.path.basename(path))
    made = replace(motion, positions=x, vertex_counts=(x.shape[1],), weights=None)
    return replace(loaded, motion=made, triangles=mesh.triangles)


def of_scene(loaded: Loaded, scene: Scene, out: Output) -> Loaded:
    """The same with the scene's faces; for another program by the vertices of the mesh that it knows."""
    from clothfit.motion.files import for_tools
    from clothfit.scene.mesh_numbering import triangles_of

    found = foreign(out.path)
    if found is None:
        return replace(loaded, triangles=triangles_of(scene))
    motion, faces = for_tools(loaded.motion, scene, found)
    return replace(loaded, motion=motion, triangles=faces)


def chosen_faces(mesh: tuple[int, Indices] | None, loaded: Loaded, mesh_path: str | None) -> Indices | None:
    """The faces to write: those of the mesh, else of the scene or the file. Raises InvalidInput."""
    points = loaded.motion.positions.shape[1]
    if mesh is not None and mesh[0] != points:
        raise InvalidInput(f"--mesh: {mesh_path} has {mesh[0]} vertices, the motion has {points}")
    if mesh is not None:
        return mesh[1]
    return loaded.triangles


def written(
    loaded: Loaded, out: Output, scene: Scene | None, faces: Indices | None, convention: Convention, console: Console
) -> dict[str, Any]:
    """Write the motion; what --json says of that."""
    from clothfit.motion.files import sources
    from clothfit.motion.motion import archive

    count = 0 if faces is None else len(faces)
    found = foreign(out.path)
    if found is None:
        known = loaded.timed or scene is not None
        out.write(archive(loaded.motion, {} if faces is None else {"triangles": faces}, known))
        untimed = "" if known else "; without times, as IN has none (--fps)"
        console.say(f"{out.name}: y up, left-handed, metres{untimed}")
        return {"written": {**SCENE._asdict(), "faces": count, "largest_rounding": 0.0}}
    if faces is None and found.faces:
        console.say(f"{out.name}: gets points only, no faces; --scene or --mesh has some")
    axes = motions.write_foreign(loaded.motion, out, convention, console, faces, loaded.names, loaded.timed)
    try:
        rounding = largest_rounding(loaded, out.path, axes)
    except InvalidInput as error:
        for path in sources(out.path):
            os.unlink(path)
        raise InvalidInput(f"what was written cannot be read again, so it is not kept: {error}") from None
    if rounding is not None and rounding > LEAST_ROUNDING:
        console.say(f"{out.name}: its positions are rounded by {metres(rounding)} at most")
    return {"written": {**axes._asdict(), "faces": count, "largest_rounding": rounding}}


def largest_rounding(loaded: Loaded, path: str, axes: Axes) -> float | None:
    """How far any position, m, is from what was to be written, when the file is read; None where that is not told."""
    import numpy as np

    from clothfit.motion.foreign import load

    back = load(path, None, Reading(axes.scale, axes.up, axes.handedness)).motion.positions
    meant = loaded.motion.positions
    if back.shape != meant.shape:
        return None
    seen = slice(None) if loaded.motion.observed is None else loaded.motion.observed
    return float(np.abs(back[seen] - meant[seen]).max(initial=0.0))
