"""The scene: what the JSON of the editor says, checked, as arrays in SI units; loading and saving it.

A scene is immutable; a fit makes new ones with other values. Each remembers the text it came from, and saving changes
nothing in that text but the numbers that differ. The camelCase names of the file end here and in `checks` and `kinds`:
the rest of the package knows these fields.
"""

from __future__ import annotations

import json
import os
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from operator import index
from typing import IO, Any

import numpy as np
import numpy.typing as npt

from clothfit.base.arrays import Array
from clothfit.base.errors import InvalidInput, InvalidScene
from clothfit.base.messages import counted
from clothfit.base.notebook import html_of
from clothfit.base.writing import write_atomically
from clothfit.scene import array_checks as checks
from clothfit.scene import schema as structure
from clothfit.scene.block import Block, flagged
from clothfit.scene.bounds import Bounds, from_file
from clothfit.scene.cloth import PLANE, Cloth, Collider, SelfContact, Sphere, layout_of, obstacles, self_contact
from clothfit.scene.cloth import sphere_document as _sphere
from clothfit.scene.cloth import vector as _vector
from clothfit.scene.families import with_families
from clothfit.scene.forces import Forces, check_forces
from clothfit.scene.keys import Frame, Keys, Pin, files_from, frame, keys, pins
from clothfit.scene.kinds import AUTO, CLOTH_KINDS, EDITORS, INTEGRATORS, KIND, KINDS, LETTERED, SCENE_KINDS, Kind
from clothfit.scene.splice import Appended, Optional, splice
from clothfit.scene.text import Readable, Source, constant_problem, name_of, parse, read_text

WAY_OUT = '"planes": "solid" in the scene makes them solid'
NOT_FITTED = (None, "n", "N", False)
LETTERS: dict[str | bool, str] = {
    "n": "n", "f": "F", "r": "R", "m": "M", "g": "G", "l": "L", False: "n", True: "G",
}  # fmt: skip


@dataclass(frozen=True, eq=False)
class Scene(checks.ReadOnly):
    """A valid scene, immutable; `load` and `new_scene` make one. Units are those of SI, axes y up and left-handed."""

    title: str  # for people
    method: int  # 0 explicit, 1 symplectic, 2 implicit Euler, 3 BDF2, 4 at rest
    delta: float  # time step, s
    tolerance: float  # of the linear solver, relative to the right-hand side
    frames: int  # that a fit compares, the initial one included
    newton_iterations: int  # per implicit or BDF2 step; 1 is the linearised step
    wind: Array  # (3,) m/s, read-only
    gravity: Array  # (3,) m/s², read-only
    fits: Mapping[str, str]  # what to fit of the scene as a whole, by names of `SCENE_KINDS`: "wind" to "G", …
    cloths: tuple[Cloth, ...]  # at least one, in file order
    spheres: tuple[Sphere, ...]  # the obstacles that the editor has
    warnings: tuple[str, ...]  # what the file asks for but the program ignores, one sentence each
    name: str  # of the file, for messages
    source: Source  # original text, for saving
    bounds: Bounds = field(default_factory=dict)  # of a fit, by kind; those of an object go before
    wind_keys: Keys | None = None  # what is added to the wind over time, m/s
    gravity_keys: Keys | None = None  # what is added to the gravity, m/s²
    frame: Frame | None = None  # how the axes move in which all of it is meant, but wind and gravity
    colliders: tuple[Collider, ...] = ()  # the other obstacles
    offset: Array = field(default_factory=lambda: np.zeros(3))  # (3,) m, read-only: of all obstacles, from their `pos`
    self_contact: SelfContact | None = None  # of each cloth with itself; None: cloths pass through themselves
    folder: str = ""  # that paths in its text are relative to; empty: the current one
    forces: Forces | None = None  # that are applied to the vertices of all objects; not in the file
    auto: bool = False  # whether a fit chooses by itself what to fit
    main: Scene | None = None  # whose values the factors of modes F, R and M multiply; None: this one's

    def __repr__(self) -> str:
        springs, values = sum(len(cloth.stiffness) for cloth in self.cloths), sum(block.count for block in self.blocks)
        sizes = [
            counted(len(self.cloths), "object", "objects"), counted(sum(self.vertex_counts), "vertex", "vertices"),
            counted(springs, "spring", "springs"), f"{self.frames} frames of {self.delta:.4g} s",
            f"{INTEGRATORS[self.method]}", f"{counted(values, 'value', 'values')} to fit",
        ]  # fmt: skip
        return f"<Scene {self.name}: {', '.join(sizes)}>"

    def _repr_html_(self) -> str:
        return html_of(self)

    @property
    def gusts(self) -> Array:
        """What the keys add to the wind, (K, 3) m/s; empty without keys, and where a file has them."""
        return np.zeros((0, 3)) if self.wind_keys is None or self.wind_keys.file else self.wind_keys.values

    @property
    def friction(self) -> Array:
        """Coefficients of friction (C,) of the `laws`."""
        return np.array([each.friction for each in self.laws])

    @property
    def contact(self) -> Array:
        """Stiffnesses of contact (C,) of the `laws`, N/m."""
        return np.array([each.stiffness for each in self.laws])

    @property
    def laws(self) -> tuple[Collider | SelfContact, ...]:
        """What has a friction and a stiffness of its own: the `colliders`, then the contact of cloths with themselves.
        """
        return (*self.colliders, *([self.self_contact] if self.self_contact else []))

    @property
    def changes(self) -> bool:
        """Whether wind, gravity, an obstacle or the axes change over time."""
        moving = any(sphere.position for sphere in self.spheres) or any(each.moves for each in self.colliders)
        return bool(self.wind_keys or self.gravity_keys or self.frame or moving)

    @property
    def moves(self) -> bool:
        """Whether any input changes over time, pins included."""
        return self.changes or any(cloth.pins for cloth in self.cloths)

    @property
    def obstacles(self) -> int:
        """Number of obstacles of both kinds."""
        return len(self.spheres) + len(self.colliders)

    @property
    def vertex_counts(self) -> tuple[int, ...]:
        """Number of vertices of each cloth."""
        return tuple(len(cloth.mass) for cloth in self.cloths)

    def vertices(self, cloth: int) -> slice:
        """Where the vertices of a cloth are among those of all."""
        start = sum(self.vertex_counts[:cloth])
        return slice(start, start + self.vertex_counts[cloth])

    def together(self, cloth: int) -> range:
        """The objects that a cloth is simulated with, itself included: all where they touch each other."""
        layers = self.self_contact is not None and self.self_contact.between
        return range(len(self.cloths)) if layers else range(cloth, cloth + 1)

    @property
    def groups(self) -> list[range]:
        """The objects that are simulated together, one group after another."""
        first = [i for i in range(len(self.cloths)) if self.together(i)[0] == i]
        return [self.together(i) for i in first]

    def place_of(self, cloth: int, vertex: int) -> tuple[int, int]:
        """The object, and the number in it, of a vertex among those of a cloth and of what is simulated with it."""
        objects = self.together(cloth)
        found, own = owner(vertex, self.vertex_counts[objects.start : objects.stop])
        return objects[found], own

    def check_apart(self, what: str) -> None:
        """Raise InvalidInput where objects touch each other: `what` takes each for itself."""
        if len(self.groups) < len(self.cloths):
            raise InvalidInput(
                f"{self.name}: selfCollision.betweenObjects: {what} takes each object for itself; write them as one "
                "object, or let them pass through each other"
            )

    def mode(self, name: str) -> str:
        """How one of the scene's own kinds ("wind", "friction", …) is fitted: "n" not at all, "G" one value or vector,
        "L" that of each key or contact.
        """
        return self.fits.get(name, "n")

    @cached_property
    def blocks(self) -> tuple[Block, ...]:
        """What the scene flags, in the order of the fit vector."""
        count = (len(self.laws),)
        shapes = {"gusts": self.gusts.shape, "friction": count, "contact": count}
        return flagged(self.cloths, self.fits, self.bounds, self.main.blocks if self.main else (), shapes)

    def default(self, kind: Kind) -> npt.ArrayLike:
        """The value of a kind where the file gives none."""
        defaults = structure.defaults("scene")
        return _vector(defaults[kind.field]) if kind.field in defaults else getattr(self, kind.name)

    def with_forces(self, forces: Forces | None) -> Scene:
        """The scene with these forces in place of those it has. Raises InvalidInput where they do not fit it."""
        if forces is not None:
            check_forces(forces, sum(self.vertex_counts))
        return replace(self, forces=forces)

    def with_bounds(self, asked: Bounds) -> Scene:
        """The scene with these bounds of a fit in place of its own and of its objects'."""
        if not asked:
            return self
        cloths = [replace(c, bounds={k: v for k, v in c.bounds.items() if k not in asked}) for c in self.cloths]
        return replace(self, cloths=tuple(cloths), bounds={**self.bounds, **asked})

    def with_values(
        self, masses: Sequence[npt.ArrayLike], stiffnesses: Sequence[npt.ArrayLike], **others: Any
    ) -> Scene:
        """Make a new scene with other masses (n,), kg, and stiffnesses (S,), N/m, one array for each cloth.

        `others` are values of other kinds, by their names. Those of objects are one item for each cloth: `damping` and
        `drag` a number, `velocity` (n, 3), m/s, `rest` (S,), m, `path` (K, 3), m, of the keys of all its pins in the
        scene, `shift` (3,), m. Those of the scene, `wind`, m/s, `gravity`, m/s², and `offset`, m, are (3,), `gusts`
        (K, 3), m/s, `friction` and `contact`, N/m, one for each of `laws`. Raises
        InvalidScene when a shape differs, or a value is not finite or outside what its kind allows.
        """
        if not len(masses) == len(stiffnesses) == len(self.cloths):
            given = f"{len(masses)} arrays of masses and {len(stiffnesses)} of stiffnesses"
            raise InvalidScene(f"objects: {given} for {len(self.cloths)} objects; one each is needed", self.name)
        for name, each in others.items():
            if name not in KIND:
                raise InvalidScene(f"there is no kind {name!r}; there are {', '.join(KIND)}", self.name)
            if KIND[name] not in SCENE_KINDS and len(each) != len(self.cloths):
                raise InvalidScene(f"{name}: {len(each)} items for {len(self.cloths)} objects are given", self.name)
        problems: list[str] = []
        own = {"mass": masses, "stiffness": stiffnesses, **others}
        shared = {kind.name: own.pop(kind.name) for kind in SCENE_KINDS if kind.name in own}
        cloths = []
        for i, cloth in enumerate(self.cloths):
            values = {name: each[i] for name, each in own.items()}
            made = _checked(cloth, values, f"objects[{i}].", problems)
            cloths.append(cloth if problems else cloth.with_kinds(**made))
        changed = _checked(self, shared, "", problems)
        if problems:
            raise InvalidScene(problems, self.name)
        return replace(self, cloths=tuple(cloths), **self._parts(changed))

    def _parts(self, changed: dict[str, Any]) -> dict[str, Any]:
        """The fields that new values of the scene's own kinds give."""
        made: dict[str, Any] = {name: changed[name] for name in ("wind", "gravity", "offset") if name in changed}
        if "gusts" in changed and self.wind_keys:
            made["wind_keys"] = replace(self.wind_keys, values=changed["gusts"])
        if {"friction", "contact", "offset"} & changed.keys():
            offset = changed.get("offset", self.offset)
            numbers = zip(changed.get("friction", self.friction), changed.get("contact", self.contact), strict=True)
            laws = [(float(friction), float(stiffness)) for friction, stiffness in numbers]
            made["spheres"] = tuple(replace(each, offset=offset) for each in self.spheres)
            made["colliders"] = tuple(
                replace(each, offset=offset, friction=friction, stiffness=stiffness)
                for each, (friction, stiffness) in zip(self.colliders, laws, strict=False)  # one more of self-contact
            )
            if self.self_contact:
                friction, stiffness = laws[-1]
                made["self_contact"] = replace(self.self_contact, friction=friction, stiffness=stiffness)
        return made

    def with_step(self, delta: float, frames: int | None = None, method: int | str | None = None) -> Scene:
        """Make a new scene that is simulated with another time step `delta`, s, and so many `frames`, by an integration
        method, its name or its number; None keeps what there is. Steps of delta/K reach the frame i as frame K i.

        Raises InvalidScene when one of them is impossible.
        """
        if isinstance(method, str) and method not in INTEGRATORS:
            raise InvalidScene(f"there is no integrator {method!r}; there are {', '.join(INTEGRATORS)}", self.name)
        asked = INTEGRATORS.index(method) if isinstance(method, str) else self.method if method is None else method
        step = {"integrationMethod": index(asked), "delta": float(delta)}
        count = index(self.frames if frames is None else frames)
        given = {**step, "optimizationIterations": count, "forwardSubSteps": self.newton_iterations}
        problems = structure.problems_of({**given, "objects": [{}]})
        own = [problem for problem in problems if not problem.startswith("objects")]  # the empty one's
        if own:
            raise InvalidScene(own, self.name)
        return replace(self, method=index(asked), delta=float(delta), frames=count)


    def changed(self, *others: Scene, spheres: Sequence[Sequence[float]] = (), **fields: Any) -> Scene:
        """Make a new scene that also has the cloths and the obstacles of others, and more `spheres` (x, y, z, radius),
        m, and in which these `fields` are others: `title`, `integrator`, `delta`, `tolerance`, `frames`,
        `newton_iterations`, `wind`, `gravity`, or one of the file by its name there, such as `selfCollision`.

        Raises InvalidScene when one of them is impossible.
        """
        if fields.get("integrator") in INTEGRATORS:
            fields["integrator"] = INTEGRATORS.index(fields["integrator"])
        document = _document(self)
        for each in map(_document, others):
            for name in ("objects", "colliders"):
                document[name] = [*document.get(name, ()), *each.get(name, ())]
        document["colliders"] = [*document.get("colliders", ()), *map(_sphere, spheres)]
        for name, value in fields.items():
            if (own := IN_FILE.get(name, name)) not in structure.fields("scene"):
                raise InvalidScene(f"there is no field {name!r}", self.name)
            if (vector := name in ("wind", "gravity")) and np.shape(value) != (3,):
                raise InvalidScene(f"{name}: three numbers are needed", self.name)
            document[own] = vectors(np.array([value], float))[0] if vector else value
        return replace(load(document, folder=self.folder), name=self.name)


IN_FILE = {
    "integrator": "integrationMethod", "frames": "optimizationIterations", "newton_iterations": "forwardSubSteps",
    "wind": KIND["wind"].field, "gravity": KIND["gravity"].field,
}  # fmt: skip
"""Fields of a scene, to their names in a file where those differ."""


def _document(scene: Scene) -> dict[str, Any]:
    """The fields of its file."""
    found: dict[str, Any] = json.loads(dumps(scene))
    return found




def check_is_scene(scene: object) -> None:
    """Raise InvalidInput, with how to load it, where a path is given for a scene."""
    if isinstance(scene, (str, os.PathLike)):
        path = os.fspath(scene)
        raise InvalidInput(f"scene: a path is given, {path!r}; load it: clothfit.load({path!r})")


def load(path_or_file: Readable, *, folder: str | None = None) -> Scene:
    """Load a scene from a path, an open text or binary file, or a dict with the fields of the file.

    Paths in it are relative to `folder`, by default that of its file, or else the current one. Raises InvalidScene when
    it cannot be read or breaks the format, and no other error.
    """
    name = name_of(path_or_file)
    source = read_text(path_or_file)
    given, constants = parse(source, name)
    problems = structure.problems_of(given)
    if problems:
        raise InvalidScene(problems, name)
    document = {**structure.defaults("scene"), **given}
    auto = document["fit"] == AUTO
    if auto:
        document["fit"] = {}
    if folder is None:
        folder = os.path.dirname(os.fspath(path_or_file)) if isinstance(path_or_file, (str, os.PathLike)) else ""
    cloths = tuple(_cloth(item, f"objects[{i}]", folder, problems) for i, item in enumerate(document["objects"]))
    inputs = _inputs(document, folder, problems)
    touched = obstacles(document, folder, problems)
    _check_touched(document, *touched, problems)
    _check_layers(document, cloths, problems)
    if constants and not problems:  # one in a field that is not ours
        problems.append(constant_problem(source))
    asked = from_file(document["fit"].get("bounds", {}), KINDS, "fit.bounds", problems)
    if problems:
        raise InvalidScene(problems, name)
    made = _scene(document, tuple(cloth for cloth in cloths if cloth), inputs, touched, asked, name, source)
    return replace(made, folder=os.path.abspath(folder), auto=auto)


def save(scene: Scene, path_or_file: str | os.PathLike[str] | IO[str] | IO[bytes]) -> None:
    """Save a scene to a path, whole or not at all, or to an open text or binary file.

    Only numbers that have changed differ from the text that was loaded; in another folder, paths of files lead to where
    they led before. Raises InvalidInput when the path cannot be written; errors of an open file pass through.
    """
    if isinstance(path_or_file, (str, os.PathLike)):
        write_atomically(path_or_file, dumps(scene, folder_of(path_or_file)))
        return
    data = dumps(scene)
    file: IO[Any] = path_or_file
    try:
        file.write(data)
    except TypeError:  # a text file; its encoding is its own business
        file.write(data.removeprefix(scene.source.mark).decode(scene.source.encoding))


def folder_of(path: str | os.PathLike[str]) -> str:
    """The folder of a file."""
    return os.path.dirname(os.path.abspath(os.fspath(path)))


def dumps(scene: Scene, folder: str | None = None) -> bytes:
    """Give the text of a scene: the one it came from, but for the values that differ, and for paths where it goes to
    another `folder`.
    """
    objects: list[dict[str, Any]] = []
    for cloth in scene.cloths:
        values = {kind.field: _plain(cloth, kind) for kind in CLOTH_KINDS if kind.name != "path"}
        values["dragLaw"] = Optional(cloth.drag_law, cloth.drag_law != EDITORS)
        if own := {i: pin.own.values for i, pin in enumerate(cloth.pins) if pin.own}:
            values["pins"] = {i: {"posKeys": {"values": vectors(each)}} for i, each in own.items()}
        objects.append(values)
    keyed = ("gusts", "friction", "contact")
    whole: dict[str, Any] = {kind.field: _plain(scene, kind) for kind in SCENE_KINDS if kind.name not in keyed}
    if scene.gusts.size:
        whole[KIND["gusts"].field] = {"values": vectors(scene.gusts)}
    if scene.colliders:
        whole["colliders"] = {each.place: _law(each, "collider") for each in scene.colliders}
    if scene.self_contact:
        whole["selfCollision"] = _law(scene.self_contact, "selfCollision")
    kept = structure.defaults("scene")["optimizationIterations"]
    whole |= {"integrationMethod": scene.method, "delta": scene.delta}
    whole["optimizationIterations"] = Optional(scene.frames, scene.frames != kept)
    if folder is not None and os.path.realpath(folder) != os.path.realpath(scene.folder):
        files = files_from(json.loads(scene.source.text), scene.folder, folder)
        for i, each in files.pop("objects", {}).items():
            objects[i] = _together(objects[i], each)
        whole = _together(whole, files)
    return scene.source.encode(splice(scene.source.text, objects, whole))


def with_pins(scene: Scene, items: Mapping[int, list[dict[str, Any]]]) -> Scene:
    """Make a new scene with more pins, as its file has them, of objects by their numbers. Raises InvalidScene."""
    before, problems = json.loads(scene.source.text)["objects"], list[str]()
    new = [{"pins": Appended(items[i])} if i in items else {} for i in range(len(before))]
    cloths = list(scene.cloths)
    for i, added in items.items():
        cloth, place = cloths[i], f"objects[{i}]"
        every = pins([*before[i].get("pins", ()), *added], cloth.fixed, place, scene.folder, problems)
        cloths[i] = replace(cloth, pins=(*cloth.pins, *every[len(cloth.pins) :]))
    if problems:
        raise InvalidScene(problems, scene.name)
    source = replace(scene.source, text=splice(scene.source.text, new))
    return replace(scene, cloths=tuple(cloths), source=source)


def with_places(scene: Scene, x: Array) -> Scene:
    """Make a new scene whose vertices begin at rest at places x (N, 3), its springs as long at rest and of the same
    families as before.
    """
    new, cloths = list[dict[str, Any]](), list[Cloth]()
    for cloth, own in zip(scene.cloths, np.split(x, np.cumsum(scene.vertex_counts)[:-1]), strict=True):
        layout = with_families(cloth.positions, cloth.triangles, cloth.springs, cloth.layout)
        new.append({"vertPos": vectors(own), "springRestLength": Optional(cloth.rest.tolist(), needed=True)})
        if cloth.layout.family is None:
            families = {"names": list(layout.names), "springs": np.asarray(layout.family).tolist()}
            new[-1]["families"] = Optional(families, needed=True)
        cloths.append(replace(cloth, positions=own, layout=layout))
    return replace(scene, cloths=tuple(cloths), source=replace(scene.source, text=splice(scene.source.text, new)))


def _together(values: Mapping[Any, Any], others: Mapping[Any, Any]) -> dict[Any, Any]:
    """Two nests of values as one."""
    made = dict(values)
    for name, value in others.items():
        made[name] = _together(made[name], value) if isinstance(made.get(name), dict) else value
    return made


def vectors(values: Array) -> list[dict[str, float]]:
    """Vectors (K, 3) as JSON holds them."""
    return [dict(zip("xyz", row, strict=True)) for row in values.tolist()]


def _checked(owner: Cloth | Scene, values: Mapping[str, Any], place: str, problems: list[str]) -> dict[str, Any]:
    """Turn given values of kinds, by name, into what their owner has; what is wrong goes to `problems`."""
    made: dict[str, Any] = {}
    for name, given in values.items():
        kind, old = owner.kind(name) if isinstance(owner, Cloth) else KIND[name], getattr(owner, name)
        value = checks.new_values(given, np.shape(old), f"{place}{kind.field}", problems)
        checks.check_range(value if value is None else value.reshape(-1), kind, f"{place}{kind.field}", problems)
        made[name] = float(value) if isinstance(old, float) and value is not None else value
    return made


def _plain(owner: Cloth | Scene, kind: Kind) -> Any:
    """A kind's value as JSON holds it; optional where the file may do without, needed where it is not the default."""
    value = np.asarray(getattr(owner, kind.name))
    plain: Any = value.tolist()
    if kind.components == 3:
        rows = vectors(value.reshape(-1, 3))
        plain = rows if value.ndim == 2 else rows[0]
    if kind.name in LETTERED:
        return plain
    return Optional(plain, not np.array_equal(value, owner.default(kind)))


def _law(owner: Collider | SelfContact, part: str) -> dict[str, Any]:
    """What a fit may change in a collider of the file, or in what it says of self-contact."""
    kept = structure.defaults(part)
    values = {name: getattr(owner, name) for name in ("friction", "stiffness")}
    return {name: Optional(value, value != kept[name]) for name, value in values.items()}


def _inputs(document: dict[str, Any], folder: str, problems: list[str]) -> dict[str, Any]:
    """The fields of a scene for the wind, the gravity and the axes over time."""
    if document["fit"].get("windVelKeys") not in NOT_FITTED:
        if "windVelKeys" not in document:
            problems.append("fit.windVelKeys: there are no windVelKeys to fit")
        elif "file" in document["windVelKeys"]:
            problems.append("fit.windVelKeys: keys of a file cannot be fitted; write times and values into the scene")
    fields = {"wind_keys": "windVelKeys", "gravity_keys": "gravityKeys"}
    found = {own: keys(document.get(name), name, folder, problems) for own, name in fields.items()}
    return {**found, "frame": frame(document.get("frame"), folder, problems)}


def _check_touched(
    document: Mapping[str, Any], spheres: Sequence[Sphere], colliders: Sequence[Collider], problems: list[str]
) -> None:
    """Note where a fit of friction, contact or an offset is asked for, and nothing has them."""
    asked = [name for name in ("friction", "contact", "colliderOffset") if document["fit"].get(name) not in NOT_FITTED]
    plain = f" but planes; {WAY_OUT}" if document["colliders"] else ""
    plain = " but plain spheres; one with friction, thickness or stiffness has both" if spheres else plain
    own = document.get("selfCollision") is not None
    without = [name for name in asked if not colliders and not (spheres if name == "colliderOffset" else own)]
    problems += [f"fit.{name}: there are no colliders{plain}" for name in without]
    if "colliderOffset" in asked and "rotKeys" in document.get("frame", {}):
        problems.append("fit.colliderOffset: an offset can be fitted where the axes do not turn (frame.rotKeys)")


def _check_layers(document: Mapping[str, Any], cloths: Sequence[Cloth | None], problems: list[str]) -> None:
    """Note what objects that touch each other cannot have."""
    asked = self_contact(document)
    if asked is None or not asked.between or not all(cloths) or len(cloths) < 2:
        return
    own = [cloth for cloth in cloths if cloth]
    if len({cloth.drag_law for cloth in own}) > 1:
        problems.append("selfCollision.betweenObjects: the objects need one dragLaw")
    for i, cloth in enumerate(own):
        if cloth.shift.any() or cloth.mode("shift") != "n":
            problems.append(
                f"objects[{i}].pinOffset: objects that touch each other cannot have one; move posKeys instead"
            )


def _scene(
    document: dict[str, Any], cloths: tuple[Cloth, ...], inputs: dict[str, Any],
    touched: tuple[tuple[Sphere, ...], tuple[Collider, ...]], asked: Bounds, name: str, source: Source,
) -> Scene:  # fmt: skip
    solid = document["planes"] == "solid"
    planes = [i for i, item in enumerate(document["colliders"]) if item["type"] == PLANE and not solid]
    more = f" (and {len(planes) - 1} more)" if len(planes) > 1 else ""
    grown = [i for i, each in enumerate(document["colliders"]) if each["type"] == PLANE and "scaleKeys" in each]
    return Scene(
        title=document["title"].encode(errors="replace").decode(),  # "\ud800" in JSON is a text nobody can print
        method=document["integrationMethod"],
        delta=float(document["delta"]),
        tolerance=float(document["tolerance"]),
        frames=document["optimizationIterations"],
        newton_iterations=document["forwardSubSteps"],
        wind=_vector(document["windVel"]),
        gravity=_vector(document["gravity"]),
        fits=_fits(document["fit"], SCENE_KINDS),
        bounds=asked,
        cloths=cloths,
        spheres=touched[0],
        colliders=touched[1],
        offset=_vector(document["colliderOffset"]),
        warnings=tuple(f"colliders[{i}]: planes are ignored, as in the editor{more}; {WAY_OUT}" for i in planes[:1])
        + tuple(f"colliders[{i}].scaleKeys: a plane has no size, so they change nothing" for i in grown),
        name=name,
        source=source,
        **inputs,
        self_contact=self_contact(document),
    )


def owner(vertex: int, counts: Sequence[int]) -> tuple[int, int]:
    """The object of a vertex that is numbered through objects of these counts of vertices, and its number there."""
    ends = np.cumsum(counts)
    cloth = int(np.searchsorted(ends, vertex, side="right"))
    return cloth, vertex - int(ends[cloth]) + counts[cloth]


def _cloth(item: dict[str, Any], place: str, folder: str, problems: list[str]) -> Cloth | None:
    item = {**structure.defaults("object"), **item}
    arrays, layout = checks.arrays(item, place, problems), layout_of(item, place, problems)
    asked = from_file(item["fit"].get("bounds", {}), CLOTH_KINDS, f"{place}.fit.bounds", problems)
    if arrays is None:
        return None
    pinned = pins(item.get("pins", ()), arrays["fixed"], place, folder, problems)
    _check_pins(item, pinned, place, problems)
    return Cloth(
        **arrays,
        drag=float(item["dragCoefficient"]),
        drag_law=item["dragLaw"],
        damping=float(item["damping"]),
        settings="".join(LETTERS[letter.lower()] for letter in item["optimizationSettings"]),
        fits=_fits(item["fit"], CLOTH_KINDS),
        layout=layout,
        bounds=asked,
        pins=pinned,
        shift=_vector(item["pinOffset"]),
    )


def _check_pins(item: Mapping[str, Any], pinned: Sequence[Pin], place: str, problems: list[str]) -> None:
    """Note where a fit of paths, or an offset, is asked for, and no pin has it."""
    asked = [name for name in ("posKeys", "pinOffset") if item["fit"].get(name) not in NOT_FITTED]
    if not item.get("pins"):
        problems += [f"{place}.fit.{name}: the object has no pins" for name in asked]
    elif "posKeys" in asked and not any(pin.own for pin in pinned):
        said = "no pin has posKeys with times and values in the scene; those of a file cannot be fitted"
        problems.append(f"{place}.fit.posKeys: {said}")


def _fits(asked: dict[str, Any], kinds: Sequence[Kind]) -> dict[str, str]:
    """The modes, by names of kinds, of what a `fit` asks for."""
    letters = {kind.name: asked[kind.field] for kind in kinds if kind.field in asked}
    modes = {name: LETTERS[letter.lower() if isinstance(letter, str) else letter] for name, letter in letters.items()}
    return {name: mode for name, mode in modes.items() if mode != "n"}
