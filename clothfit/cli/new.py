"""`clothfit new`: make a scene without the editor."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

import click

from clothfit.base.errors import InvalidInput
from clothfit.base.messages import counted
from clothfit.cli.common import shared
from clothfit.cli.common import stability_warnings as trust
from clothfit.cli.common.console import Console
from clothfit.cli.common.new_options import PLANE, Asked, numbers, understood

if TYPE_CHECKING:
    from clothfit.base.arrays import Flags, Indices
    from clothfit.meshes.mesh import Mesh
    from clothfit.meshes.problems import Problem
    from clothfit.scene.scene import Scene

SHOWN = 12
"""Vertices that are named."""


class Cloth(NamedTuple):
    """What a scene is to be made of."""

    mesh: Mesh
    numbering: Indices | None  # vertex now of each vertex of the file, where welding changed that
    problems: list[Problem]  # that are left


@shared.command("new")
@click.argument("given", metavar="plane|MESH", required=False)
@click.option("--size", metavar="W[xH]", help="Of the plane, m.  [default: 1]")
@click.option("--divisions", type=click.IntRange(0), metavar="N", help="Of the plane: N + 2 vertices along its longer "
              "side.  [default: 10]")
@click.option("--upright", is_flag=True, help="The plane stands, instead of lying level.")
@click.option("--scale", type=float, metavar="METRES", help="Of the file's unit.  [default: the format's]")
@click.option("--up", type=click.Choice(["y", "z"]), help="The file's axis up.  [default: the format's]")
@click.option("--handedness", type=click.Choice(["left", "right"]), help="Of its axes.  [default: the format's]")
@click.option("--weld", is_flag=False, flag_value="", metavar="[METRES]", help="Join vertices that lie at one place, "
              "and leave out what no cloth can have.  [distance: a millionth of the mesh]")
@click.option("--rotate", metavar="X,Y,Z", help="Degrees about the axes, as in Unity: z, x, y in turn.")
@click.option("--move", metavar="X,Y,Z", help="By so many m, after that.")
@click.option("--density", type=float, default=0.2, metavar="D", help="kg/m².  [default: 0.2]")
@click.option("--stiffness", type=float, default=50.0, metavar="E", help="N/m.  [default: 50]")
@click.option("--bending", type=float, metavar="SHARE", help="Of the stiffness, that bending has.  [default: 0.25]")
@click.option("--no-bending", is_flag=True, help="Springs along edges only.")
@click.option("--damping", type=float, default=0.1, metavar="A", help="Of vertices and springs.  [default: 0.1]")
@click.option("--drag", default="0.1", metavar="C|air", help="Of the faces; air: such that they feel the wind as in "
              "the world.  [default: 0.1]")
@click.option("--fix-box", multiple=True, metavar="X,Y,Z:X,Y,Z", help="Hold the vertices between two corners.")
@click.option("--fix-vertices", metavar="0,11,20-30", help="Hold vertices, by their numbers in the mesh.")
@click.option("--fix-side", multiple=True, metavar="SIDE[=METRES]", help="Hold what is that near to the top, bottom, "
              "left, right, front or back.  [distance: 0.001 of the size]")
@click.option("--sphere", multiple=True, metavar="X,Y,Z,R", help="Something to fall on, m.")
@click.option("--wind", metavar="X,Y,Z", help="m/s.")
@click.option("--fit", multiple=True, metavar="LETTERS|NAME[=L]", help="Masses and stiffnesses: n, G or L each; or "
              "damping, drag, velocity, rest, wind, gravity.  [default: nG]")
@click.option("--integrator", default="implicit", metavar="NAME", help="implicit, symplectic or explicit.  [default: "
              "implicit]")
@click.option("--delta", type=float, metavar="SECONDS", help="Time step.  [default: 0.02]")
@click.option("--fps", type=float, metavar="F", help="Time steps per second, instead.")
@click.option("--frames", type=int, default=100, metavar="N", help="That a fit compares.  [default: 100]")
@click.option("--tolerance", type=float, default=1e-5, metavar="T", help="Of the linear solver.  [default: 1e-5]")
@click.option("--title", metavar="TEXT", help="Name of the scene.  [default: the file's]")
@click.option("-o", "--output", "path", metavar="SCENE", help="Scene file.  [default: <stem>.json]")
def command(given: str | None, path: str | None, as_json: bool, console: Console, **options: Any) -> int:
    """Make a scene of one cloth: a plane, or a mesh from a file (.obj, .glb, .ply, .usd), as the front end builds it.

    \b
    clothfit new plane --size 7 --fix-side front
    clothfit new shirt.obj --weld --fix-vertices 0,11,20-30 --fit GG
    clothfit new flag.glb --up z --scale 0.01 --fix-side left --wind 8,0,2 --drag air -o flag.json

    May be repeated: --fix-box, --fix-side, --sphere, --fit. Places are in the scene's axes: y up, z forward.
    """  # fmt: skip
    mesh_path, asked = understood(given, Asked(**options))
    is_plane = mesh_path == PLANE
    asked.check(is_plane)
    out = output(mesh_path, path, is_plane)
    stem = PLANE if is_plane else Path(mesh_path).stem.replace("*", "").rstrip("_-. ") or "mesh"
    cloth = plane(asked) if is_plane else mesh(mesh_path, asked, console)
    cloth = cloth._replace(mesh=cloth.mesh._replace(positions=placed(cloth.mesh, asked)))
    fixed = held(cloth, asked)
    scene = made(cloth, fixed, asked, asked.title or stem)
    from clothfit.scene.scene import dumps

    out.write(dumps(scene))
    tell(scene, cloth, out, console)
    if as_json:
        shared.print_json("new", summary(scene, cloth, out), out)
    return 0


def output(mesh_path: str, path: str | None, is_plane: bool) -> shared.Output:
    """Where the scene goes. Raises InvalidInput."""
    if is_plane:
        return shared.output(path or f"{PLANE}.json", shared.STREAM, "", (), text=True)
    if mesh_path == shared.STREAM:
        raise InvalidInput("a mesh is not read from standard input; name a file")
    shared.check_there(*([] if "*" in mesh_path else [mesh_path]))
    from clothfit.meshes.mesh_file import sources

    return shared.output(path or default_name(mesh_path), mesh_path, "", tuple(sources(mesh_path)), text=True)


def default_name(mesh_path: str) -> str:
    """Beside the mesh, and of a sequence without the star."""
    path = Path(mesh_path)
    return str(path.with_name((path.stem.replace("*", "").rstrip("_-. ") or "mesh") + ".json"))


def plane(asked: Asked) -> Cloth:
    """A plane."""
    from clothfit.meshes.mesh import plane as made

    divisions = 10 if asked.divisions is None else asked.divisions
    return Cloth(made(divisions, *asked.extent, upright=asked.upright), None, [])


def mesh(path: str, asked: Asked, console: Console) -> Cloth:
    """The mesh of a file, welded where that is asked for. Raises InvalidInput where no cloth can be made of it."""
    asked.distance  # noqa: B018  a wrong one is told before the file is read
    from clothfit.meshes.mesh_file import read_mesh
    from clothfit.meshes.problems import problems
    from clothfit.meshes.weld import weld

    found, notes = read_mesh(path, asked.up, asked.handedness, asked.scale)
    name = Path(path).name
    for note in notes:
        console.say(f"{name}: {note}")
    numbering = None
    if asked.weld is not None:
        welded = weld(found, asked.distance)
        found, numbering = welded.mesh, welded.vertices if welded.renumbered else None
        console.say(f"{name}: welded: {counted(welded.joined, 'vertex', 'vertices')} joined to others, "
                    f"{counted(welded.triangles, 'triangle', 'triangles')} and "
                    f"{counted(welded.unused, 'vertex', 'vertices')} left out")
    left = problems(found, asked.distance)
    told = [problem for problem in left if not problem.fatal]
    for problem in told:
        console.warn(f"{name}: {problem.sentence}")
    fatal = [problem.sentence for problem in left if problem.fatal]
    for sentence in fatal[1:]:
        console.say(f"{name}: {sentence}")
    if fatal:
        raise InvalidInput(f"{name}: no cloth can be made of this mesh: {fatal[0]}{more(len(fatal) - 1)}")
    return Cloth(found, numbering, told)


def more(count: int) -> str:
    """Tells of further problems."""
    return f" (and {counted(count, 'more problem', 'more problems')})" if count else ""


def placed(mesh: Mesh, asked: Asked) -> Any:
    """The positions, turned and moved."""
    from clothfit.meshes.mesh_file import turned

    found = mesh.positions
    if asked.rotate is not None:
        found = turned(found, numbers("--rotate", asked.rotate, 3, "0,90,0"))
    if asked.move is not None:
        found = found + numbers("--move", asked.move, 3, "0,1.5,0")
    return found


def held(cloth: Cloth, asked: Asked) -> Flags:
    """Which vertices do not move. Raises InvalidInput."""
    import numpy as np

    from clothfit.meshes.fixing import at_side, in_box, listed

    positions = cloth.mesh.positions
    fixed = np.zeros(len(positions), bool)
    for corner, opposite in asked.boxes:
        fixed |= in_box(positions, corner, opposite)
    for side, reach in asked.sides:
        fixed |= at_side(positions, side, reach)
    own = np.arange(len(positions)) if cloth.numbering is None else cloth.numbering
    named = own[listed(len(own), asked.ranges)]
    fixed[named[named >= 0]] = True
    return fixed


def made(cloth: Cloth, fixed: Flags, asked: Asked, title: str) -> Scene:
    """The scene. Raises InvalidInput."""
    from clothfit.meshes.new_scene import new_scene

    return new_scene(
        cloth.mesh, fixed, density=asked.density, stiffness=asked.stiffness, bending=asked.bends, damping=asked.damping,
        drag=asked.drag_of(cloth.mesh), fit=asked.letters, fits=asked.kinds,
        spheres=[numbers("--sphere", text, 4, "0,-1,0,0.5") for text in asked.sphere],
        wind=asked.blows, integrator=asked.integrator, delta=asked.step,
        frames=asked.frames, tolerance=asked.tolerance, title=title, numbering=cloth.numbering,
    )  # fmt: skip


def tell(scene: Scene, cloth: Cloth, out: shared.Output, console: Console) -> None:
    """Say what the scene holds, and what about it is not as one may think."""
    from clothfit.inspection.overview import beyond_bounds
    from clothfit.scene.scene import INTEGRATORS

    for sentence in beyond_bounds(scene):
        console.warn(f"{out.name}: {sentence}")
    if INTEGRATORS[scene.method] != "implicit":  # which nothing limits; to know that takes the numerical libraries
        trust.warn_of_steps(scene, scene.frames, console)
    (own,) = scene.cloths
    fixed = own.fixed.nonzero()[0].tolist()
    named = ", ".join(map(str, fixed[:SHOWN])) + (", …" if len(fixed) > SHOWN else "")
    held = f"{counted(len(fixed), 'vertex', 'vertices')} ({named})" if fixed else "none, so it falls"
    console.say(f"fixed: {held}")
    console.detail(f"drag {own.drag:.4g}, damping {own.damping:.4g}")
    console.say(
        f"{scene.title}: {len(own.mass)} vertices, {counted(len(own.triangles), 'triangle', 'triangles')}, "
        f"{len(own.springs)} springs, "
        f"{own.mass.sum():.4g} kg, {scene.frames} frames of {scene.delta:.4g} s → {out.name}"
    )


def summary(scene: Scene, cloth: Cloth, out: shared.Output) -> dict[str, Any]:
    """What --json prints."""
    (own,) = scene.cloths
    left = [{"kind": each.kind, "count": each.count, "first": each.first, "message": each.sentence}
            for each in cloth.problems]
    return {
        "scene": scene.title,
        "vertices": len(own.mass),
        "triangles": len(own.triangles),
        "springs": len(own.springs),
        "mass": float(own.mass.sum()),
        "fixed": own.fixed.nonzero()[0].tolist(),
        "renumbered": cloth.numbering is not None,
        "problems": left,
        "output": out.path,
    }
