"""`clothfit new`: make a scene without the editor."""

from __future__ import annotations

from dataclasses import asdict, dataclass, replace
from math import hypot
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple, NoReturn

import click

from clothfit.base.errors import InvalidInput
from clothfit.base.limits import is_number
from clothfit.base.messages import counted, spans
from clothfit.cli.common.console import Console
from clothfit.cli.common.options import gathered, given, option, standard_command
from clothfit.cli.common.output import STREAM, Output, output_for, print_json
from clothfit.cli.common.scenes import check_there, warn_of_steps
from clothfit.formats.axes import positive
from clothfit.scene.kinds import AIR, AUTO, DRAG_LAWS, EDITORS, INTEGRATORS

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

PLANE = "plane"
"""Stands for a mesh that needs no file."""

CALM, UNKNOWN = 1.0, 5.0
"""Winds, m/s, for which the drag is that of real air where there is none, and where it is to be found."""

Corner = tuple[float, ...]
"""Three coordinates, m."""

OF_PLANES = ("size", "divisions", "upright")
OF_MESHES = ("scale", "up", "handedness", "weld")


@dataclass(frozen=True)
class Asked:
    """The options as they are given; None or empty where one is not."""

    size: str | None = given("--size W[xH]", "Size of the plane in m.  [default: 1]", title="A plane")
    divisions: int | None = given("--divisions N", "Give the longer side of the plane N + 2 vertices.  [default: 10]",
        click.IntRange(0))
    upright: bool = given("--upright", "Make the plane stand instead of lie.")
    scale: float | None = given("--scale METRES", "Metres per unit of the file.  [default: the format's]", float,
        title="A mesh from a file")
    up: str | None = given("--up", "Axis of the file that points up.  [default: the format's]",
        click.Choice(["y", "z"]))
    handedness: str | None = given("--handedness", "Handedness of its axes.  [default: the format's]",
        click.Choice(["left", "right"]))
    weld: str | None = given("--weld [METRES]", "Join vertices that lie at one place, and remove triangles without "
        "area and unused vertices.  [distance: a millionth of the mesh]", is_flag=False, flag_value="")
    rotate: str | None = given("--rotate X,Y,Z", "Rotate by these degrees about z, x, y in turn, as in Unity.",
        title="Where it is")
    move: str | None = given("--move X,Y,Z", "Then move by these distances in m.")
    density: float = given("--density D", "Mass per area in kg/m².  [default: 0.2]", float, default=0.2,
        title="What it is made of")
    stiffness: float = given("--stiffness E", "Stiffness of the springs in N/m.  [default: 50]", float, default=50.0)
    bending: float | None = given("--bending SHARE", "Stiffness of bending springs, as a share of --stiffness.  "
        "[default: 0.25]", float)
    no_bending: bool = given("--no-bending", "Make springs along edges only.")
    damping: float = given("--damping A", "Damping of vertices and springs.  [default: 0.1]", float, default=0.1)
    drag: str | None = given("--drag C|air", "Drag coefficient of the faces, or air for that of real air.  [default: "
        "0.1; where the wind is fitted, air, which is then fitted too]")
    drag_law: str = given("--drag-law", "How the air pushes faces: editor, as the editor does, or air, by area and "
        "by the square of the speed; then --drag has no unit, and is 1.2 by default.  [default: editor]",
        click.Choice(DRAG_LAWS), default=EDITORS)
    region: tuple[str, ...] = given("--region NAME=PLACE", "Name a part for fits in mode R: a box, vertices, or a "
        "side, written as in the --fix options, such as collar=top=0.05.", multiple=True)
    warp: str | None = given("--warp", "Axis of the scene that is along the cloth.  [default: u of the mesh's texture, "
        "else as its grid shows]", click.Choice(["x", "y", "z"]))
    fix_box: tuple[str, ...] = given("--fix-box X,Y,Z:X,Y,Z", "Fix the vertices in the box between two corners.",
        multiple=True, title="What holds it")
    fix_vertices: str | None = given("--fix-vertices 0,11,20-30", "Fix vertices by their numbers in the mesh.")
    fix_side: tuple[str, ...] = given("--fix-side SIDE[=METRES]", "Fix the vertices within a distance of the top, "
        "bottom, left, right, front or back.  [distance: 0.001 of the size]", multiple=True)
    sphere: tuple[str, ...] = given("--sphere X,Y,Z,R", "Add a sphere to fall on: centre and radius in m.",
        multiple=True, title="The world")
    wind: str | None = given("--wind X,Y,Z", "Wind in m/s.  [default: none]")
    fit: tuple[str, ...] = given("--fit LETTERS|NAME[=L]", "Parameters to fit. Two letters for masses and stiffnesses: "
        "n none, F one factor on what is there, R one per family and region, M a smooth map, G the same for all, L "
        "each its own; or damping, drag, velocity, rest, wind, gravity; or auto: the fit chooses.  [default: nF]",
        multiple=True, title="Simulation and fit")
    integrator: str = given("--integrator NAME", "Integrator: bdf2, of second order; or implicit, symplectic or "
        "explicit, of first order, which the editor in Unity can play.  [default: bdf2]", default="bdf2")
    delta: float | None = given("--delta SECONDS", "Time step in s.  [default: 0.02]", float)
    fps: float | None = given("--fps F", "Time steps per second, instead of --delta.", float)
    frames: int = given("--frames N", "Number of frames that a fit compares.  [default: 100]", int, default=100)
    tolerance: float = given("--tolerance T", "Relative tolerance of the linear solver.  [default: 1e-8]", float,
        default=1e-08)
    title: str | None = given("--title TEXT", "Name of the scene.  [default: the file's]", title="What is written")

    def check(self, is_plane: bool) -> None:
        """Raise UsageError where options do not go together, InvalidInput where a text is none of its option."""
        for name in OF_MESHES if is_plane else OF_PLANES:
            if getattr(self, name) is not None and getattr(self, name) is not False:
                raise click.UsageError(f"--{name} is for {'meshes from files' if is_plane else 'planes'}; leave it out")
        if self.delta is not None and self.fps:
            raise click.UsageError("--delta and --fps say the same; give one of them")
        if self.bending is not None and self.no_bending:
            raise click.UsageError("--bending and --no-bending say the same; give one of them")
        if AUTO in self.fit and len(set(self.fit)) > 1:
            raise click.UsageError("--fit auto chooses what to fit by itself; leave the others out")
        positive("--fps", self.fps)

    @property
    def step(self) -> float:
        """The time step, s."""
        if self.fps is not None:
            return 1.0 / self.fps
        return 0.02 if self.delta is None else self.delta

    @property
    def blows(self) -> tuple[float, ...]:
        """The wind, m/s. Raises InvalidInput."""
        return numbers("--wind", self.wind or "0,0,0", 3, "5,0,1")

    def drag_of(self, mesh: Mesh) -> float | None:
        """The air drag of a mesh; None for the usual one of its law. Raises InvalidInput."""
        if not self.of_air:
            return numbers("--drag", self.drag, 1, f"0.1 or {AIR}")[0] if self.drag else None
        if self.drag_law == AIR:
            return None
        from clothfit.meshes.mesh import air_drag

        return air_drag(mesh, hypot(*self.blows) or (UNKNOWN if self._fits("wind") else CALM))

    @property
    def of_air(self) -> bool:
        """Whether the drag is that of real air: where it is asked for, or no number is and the wind is to be found."""
        return self.drag == AIR or (self.drag is None and self._fits("wind"))

    def _fits(self, kind: str) -> bool:
        return any(text.partition("=")[0] in (kind, AUTO) for text in self.fit)

    @property
    def extent(self) -> tuple[float, float]:
        """Width and height of a plane, m. Raises InvalidInput."""
        sides = (self.size or "1").split("x")
        if len(sides) > 2 or "," in (self.size or "") or not all(is_number(side) for side in sides):
            refuse_text("--size", self.size or "", "2 or 2x1.5")
        width, *rest = numbers("--size", ",".join(sides), len(sides), "2 or 2x1.5")
        return width, rest[0] if rest else width

    @property
    def distance(self) -> float | None:
        """Of welding, m; None for what counts as one place. Raises InvalidInput."""
        return numbers("--weld", self.weld, 1, "0.001")[0] if self.weld else None

    @property
    def letters(self) -> str:
        """What to fit of masses and stiffnesses."""
        if AUTO in self.fit:
            return AUTO
        letters = [text for text in self.fit if len(text) == 2]
        return letters[-1] if letters else "nn" if self.fit else "nF"

    @property
    def kinds(self) -> dict[str, str]:
        """What else to fit: modes by names. The drag of air depends on its speed: with the wind it is not known."""
        split = [text.partition("=") for text in self.fit if len(text) != 2 and text != AUTO]
        named = {name: mode.upper() if equals else "G" for name, equals, mode in split}
        return {"drag": "G", **named} if "wind" in named and self.of_air else named


def understood(path: str | None, asked: Asked) -> tuple[str, Asked]:
    """What to make a scene of, and the options: what stands behind --weld is a distance only where it is a number.

    Raises MissingParameter.
    """
    if path is None and asked.weld and not is_number(asked.weld):
        return asked.weld, replace(asked, weld="")
    if path is None:
        raise click.MissingParameter(param_hint="'plane|MESH'", param_type="argument", ctx=click.get_current_context())
    return path, asked


def numbers(option: str, text: str, count: int, example: str) -> tuple[float, ...]:
    """So many numbers with commas between. Raises InvalidInput."""
    try:
        values = tuple(float(item) for item in text.split(","))
    except ValueError:
        values = ()
    if len(values) != count or not all(abs(value) < float("inf") for value in values):
        refuse_text(option, text, example)
    return values


def box(option: str, text: str) -> tuple[Corner, Corner]:
    """Two corners of a box, m. Raises InvalidInput."""
    corners = text.split(":")
    if len(corners) != 2:
        refuse_text(option, text, "0,0,0:1,1,1")
    first, second = (numbers(option, corner, 3, "0,0,0:1,1,1") for corner in corners)
    return first, second


def ranges(option: str, text: str) -> list[tuple[int, int]]:
    """First and last of each range of vertices. Raises InvalidInput."""
    found = []
    for item in text.split(","):
        first, dash, last = item.strip().partition("-")
        ends = (first, last if dash else first)
        if not all(end.isascii() and end.isdigit() and len(end) < 19 for end in ends):
            refuse_text(option, text, "0,11,20-30")
        if int(ends[1]) < int(ends[0]):
            refuse_text(option, item.strip(), "0,11,20-30")
        found.append((int(ends[0]), int(ends[1])))
    return found


def side(option: str, text: str) -> tuple[str, float | None]:
    """A side and how far it reaches, m. Raises InvalidInput."""
    name, by, reach = text.partition("=")
    return name, numbers(option, reach, 1, "top=0.02")[0] if by else None


def refuse_text(option: str, text: str, example: str) -> NoReturn:
    """Raise InvalidInput for a text that is none of its option."""
    raise InvalidInput(f"{option}: {text!r} is not understood; give it as in {example}")


@standard_command("new")
@click.argument("cloth_path", metavar="plane|MESH", required=False)
@gathered("asked", Asked)
@option("-o --output SCENE", "Scene file.  [default: <stem>.json]", name="path")
def command(cloth_path: str | None, path: str | None, asked: Asked, console: Console) -> None:
    """Make a scene of one cloth: a plane, or a mesh from a file (.obj, .glb, .stl, .usd …).

    \b
    clothfit new plane --size 7 --fix-side front
    clothfit new shirt.obj --weld --fix-vertices 0,11,20-30 --fit GG
    clothfit new flag.glb --up z --scale 0.01 --fix-side left --wind 8,0,2 --drag air -o flag.json

    --fix-box, --fix-side, --sphere and --fit may be repeated. Coordinates are in the scene's axes: y up, z forward.
    """
    mesh_path, asked = understood(cloth_path, asked)
    is_plane = mesh_path == PLANE
    asked.check(is_plane)
    out = output(mesh_path, path, is_plane)
    cloth = plane(asked) if is_plane else mesh(mesh_path, asked, console)
    cloth = cloth._replace(mesh=cloth.mesh._replace(positions=placed(cloth.mesh, asked)))
    from clothfit.meshes.new_scene import new_scene
    from clothfit.scene.scene import dumps

    scene = new_scene(
        cloth.mesh, held(cloth, asked), density=asked.density, stiffness=asked.stiffness,
        bending=not asked.no_bending if asked.bending is None else asked.bending, damping=asked.damping,
        drag=asked.drag_of(cloth.mesh), drag_law=asked.drag_law, fit=asked.letters, fits=asked.kinds,
        spheres=[numbers("--sphere", text, 4, "0,-1,0,0.5") for text in asked.sphere],
        wind=asked.blows, integrator=asked.integrator, delta=asked.step, frames=asked.frames, tolerance=asked.tolerance,
        title=asked.title or stem_of(mesh_path), numbering=cloth.numbering,
        warp=None if asked.warp is None else tuple(float(axis == asked.warp) for axis in "xyz"),
        regions=regions(cloth, asked),
    )  # fmt: skip
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


def report(scene: Scene, cloth: Cloth, out: Output, console: Console) -> None:
    """Say what the scene holds, and what about it is not as one may think."""
    import numpy as np

    from clothfit.evaluation.overview import beyond_bounds, doubts, extent

    console.warn(*beyond_bounds(scene), of=out.name)
    if INTEGRATORS[scene.method] not in UNLIMITED:  # to know what limits it takes the numerical libraries
        warn_of_steps(scene, scene.frames, console)
    (own,) = scene.cloths
    fixed = own.fixed.nonzero()[0].tolist()
    parts = spans(fixed)
    named = ", ".join(parts[:MOST_NAMED]) + (", …" if len(parts) > MOST_NAMED else "")
    held = f"{counted(len(fixed), 'vertex', 'vertices')} ({named})" if fixed else "none, so it falls"
    console.say(f"fixed: {held}")
    console.say(*divided(own).sentences)
    size = np.ptp(own.positions, axis=0).tolist()
    console.warn(*doubts(size, float(own.mass.sum())), of=out.name)
    console.detail(f"drag {own.drag:.4g}, damping {own.damping:.4g}")
    console.say(
        f"{scene.title}: {len(own.mass)} vertices, {counted(len(own.triangles), 'triangle', 'triangles')}, "
        f"{len(own.springs)} springs, {extent(size)}, {own.mass.sum():.4g} kg, {scene.frames} frames of "
        f"{scene.delta:.4g} s → {out.name}"
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
    console.say(*notes, of=name)
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
    console.say(*fatal[1:], of=name)
    if fatal:
        more = f" (and {counted(len(fatal) - 1, 'more problem', 'more problems')})" if fatal[1:] else ""
        raise InvalidInput(f"{name}: no cloth can be made of this mesh: {fatal[0]}{more}")
    return Cloth(found, numbering, harmless)


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
    for text in asked.fix_box:
        fixed |= in_box(positions, *box("--fix-box", text))
    for text in asked.fix_side:
        fixed |= at_side(positions, *side("--fix-side", text))
    if asked.fix_vertices is not None:
        fixed[numbered(cloth, ranges("--fix-vertices", asked.fix_vertices), "fix vertices")] = True
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
    for text in asked.region:
        name, _, where = text.partition("=")
        name = name.strip()
        if not name or not where:
            refuse_text("--region", text, "collar=top=0.05, collar=0-11,140 or collar=0,0,0:1,1,1")
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
