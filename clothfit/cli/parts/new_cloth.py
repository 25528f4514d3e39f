"""The mesh that `clothfit new` makes a cloth of: a plane or a file's, welded, placed and held."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

from clothfit.base.errors import InvalidInput
from clothfit.base.messages import counted
from clothfit.cli.common.console import Console
from clothfit.cli.parts.new_options import Asked, box, numbers, ranges, side

if TYPE_CHECKING:
    from clothfit.base.arrays import Flags, Indices
    from clothfit.meshes.mesh import Mesh
    from clothfit.meshes.problems import Problem


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
    from clothfit.meshes.mesh_file import read_mesh
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
