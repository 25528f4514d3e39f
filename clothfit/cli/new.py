"""`clothfit new`: make a scene without the editor."""

from __future__ import annotations

from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

import click

from clothfit.base.errors import InvalidInput
from clothfit.base.messages import counted, spans
from clothfit.cli.common.console import Console
from clothfit.cli.common.options import section, standard_command
from clothfit.cli.common.output import STREAM, Output, output_for, print_json
from clothfit.cli.common.scenes import check_there, warn_of_steps
from clothfit.cli.parts.new_options import PLANE, Asked, box, numbers, ranges, side, understood

if TYPE_CHECKING:
    from clothfit.base.arrays import Flags, Indices
    from clothfit.evaluation.overview import Divisions
    from clothfit.meshes.mesh import Mesh
    from clothfit.meshes.problems import Problem
    from clothfit.scene.cloth import Cloth as SceneCloth
    from clothfit.scene.scene import Scene

UNLIMITED = ("implicit", "bdf2")
"""Integrators whose steps nothing limits."""

MOST_NAMED = 12
"""Vertices that are named."""


@standard_command("new")
@click.argument("given", metavar="plane|MESH", required=False)
@section("A plane")
@click.option("--size", metavar="W[xH]", help="Size of the plane in m.  [default: 1]")
@click.option("--divisions", type=click.IntRange(0), metavar="N", help="Give the longer side of the plane N + 2 "
              "vertices.  [default: 10]")
@click.option("--upright", is_flag=True, help="Make the plane stand instead of lie.")
@section("A mesh from a file")
@click.option("--scale", type=float, metavar="METRES", help="Metres per unit of the file.  [default: the format's]")
@click.option("--up", type=click.Choice(["y", "z"]), help="Axis of the file that points up.  [default: the format's]")
@click.option("--handedness", type=click.Choice(["left", "right"]),
              help="Handedness of its axes.  [default: the format's]")
@click.option("--weld", is_flag=False, flag_value="", metavar="[METRES]", help="Join vertices that lie at one place, "
              "and remove triangles without area and unused vertices.  [distance: a millionth of the mesh]")
@section("Where it is")
@click.option("--rotate", metavar="X,Y,Z", help="Rotate by these degrees about z, x, y in turn, as in Unity.")
@click.option("--move", metavar="X,Y,Z", help="Then move by these distances in m.")
@section("What it is made of")
@click.option("--density", type=float, default=0.2, metavar="D", help="Mass per area in kg/m².  [default: 0.2]")
@click.option("--stiffness", type=float, default=50.0, metavar="E",
              help="Stiffness of the springs in N/m.  [default: 50]")
@click.option("--bending", type=float, metavar="SHARE",
              help="Stiffness of bending springs, as a share of --stiffness.  [default: 0.25]")
@click.option("--no-bending", is_flag=True, help="Make springs along edges only.")
@click.option("--damping", type=float, default=0.1, metavar="A",
              help="Damping of vertices and springs.  [default: 0.1]")
@click.option("--drag", metavar="C|air", help="Drag coefficient of the faces, or air for that of real "
              "air.  [default: 0.1; where the wind is fitted, air, which is then fitted too]")
@click.option("--region", multiple=True, metavar="NAME=PLACE", help="Name a part for fits in mode R: a box, "
              "vertices, or a side, written as in the --fix options, such as collar=top=0.05.")
@click.option("--warp", type=click.Choice(["x", "y", "z"]), help="Axis of the scene that is along the cloth.  "
              "[default: u of the mesh's texture, else as its grid shows]")
@section("What holds it")
@click.option("--fix-box", multiple=True, metavar="X,Y,Z:X,Y,Z",
              help="Fix the vertices in the box between two corners.")
@click.option("--fix-vertices", metavar="0,11,20-30", help="Fix vertices by their numbers in the mesh.")
@click.option("--fix-side", multiple=True, metavar="SIDE[=METRES]", help="Fix the vertices within a distance of the "
              "top, bottom, left, right, front or back.  [distance: 0.001 of the size]")
@section("The world")
@click.option("--sphere", multiple=True, metavar="X,Y,Z,R", help="Add a sphere to fall on: centre and radius in m.")
@click.option("--wind", metavar="X,Y,Z", help="Wind in m/s.  [default: none]")
@section("Simulation and fit")
@click.option("--fit", multiple=True, metavar="LETTERS|NAME[=L]",
              help="Parameters to fit. Two letters for masses and stiffnesses: n none, F one factor on what is there, "
              "R one per family and region, M a smooth map, G the same for all, L each its own; or "
              "damping, drag, velocity, rest, wind, gravity.  [default: nF]")
@click.option("--integrator", default="bdf2", metavar="NAME",
              help="Integrator: bdf2, of second order; or implicit, symplectic or explicit, of first order, which "
              "the editor in Unity can play.  [default: bdf2]")
@click.option("--delta", type=float, metavar="SECONDS", help="Time step in s.  [default: 0.02]")
@click.option("--fps", type=float, metavar="F", help="Time steps per second, instead of --delta.")
@click.option("--frames", type=int, default=100, metavar="N",
              help="Number of frames that a fit compares.  [default: 100]")
@click.option("--tolerance", type=float, default=1e-8, metavar="T",
              help="Relative tolerance of the linear solver.  [default: 1e-8]")
@section("What is written")
@click.option("--title", metavar="TEXT", help="Name of the scene.  [default: the file's]")
@click.option("-o", "--output", "path", metavar="SCENE", help="Scene file.  [default: <stem>.json]")
def command(given: str | None, path: str | None, console: Console, **options: Any) -> None:
    """Make a scene of one cloth: a plane, or a mesh from a file (.obj, .glb, .stl, .usd …).

    \b
    clothfit new plane --size 7 --fix-side front
    clothfit new shirt.obj --weld --fix-vertices 0,11,20-30 --fit GG
    clothfit new flag.glb --up z --scale 0.01 --fix-side left --wind 8,0,2 --drag air -o flag.json

    --fix-box, --fix-side, --sphere and --fit may be repeated. Coordinates are in the scene's axes: y up, z forward.
    """  # fmt: skip
    mesh_path, asked = understood(given, Asked(**options))
    is_plane = mesh_path == PLANE
    asked.check(is_plane)
    out = output(mesh_path, path, is_plane)
    stem = PLANE if is_plane else stem_of(mesh_path)
    cloth = plane(asked) if is_plane else mesh(mesh_path, asked, console)
    cloth = cloth._replace(mesh=cloth.mesh._replace(positions=placed(cloth.mesh, asked)))
    fixed = held(cloth, asked)
    scene = made(cloth, fixed, asked, asked.title or stem)
    from clothfit.scene.scene import dumps

    out.write(dumps(scene))
    report(scene, cloth, out, console)
    print_json(summary(scene, cloth, out))


def output(mesh_path: str, path: str | None, is_plane: bool) -> Output:
    """Where the scene goes. Raises InvalidInput."""
    if is_plane:
        return output_for(path or f"{PLANE}.json", STREAM, "", (), text=True)
    if mesh_path == STREAM:
        raise InvalidInput("a mesh is not read from standard input; name a file")
    check_there(*([] if "*" in mesh_path else [mesh_path]))
    from clothfit.meshes.mesh import sources

    return output_for(path or f"{stem_of(mesh_path)}.json", mesh_path, "", tuple(sources(mesh_path)), text=True)


def stem_of(mesh_path: str) -> str:
    """The name of a mesh without folder and suffix, of a sequence without the star."""
    return Path(mesh_path).stem.replace("*", "").rstrip("_-. ") or "mesh"


def made(cloth: Cloth, fixed: Flags, asked: Asked, title: str) -> Scene:
    """The scene. Raises InvalidInput."""
    from clothfit.meshes.new_scene import new_scene

    return new_scene(
        cloth.mesh, fixed, density=asked.density, stiffness=asked.stiffness, bending=asked.bends, damping=asked.damping,
        drag=asked.drag_of(cloth.mesh), fit=asked.letters, fits=asked.kinds,
        spheres=[numbers("--sphere", text, 4, "0,-1,0,0.5") for text in asked.sphere],
        wind=asked.blows, integrator=asked.integrator, delta=asked.step,
        frames=asked.frames, tolerance=asked.tolerance, title=title, numbering=cloth.numbering,
        warp=asked.along, regions=regions(cloth, asked),
    )  # fmt: skip


def report(scene: Scene, cloth: Cloth, out: Output, console: Console) -> None:
    """Say what the scene holds, and what about it is not as one may think."""
    import numpy as np

    from clothfit.evaluation.overview import beyond_bounds, doubts, extent
    from clothfit.scene.kinds import INTEGRATORS

    for sentence in beyond_bounds(scene):
        console.warn(f"{out.name}: {sentence}")
    if INTEGRATORS[scene.method] not in UNLIMITED:  # to know what limits it takes the numerical libraries
        warn_of_steps(scene, scene.frames, console)
    (own,) = scene.cloths
    fixed = own.fixed.nonzero()[0].tolist()
    parts = spans(fixed)
    named = ", ".join(parts[:MOST_NAMED]) + (", …" if len(parts) > MOST_NAMED else "")
    held = f"{counted(len(fixed), 'vertex', 'vertices')} ({named})" if fixed else "none, so it falls"
    console.say(f"fixed: {held}")
    for sentence in divided(own).sentences:
        console.say(sentence)
    size = np.ptp(own.positions, axis=0).tolist()
    for sentence in doubts(size, float(own.mass.sum())):
        console.warn(f"{out.name}: {sentence}")
    console.detail(f"drag {own.drag:.4g}, damping {own.damping:.4g}")
    console.say(
        f"{scene.title}: {len(own.mass)} vertices, {counted(len(own.triangles), 'triangle', 'triangles')}, "
        f"{len(own.springs)} springs, "
        f"{extent(size)}, {own.mass.sum():.4g} kg, {scene.frames} frames of {scene.delta:.4g} s → {out.name}"
    )


def divided(own: SceneCloth) -> Divisions:
    """Families and regions, where the file or the user says something of them; else to know them is not needed."""
    from clothfit.evaluation.overview import Divisions, divisions
    from clothfit.scene.cloth import NOTHING

    return Divisions({}, {}) if own.layout is NOTHING else divisions(own)


def summary(scene: Scene, cloth: Cloth, out: Output) -> dict[str, Any]:
    """What --json prints."""
    (own,) = scene.cloths
    left = [{"kind": each.kind, "count": each.count, "first": each.first, "message": each.sentence}
            for each in cloth.problems]
    return {
        "scene": scene.title,
        "vertices": len(own.mass),
        "triangles": len(own.triangles),
        "springs": len(own.springs),
        "size": [float(high - low) for low, high in zip(own.positions.min(0), own.positions.max(0), strict=True)],
        "mass": float(own.mass.sum()),
        "fixed": own.fixed.nonzero()[0].tolist(),
        "renumbered": cloth.numbering is not None,
        **asdict(divided(own)),
        "problems": left,
        "output": out.path,
    }


# ---- The mesh that a cloth is made of: a plane or a file's, welded, placed and held.

class Cloth(NamedTuple):
    """What a scene is to be made of."""

    mesh: Mesh
    numbering: Indices | None  # vertex now of each vertex of the file, where welding changed that
    problems: list[Problem]  # that are left


def plane(asked: Asked) -> Cloth:
    """A plane."""
    from clothfit.meshes.mesh import plane as made

    divisions = 10 if asked.divisions is None else asked.divisions
    return Cloth(made(divisions, *asked.extent, upright=asked.upright), None, [])


def mesh(path: str, asked: Asked, console: Console) -> Cloth:
    """The mesh of a file, welded where that is asked for. Raises InvalidInput where no cloth can be made of it."""
    asked.distance  # noqa: B018  a wrong distance is refused before the file is read
    from clothfit.meshes.mesh import read_mesh
    from clothfit.meshes.problems import problems, weld

    found, notes = read_mesh(path, asked.up, asked.handedness, asked.scale)
    name = Path(path).name
    for sentence in notes:
        console.say(f"{name}: {sentence}")
    numbering = None
    if asked.weld is not None:
        welded = weld(found, asked.distance)
        found, numbering = welded.mesh, welded.vertices if welded.renumbered else None
        console.say(f"{name}: welded: {counted(welded.joined, 'vertex', 'vertices')} joined to others, "
                    f"{counted(welded.triangles, 'triangle', 'triangles')} and "
                    f"{counted(welded.unused, 'vertex', 'vertices')} left out")
    left = problems(found, asked.distance)
    harmless = [problem for problem in left if not problem.fatal]
    for problem in harmless:
        console.warn(f"{name}: {problem.sentence}")
    fatal = [problem.sentence for problem in left if problem.fatal]
    for sentence in fatal[1:]:
        console.say(f"{name}: {sentence}")
    if fatal:
        raise InvalidInput(f"{name}: no cloth can be made of this mesh: {fatal[0]}{more(len(fatal) - 1)}")
    return Cloth(found, numbering, harmless)


def more(count: int) -> str:
    """Tells of further problems."""
    return f" (and {counted(count, 'more problem', 'more problems')})" if count else ""


def placed(mesh: Mesh, asked: Asked) -> Any:
    """The positions, turned and moved."""
    from clothfit.meshes.mesh import turned

    found = mesh.positions
    if asked.rotate is not None:
        found = turned(found, numbers("--rotate", asked.rotate, 3, "0,90,0"))
    if asked.move is not None:
        found = found + numbers("--move", asked.move, 3, "0,1.5,0")
    return found


def held(cloth: Cloth, asked: Asked) -> Flags:
    """Which vertices do not move. Raises InvalidInput."""
    import numpy as np

    from clothfit.meshes.new_scene import at_side, in_box

    positions = cloth.mesh.positions
    fixed = np.zeros(len(positions), bool)
    for corner, opposite in asked.boxes:
        fixed |= in_box(positions, corner, opposite)
    for name, reach in asked.sides:
        fixed |= at_side(positions, name, reach)
    fixed[numbered(cloth, asked.ranges, "fix vertices")] = True
    return fixed


def numbered(cloth: Cloth, chosen: list[tuple[int, int]], option: str) -> Indices:
    """The vertices in ranges of those of the file. Raises InvalidInput."""
    import numpy as np

    from clothfit.meshes.new_scene import listed

    own = np.arange(len(cloth.mesh.positions), dtype=np.int32) if cloth.numbering is None else cloth.numbering
    named = own[listed(len(own), chosen, option)]
    return named[named >= 0]


def regions(cloth: Cloth, asked: Asked) -> dict[str, Indices]:
    """The vertices of each region that is asked for; one that is named again has both places. Raises InvalidInput."""
    import numpy as np

    found: dict[str, Indices] = {}
    for name, where in asked.parts:
        own = place(cloth, where, f"region {name}")
        found[name] = np.union1d(found.get(name, own), own).astype(np.int32)
    return found


def place(cloth: Cloth, where: str, option: str) -> Indices:
    """The vertices in a box, at a side, or with these numbers in the mesh. Raises InvalidInput."""
    import numpy as np

    from clothfit.meshes.new_scene import at_side, in_box

    positions = cloth.mesh.positions
    if ":" in where:
        return np.flatnonzero(in_box(positions, *box("--region", where))).astype(np.int32)
    if where[:1].isalpha():
        return np.flatnonzero(at_side(positions, *side("--region", where), option)).astype(np.int32)
    return numbered(cloth, ranges("--region", where), option)
