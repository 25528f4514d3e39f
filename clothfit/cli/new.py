"""`clothfit new`: make a scene without the editor."""

from __future__ import annotations

from dataclasses import asdict, dataclass, replace
from math import hypot
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple, NoReturn

import click

from clothfit.base.errors import InvalidInput
from clothfit.base.limits import doubts, doubts_of_time, is_number
from clothfit.base.messages import counted, spans
from clothfit.cli.common.console import Console
from clothfit.cli.common.motions import check_there, warn_of_steps
from clothfit.cli.common.options import gathered, given, option, standard_command, tuned
from clothfit.cli.common.output import SCENE, STREAM, Output, output_for, print_json
from clothfit.cli.parts import new_shot
from clothfit.formats.axes import positive
from clothfit.scene.kinds import AIR, AUTO, DRAG_LAWS, EDITORS, INTEGRATORS, LETTERED, REST

if TYPE_CHECKING:
    from clothfit.base.arrays import Flags, Indices
    from clothfit.evaluation.overview import Divisions
    from clothfit.fabric.presets import Preset
    from clothfit.meshes.mesh import Mesh, Shape
    from clothfit.meshes.problems import Problem
    from clothfit.scene.cloth import Cloth as SceneCloth
    from clothfit.scene.scene import Scene

UNLIMITED = ("implicit", "bdf2", "rest")
"""Integrators whose steps nothing limits."""

MOST_NAMED = 12
"""Vertices that are named."""

PLANE = "plane"
"""Stands for a mesh that needs no file."""

DENSITY, STIFFNESS = 0.2, 50.0
"""kg/m² and N/m, of a cloth of which nothing is said."""

MISSED = 0.1
"""Relative difference from a real fabric that is told."""

CALM, UNKNOWN = 1.0, 5.0
"""Winds, m/s, for which the drag is that of real air where there is none, and where it is to be found."""

Corner = tuple[float, ...]
"""Three coordinates, m."""

SPECIMENS = ("drape", "cantilever", "strip")
"""Stand for the specimens of tests of fabrics (`meshes.specimens`)."""

OF_PLANES = ("size", "divisions", "upright")
OF_MESHES = ("cloth", "collider", "pins_from", "scale", "up", "handedness", "weld")


@dataclass(frozen=True)
class NewOptions:
    """The options as they are given; None or empty where one is not."""

    size: str | None = given("--size W[xH]", "Size of the plane in m; length and width of a strip; diameters of a disc "
        "and of what holds it.  [default: 1; drape 0.3x0.18, cantilever 0.15x0.025, strip 0.3x0.05]",
        title="A plane or a specimen")
    divisions: int | None = given("--divisions N", "Give the longer side N + 2 vertices.  [default: 10 or 20]",
        click.IntRange(0))
    upright: bool = given("--upright", "Make the plane stand instead of lie.")
    cloth: tuple[str, ...] = given("--cloth NAME", "Mesh of the file that is the cloth; each is an object.  [default: "
        "those that move and are no --collider]", multiple=True, title="A mesh from a file")
    collider: tuple[str, ...] = given("--collider NAME", "Mesh of the file that the cloth touches, moving or not.",
        multiple=True)
    scale: float | None = given("--scale METRES", "Metres per unit of the file.  [default: the format's]", float)
    up: str | None = given("--up", "Axis of the file that points up.  [default: the format's]",
        click.Choice(["y", "z"]))
    handedness: str | None = given("--handedness", "Handedness of its axes.  [default: the format's]",
        click.Choice(["left", "right"]))
    weld: str | None = given("--weld [METRES]", "Join vertices that lie at one place, and remove triangles without "
        "area and unused vertices.  [distance: a millionth of the mesh]", is_flag=False, flag_value="")
    rotate: str | None = tuned("--rotate X,Y,Z", "Rotate by these degrees about z, x, y in turn, as in Unity.",
        title="Where it is")
    move: str | None = tuned("--move X,Y,Z", "Then move by these distances in m.")
    fabric: str | None = given("--fabric NAME", "Real fabric, of those that clothfit fabrics lists: its weight, and "
        "where they are known stretch and bending, for the options below.", title="What it is made of")
    density: float | None = given("--density D", "Mass per area in kg/m².  [default: the fabric's, else 0.2]", float)
    stiffness: float | None = given("--stiffness E", "Stiffness of the springs in N/m.  [default: 50]", float)
    bending: float | None = tuned("--bending SHARE", "Stiffness of bending springs, as a share of --stiffness.  "
        "[default: 0.25]", float)
    no_bending: bool = tuned("--no-bending", "Make springs along edges only.")
    damping: float = tuned("--damping A", "Damping of vertices and springs.  [default: 0.1]", float, default=0.1)
    drag: str | None = given("--drag C|air", "Drag coefficient of the faces, or air for that of real air.  [default: "
        "0.1; where the wind is fitted, air, which is then fitted too]")
    drag_law: str = tuned("--drag-law", "How the air pushes faces: editor, as the editor does, or air, by area and "
        "by the square of the speed; then --drag has no unit, and is 1.2 by default.  [default: editor]",
        click.Choice(DRAG_LAWS), default=EDITORS)
    region: tuple[str, ...] = given("--region NAME=PLACE", "Name a part for fits in mode R: a box, vertices, or a "
        "side, written as in the --fix options, such as collar=top=0.05.", multiple=True)
    warp: str | None = tuned("--warp", "Axis of the scene that is along the cloth.  [default: u of the mesh's texture, "
        "else as its grid shows]", click.Choice(["x", "y", "z"]))
    fix_box: tuple[str, ...] = tuned("--fix-box X,Y,Z:X,Y,Z", "Fix the vertices in the box between two corners.",
        multiple=True, title="What holds it")
    fix_vertices: str | None = given("--fix-vertices 0,11,20-30", "Fix vertices by their numbers in the mesh.")
    fix_side: tuple[str, ...] = given("--fix-side SIDE[=METRES]", "Fix the vertices within a distance of the top, "
        "bottom, left, right, front or back.  [distance: 0.001 of the size]", multiple=True)
    pins_from: str | None = given("--pins-from MOTION", "Let the fixed vertices follow this motion of the mesh.")
    sphere: tuple[str, ...] = given("--sphere X,Y,Z,R", "Add a sphere to fall on: centre and radius in m.",
        multiple=True, title="The world")
    layers: str | None = given("--layers [METRES]", "Keep cloths from passing through themselves and each other, at "
        "this distance.  [distance: 0.005]", is_flag=False, flag_value="0.005")
    wind: str | None = given("--wind X,Y,Z", "Wind in m/s.  [default: none]")
    fit: tuple[str, ...] = given("--fit LETTERS|NAME[=L]", "Parameters to fit. Two letters for masses and stiffnesses: "
        "n none, F one factor on what is there, R one per family and region, M a smooth map, G the same for all, L "
        "each its own; or mass, stiffness, damping, drag, velocity, rest, wind, gravity; or auto: the fit chooses.  "
        "[default: nF, of specimens nR]",
        multiple=True, title="Simulation and fit")
    integrator: str | None = given("--integrator NAME", "Integrator: bdf2, of second order; implicit, symplectic or "
        "explicit, of first order, which the editor in Unity can play; or rest, the shape of the cloth at rest.  "
        "[default: bdf2, of specimens rest]")
    delta: float | None = tuned("--delta SECONDS", "Time step in s.  [default: that of the file's frames, else 0.02]",
        float)
    fps: float | None = given("--fps F", "Time steps per second. Says the same as delta.", float)
    frames: int | None = given("--frames N", "Number of frames that a fit compares.  [default: the file's, else 100]",
        int)
    tolerance: float = tuned("--tolerance T", "Relative tolerance of the linear solver.  [default: 1e-8]", float,
        default=1e-08)
    title: str | None = tuned("--title TEXT", "Name of the scene.  [default: the file's]", title="What is written")

    def check(self, made: str) -> None:
        """Raise UsageError where options do not go together, InvalidInput where a text is none of its option; `made` of
        a plane, a specimen or a mesh.
        """
        special = made in SPECIMENS
        for name in (*OF_MESHES, *(("upright",) if special else ())) if special or made == PLANE else OF_PLANES:
            value = getattr(self, name)
            if value is not None and value is not False and value != ():
                owners = "planes" if name in OF_PLANES else "meshes from files"
                raise click.UsageError(f"--{name.replace('_', '-')} is for {owners}; leave it out")
        if self.delta is not None and self.fps:
            raise click.UsageError("--delta and --fps say the same; give one of them")
        if self.bending is not None and self.no_bending:
            raise click.UsageError("--bending and --no-bending say the same; give one of them")
        if AUTO in self.fit and len(set(self.fit)) > 1:
            raise click.UsageError("--fit auto chooses what to fit by itself; leave the others out")
        if (self.rotate or self.move) and (self.collider or self.pins_from):
            raise click.UsageError("--rotate and --move move only the cloth; leave them out, or --collider and "
                                   "--pins-from")
        if self.fix_vertices is not None and len(self.cloth) > 1:
            raise click.UsageError("--fix-vertices is for one cloth; use --fix-box or --fix-side for several")
        positive("--fps", self.fps)
        own = self.preset
        if own and own.full("stretch") and self.stiffness is not None:
            raise click.UsageError(f"the stretch of {own.name} is known; leave out --stiffness, or --fabric")
        if own and (own.full("stretch") or own.full("bending")) and (self.no_bending or self.bending is not None):
            raise click.UsageError("--bending and --no-bending are for cloth without --fabric; leave them out")

    @property
    def preset(self) -> Preset | None:
        """The real fabric, of the density that is given, if one is. Raises InvalidInput."""
        from clothfit.fabric.presets import preset

        own = None if self.fabric is None else preset(self.fabric)
        return own if own is None or self.density is None else replace(own, density=self.density)

    def of_specimen(self) -> NewOptions:
        """The options with the defaults of specimens, which are at rest, in the directions of the fabric."""
        rests = self.integrator in (None, INTEGRATORS[REST])
        return replace(self, integrator=self.integrator or INTEGRATORS[REST], fit=self.fit or ("nR",),
                       frames=self.frames or (2 if rests else None),
                       divisions=20 if self.divisions is None else self.divisions)  # fmt: skip

    def timing(self, shape: Shape | None) -> tuple[float, int]:
        """The time step, s, and the number of frames, by those of a file where it has several."""
        times, count = (shape.times, len(shape.frames)) if shape else (None, 1)
        shown = times is not None and len(times) > 1
        step = 0.02 if self.delta is None else self.delta
        if self.fps is not None:
            step = 1.0 / self.fps
        elif self.delta is None and times is not None and shown:
            step = rounded_step(float(times[-1] - times[0]) / (len(times) - 1))
        own = count if count > 1 else 100
        if times is not None and shown and step > 0:
            own = round(float(times[-1] - times[0]) / step) + 1
        return step, own if self.frames is None else self.frames

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

    def extent(self, fewest: int = 1, example: str = "2 or 2x1.5") -> tuple[float, float]:
        """Width and height, m, or the two sizes of a specimen, of at least so many numbers. Raises InvalidInput."""
        sides = (self.size or "1").split("x")
        if not fewest <= len(sides) <= 2 or "," in (self.size or "") or not all(is_number(side) for side in sides):
            refuse_text("--size", self.size or "", example)
        width, *rest = numbers("--size", ",".join(sides), len(sides), example)
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
        own = {name: mode.upper() or "F" for name, _, mode in (text.partition("=") for text in self.fit)}
        given = letters[-1] if letters else "nn" if self.fit else "nF"
        return "".join(own.get(name, letter) for name, letter in zip(LETTERED, given, strict=True))

    @property
    def kinds(self) -> dict[str, str]:
        """What else to fit: modes by names. The drag of air depends on its speed: with the wind it is not known."""
        split = [text.partition("=") for text in self.fit if len(text) != 2 and text != AUTO]
        named = {name: mode.upper() if equals else "G" for name, equals, mode in split if name not in LETTERED}
        return {"drag": "G", **named} if "wind" in named and self.of_air else named


def understood(path: str | None, given: NewOptions) -> tuple[str, NewOptions]:
    """What to make a scene of, and the options: what stands behind --weld is a distance only where it is a number.

    Raises MissingParameter.
    """
    path = path.lower() if path is not None and path.lower() in (PLANE, *SPECIMENS) else path
    if path is None and given.weld and not is_number(given.weld):
        return given.weld, replace(given, weld="")
    if path is None:
        raise click.MissingParameter(param_hint="'plane|MESH'", param_type="argument", ctx=click.get_current_context())
    return path, given


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
@click.argument("cloth_path", metavar="plane|drape|cantilever|strip|MESH", required=False)
@gathered("given", NewOptions)
@option("-o --output SCENE", "Scene file.  [default: <stem>.json]", name="path")
def command(cloth_path: str | None, path: str | None, given: NewOptions, console: Console) -> None:
    """Make a scene of a cloth: a plane, or a mesh from a file (.obj, .glb, .stl, .usd …), at the first frame of its
    motion; other meshes of the file may be what it touches. Or of a specimen whose shape at rest shows the fabric: a
    disc that hangs from a smaller one (drape), a strip that bends over an edge (cantilever) or hangs (strip).

    \b
    clothfit new plane --size 7 --fix-side front
    clothfit new drape --fabric denim
    clothfit new shirt.obj --weld --fix-vertices 0,11,20-30 --fit GG
    clothfit new shot.usdc --cloth Skirt --collider Body --collider Table --fit auto
    clothfit new flag.glb --up z --scale 0.01 --fix-side left --wind 8,0,2 --drag air -o flag.json

    --fix-box, --fix-side, --sphere and --fit may be repeated. Coordinates are in the scene's axes: y up, z forward.
    """
    mesh_path, given = understood(cloth_path, given)
    is_plane = mesh_path in (PLANE, *SPECIMENS)
    given.check(mesh_path)
    out = output(mesh_path, path, is_plane)
    cloths, bodies = list[Cloth](), list[new_shot.Solid]()
    if mesh_path in SPECIMENS:
        given = given.of_specimen()
        cloths = [specimen(mesh_path, given)]
    elif is_plane:
        cloths = [plane(given)]
    else:
        wanted, others = new_shot.meshes(mesh_path, given.cloth, given.collider, console)
        cloths = [mesh(mesh_path, name, given, console) for name in wanted]
        times = cloths[0].shape.times if cloths[0].shape else None
        convention = given.up, given.handedness, given.scale
        bodies = [new_shot.solid(mesh_path, name, convention, times, out) for name in others]
    from clothfit.meshes.new_scene import joined
    from clothfit.scene.scene import dumps

    made = [made_of(cloth, given, [each.document for each in bodies], mesh_path, console) for cloth in cloths]
    distance = numbers("--layers", given.layers, 1, "0.005") if given.layers else ()
    touching = {"betweenObjects": True, "thickness": distance[0]} if distance else None
    scene = replace(joined(made, touching), folder=out.folder)
    if given.pins_from:
        scene = new_shot.following(scene, given.pins_from, *convention, console)
    for each in bodies:
        each.write()
    out.write(dumps(scene))
    report(scene, cloths, bodies, out, console)
    if given.preset is not None:
        describe_fabric(scene, given.preset, console)
    if not is_plane and not given.pins_from:
        new_shot.hint([own.fixed for own in scene.cloths], cloths, mesh_path, console)
    print_json(summary(scene, cloths, bodies, out))


def made_of(cloth: Cloth, given: NewOptions, bodies: list[dict[str, Any]], mesh_path: str, console: Console) -> Scene:
    """The scene of one cloth. Raises InvalidInput."""
    from clothfit.meshes.new_scene import new_scene

    cloth = cloth._replace(mesh=cloth.mesh._replace(positions=placed(cloth.mesh, given)))
    delta, frames = given.timing(cloth.shape)
    density = DENSITY if given.density is None else given.density
    stiffness = STIFFNESS if given.stiffness is None else given.stiffness
    return new_scene(
        cloth.mesh, held(cloth, given, console), density=density, stiffness=stiffness,
        bending=not given.no_bending if given.bending is None else given.bending, damping=given.damping,
        drag=given.drag_of(cloth.mesh), drag_law=given.drag_law, fit=given.letters, fits=given.kinds,
        spheres=[numbers("--sphere", text, 4, "0,-1,0,0.5") for text in given.sphere], colliders=bodies,
        wind=given.blows, integrator=given.integrator or "bdf2", delta=delta, frames=frames, tolerance=given.tolerance,
        title=given.title or stem_of(mesh_path), numbering=cloth.numbering, name=cloth.name or None,
        warp=cloth.warp if given.warp is None else tuple(float(axis == given.warp) for axis in "xyz"),
        regions=regions(cloth, given), fabric=given.preset,
    )  # fmt: skip


def rounded_step(step: float) -> float:
    """A time step without the rounding errors of the times that it is from."""
    rate = round(1.0 / step, 6) if step > 0 else 0.0
    return 1.0 / rate if rate and abs(1.0 / rate - step) <= 1e-9 * step else step


def output(mesh_path: str, path: str | None, is_plane: bool) -> Output:
    """Where the scene goes. Raises InvalidInput."""
    if is_plane:
        return output_for(path or f"{mesh_path}.json", STREAM, "", (), text=SCENE)
    if mesh_path == STREAM:
        raise InvalidInput("a mesh is not read from standard input; name a file")
    check_there(*([] if "*" in mesh_path else [mesh_path]))
    from clothfit.meshes.mesh import sources

    return output_for(path or f"{stem_of(mesh_path)}.json", mesh_path, "", tuple(sources(mesh_path)), text=SCENE)


def stem_of(mesh_path: str) -> str:
    """The name of a mesh without folder and suffix, of a sequence without the star."""
    return Path(mesh_path).stem.replace("*", "").rstrip("_-. ") or "mesh"


def report(scene: Scene, cloths: list[Cloth], bodies: list[new_shot.Solid], out: Output, console: Console) -> None:
    """Say what the scene holds, and what about it is not as one may think."""
    import numpy as np

    from clothfit.evaluation.overview import beyond_bounds, extent

    console.warn(*beyond_bounds(scene), *doubts_of_time(scene.delta, scene.gravity.tolist()), of=out.name)
    if INTEGRATORS[scene.method] not in UNLIMITED:  # to know what limits it takes the numerical libraries
        warn_of_steps(scene, scene.frames, console)
    console.say(*(each.sentence for each in bodies))
    for cloth, own in zip(cloths, scene.cloths, strict=True):
        of = f"{cloth.name}: " if len(cloths) > 1 else ""
        fixed = own.fixed.nonzero()[0].tolist()
        parts = spans(fixed)
        named = ", ".join(parts[:MOST_NAMED]) + (", …" if len(parts) > MOST_NAMED else "")
        held = f"{counted(len(fixed), 'vertex', 'vertices')} ({named})" if fixed else "none, so it falls"
        console.say(f"{of}fixed: {held}")
        console.say(*divided(own).sentences)
        size = np.ptp(own.positions, axis=0).tolist()
        console.warn(*doubts(size, float(own.mass.sum())), of=out.name)
        console.detail(f"drag {own.drag:.4g}, damping {own.damping:.4g}")
        console.say(
            f"{cloth.name if len(cloths) > 1 else scene.title}: {len(own.mass)} vertices, "
            f"{counted(len(own.triangles), 'triangle', 'triangles')}, {len(own.springs)} springs, {extent(size)}, "
            f"{own.mass.sum():.4g} kg, {scene.frames} frames of {scene.delta:.4g} s → {out.name}"
        )


def describe_fabric(scene: Scene, own: Preset, console: Console) -> None:
    """Say what of a real fabric the scene has, and whether its steps are short enough for it."""
    from clothfit.fabric.fabric import longest_step

    missing = [name for name in ("density", "stretch", "bending") if name not in own.source]
    unknown = f"; nothing is known of its {' and '.join(missing)}" if missing else ""
    console.say(f"{own.name}: {own.description}{unknown}")
    for cloth in scene.cloths:
        console.warn(*missed(cloth, own), of=scene.name)
    bend = own.full("bending")
    if bend is None or INTEGRATORS[scene.method] != "bdf2":
        return
    if scene.delta > (limit := min(longest_step(cloth, bend) for cloth in scene.cloths)):
        console.warn(f"the time step of {scene.delta:.3g} s may shake so stiff a bend on so fine a mesh; steps of "
                     f"{limit:.2g} s (--delta) or --integrator implicit do not", of=scene.name)  # fmt: skip


def missed(cloth: SceneCloth, own: Preset) -> list[str]:
    """A sentence for each stiffness of a real fabric that springs on this mesh cannot have."""
    from clothfit.fabric.fabric import fabric_of

    found = fabric_of(cloth)
    lines = []
    for name, has, unit, factor in (("stretch", found and found.stretch, "N/m", 1.0),
                                    ("bending", found and found.bending_at_rest, "µN m", 1e6)):  # fmt: skip
        known = own.full(name)
        if known and has and any(abs(a / b - 1) > MISSED for a, b in zip(has, known, strict=True)):
            made, meant = (" / ".join(f"{factor * value:.3g}" for value in values) for values in (has, known))
            lines.append(f"springs on this mesh have a {name} of {made} {unit} along warp, weft and bias, not {meant}; "
                        "a grid along the warp can be soft in shear, an irregular mesh cannot")  # fmt: skip
    return lines


def divided(own: SceneCloth) -> Divisions:
    """Families and regions, where the file or the user says something of them; else to know them is not needed."""
    from clothfit.evaluation.overview import Divisions, divisions
    from clothfit.scene.cloth import NOTHING

    return Divisions({}, {}) if own.layout is NOTHING else divisions(own)


def summary(scene: Scene, cloths: list[Cloth], bodies: list[new_shot.Solid], out: Output) -> dict[str, Any]:
    """What --json prints: of several cloths that of the first, and of each in a list."""
    objects = [of_object(own, cloth) for own, cloth in zip(scene.cloths, cloths, strict=True)]
    return {
        "scene": scene.title,
        **objects[0],
        **({"objects": objects} if len(objects) > 1 else {}),
        **({"colliders": [each.summary for each in bodies]} if bodies else {}),
        "output": out.path,
    }


def of_object(own: SceneCloth, cloth: Cloth) -> dict[str, Any]:
    """What --json prints of one cloth."""
    left = [{"kind": each.kind, "count": each.count, "first": each.first, "message": each.sentence}
            for each in cloth.problems]
    return {
        **({"name": cloth.name} if cloth.name else {}),
        "vertices": len(own.mass),
        "triangles": len(own.triangles),
        "springs": len(own.springs),
        "size": [float(high - low) for low, high in zip(own.positions.min(0), own.positions.max(0), strict=True)],
        "mass": float(own.mass.sum()),
        "fixed": own.fixed.nonzero()[0].tolist(),
        "renumbered": cloth.numbering is not None,
        **asdict(divided(own)),
        "problems": left,
    }


# ---- The mesh that a cloth is made of: a plane or a file's, welded, placed and held.

class Cloth(NamedTuple):
    """What a scene is to be made of."""

    mesh: Mesh
    numbering: Indices | None  # vertex now of each vertex of the file, where welding changed that
    problems: list[Problem]  # that are left
    name: str = ""  # of the mesh in a file with several
    shape: Shape | None = None  # what the file has
    fixed: Flags | None = None  # (n,), what of a specimen does not move
    warp: tuple[float, float, float] | None = None  # of a specimen


def plane(given: NewOptions) -> Cloth:
    """A plane."""
    from clothfit.meshes.mesh import plane as made

    divisions = 10 if given.divisions is None else given.divisions
    return Cloth(made(divisions, *given.extent(), upright=given.upright), None, [])


def specimen(kind: str, given: NewOptions) -> Cloth:
    """A specimen. Raises InvalidInput."""
    from clothfit.meshes.specimens import specimen as made

    found = made(kind, given.divisions or 0, given.extent(2, "0.3x0.18") if given.size else None)
    return Cloth(found.mesh, None, [], fixed=found.fixed, warp=found.warp)


def mesh(path: str, wanted: str, given: NewOptions, console: Console) -> Cloth:
    """The mesh of a file, of several that of this name, welded where that is asked for. Raises InvalidInput where no
    cloth can be made of it.
    """
    given.distance  # noqa: B018  a wrong distance is refused before the file is read
    from clothfit.meshes.mesh import read_shape
    from clothfit.meshes.problems import problems, weld

    shape = read_shape(path, given.up, given.handedness, given.scale, wanted)
    found = shape.mesh
    name = f"{Path(path).name}: {wanted}" if len(given.cloth) > 1 else Path(path).name
    console.say(*shape.notes, of=name)
    numbering = None
    if given.weld is not None:
        welded = weld(found, given.distance)
        found, numbering = welded.mesh, welded.vertices if welded.renumbered else None
        console.say(f"{name}: welded: {counted(welded.joined, 'vertex', 'vertices')} joined to others, "
                    f"{counted(welded.triangles, 'triangle', 'triangles')} and "
                    f"{counted(welded.unused, 'vertex', 'vertices')} left out")
    left = problems(found, given.distance)
    harmless = [problem for problem in left if not problem.fatal]
    for problem in harmless:
        console.warn(f"{name}: {problem.sentence}")
    fatal = [problem.sentence for problem in left if problem.fatal]
    console.say(*fatal[1:], of=name)
    if fatal:
        more = f" (and {counted(len(fatal) - 1, 'more problem', 'more problems')})" if fatal[1:] else ""
        raise InvalidInput(f"{name}: no cloth can be made of this mesh: {fatal[0]}{more}")
    return Cloth(found, numbering, harmless, wanted, shape)


def placed(mesh: Mesh, given: NewOptions) -> Any:
    """The positions, turned and moved."""
    from clothfit.meshes.mesh import turned

    found = mesh.positions
    if given.rotate is not None:
        found = turned(found, numbers("--rotate", given.rotate, 3, "0,90,0"))
    if given.move is not None:
        found = found + numbers("--move", given.move, 3, "0,1.5,0")
    return found


def held(cloth: Cloth, given: NewOptions, console: Console) -> Flags:
    """Which vertices do not move: those that are asked for, else those that the file marks as held, or that move there
    as if something held them. Raises InvalidInput.
    """
    import numpy as np

    from clothfit.meshes.new_scene import at_side, in_box

    positions = cloth.mesh.positions
    fixed = np.zeros(len(positions), bool) if cloth.fixed is None else cloth.fixed.copy()
    for text in given.fix_box:
        fixed |= in_box(positions, *box("--fix-box", text))
    for text in given.fix_side:
        fixed |= at_side(positions, *side("--fix-side", text))
    if given.fix_vertices is not None:
        fixed[numbered(cloth, ranges("--fix-vertices", given.fix_vertices), "fix vertices")] = True
    if cloth.shape and not (given.fix_box or given.fix_side or given.fix_vertices):
        own = new_shot.held(cloth.shape, console)
        fixed[own if cloth.numbering is None else cloth.numbering[own]] = True
    return fixed


def numbered(cloth: Cloth, chosen: list[tuple[int, int]], option: str) -> Indices:
    """The vertices in ranges of those of the file. Raises InvalidInput."""
    import numpy as np

    from clothfit.meshes.new_scene import listed

    own = np.arange(len(cloth.mesh.positions), dtype=np.int32) if cloth.numbering is None else cloth.numbering
    named = own[listed(len(own), chosen, option)]
    return named[named >= 0]


def regions(cloth: Cloth, given: NewOptions) -> dict[str, Indices]:
    """The vertices of each region that is asked for; one that is named again has both places. Raises InvalidInput."""
    import numpy as np

    found: dict[str, Indices] = {}
    for text in given.region:
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
