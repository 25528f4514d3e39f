"""One object of a scene, how it is woven, and what it may touch: arrays in SI units that do not change.

How an object is woven and divided are optional fields of it:

    "families": {"names": ["yarn", "fold"], "springs": [0, 1, 1, ...]}     the family of each spring, from 0
    "regions": [{"name": "collar", "vertices": [0, 1, 2]}]                 parts; where they overlap the first counts
    "warp": {"x": 1, "y": 0, "z": 0}                                       the direction along the cloth at the start

No motion depends on them, only what a fit in mode R or M takes together. S springs, n vertices.
"""

from __future__ import annotations

import os
from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from math import hypot, sqrt
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt

from clothfit.base.arrays import Array, Flags, Indices
from clothfit.base.messages import counted, spelt
from clothfit.scene import array_checks as checks
from clothfit.scene import schema as structure
from clothfit.scene.bounds import Bounds
from clothfit.scene.keys import Keys, Pin, keys, scales
from clothfit.scene.kinds import AIR, AIR_DENSITY, DRAG_IN_AIR, EDITORS, KIND, LETTERED, PLATE, Kind

ELSEWHERE = "elsewhere"
"""The name of what lies in no region."""


class Region(NamedTuple):
    """A named part of a cloth."""

    name: str
    vertices: Indices  # rising


@dataclass(frozen=True, eq=False)
class Layout:
    """What a file says of one object; empty where it says nothing. The arrays are read-only."""

    names: tuple[str, ...] = ()  # of the families that it gives
    family: Indices | None = None  # (S,), the family of each spring
    regions: tuple[Region, ...] = ()
    warp: Array | None = None  # (3,), not 0


NOTHING = Layout()

SMALLEST_SQUARE = 1e-100
"""m⁴, of the area of a face that is none."""

PLANE, SPHERE, CAPSULE, BOX, MESH = 0, 1, 2, 3, 4
"""The `type` of a collider."""

AXIS_OF_SIZE = {PLANE: (0, 1, 2), SPHERE: (0, 0, 0), CAPSULE: (0, 0, 1), BOX: (0, 1, 2), MESH: (0, 1, 2)}
"""Along which axis of its own the scale of a collider changes each number of its size."""

NAMES = {PLANE: "plane", SPHERE: "sphere", CAPSULE: "capsule", BOX: "box", MESH: "mesh"}


@dataclass(frozen=True, eq=False)
class Cloth(checks.ReadOnly):
    """One object of a scene: n vertices, S springs, T triangles. The arrays are read-only."""

    positions: Array  # (n, 3) initial world positions, m
    fixed: Flags  # (n,) the vertex does not move
    mass: Array  # (n,) kg, above 0
    springs: Indices  # (S, 2) the vertices each spring joins
    stiffness: Array  # (S,) N/m, 0 or more
    triangles: Indices  # (T, 3) the corners of each face
    drag: float  # air drag of the faces, 0 or more, kg/(m^6 s); without unit in the law "air"
    damping: float  # α: damps a vertex by α m v (α in 1/s), a spring by (α/2) k along its axis (α in s)
    settings: str  # two letters, masses then stiffnesses: n keeps them, the others are those of `Kind.modes`
    velocity: Array  # (n, 3) at the start, m/s; those of fixed vertices do nothing
    rest: Array  # (S,) rest lengths, m, above 0
    fits: Mapping[str, str]  # what else to fit: "damping", "drag", "velocity", "rest" to one of their modes
    layout: Layout = NOTHING  # what the file says of families, regions and the warp
    bounds: Bounds = field(default_factory=dict)  # of a fit, by kind, before those of the scene
    pins: tuple[Pin, ...] = ()  # fixed vertices that move
    shift: Array = field(default_factory=lambda: np.zeros(3))  # (3,) m: of all pins, from where their paths have them
    drag_law: str = EDITORS  # one of `DRAG_LAWS`

    def __repr__(self) -> str:
        sizes = f"{len(self.mass)} vertices, {len(self.stiffness)} springs, {len(self.triangles)} triangles"
        return f"<Cloth: {sizes}, {self.mass.sum():.3g} kg>"

    @property
    def path(self) -> Array:
        """The values (K, 3), m, of the keys of all pins' positions, pin by pin; without those that files have."""
        return np.concatenate([np.zeros((0, 3)), *(pin.own.values for pin in self.pins if pin.own)])

    @property
    def key_pins(self) -> Indices:
        """The pin (K,) of each key of `path`."""
        counts = [len(pin.own.times) if pin.own else 0 for pin in self.pins]
        return np.repeat(np.arange(len(counts), dtype=np.int32), counts)

    @property
    def datums(self) -> Indices:
        """For each key of `path` the one (K,), of the same pin, whose value the start has: a constant on all keys of a
        pin changes no motion.
        """
        owner = self.key_pins
        found = [np.flatnonzero(owner == i)[0] + pin.own.datum for i, pin in enumerate(self.pins) if pin.own]
        return np.asarray(np.repeat(found, np.unique(owner, return_counts=True)[1]), np.int32)

    def with_kinds(self, path: Array | None = None, **values: Any) -> Cloth:
        """The same object with other values of some kinds, of which those that its pins have are `path` (K, 3)."""
        if path is None or not len(path):
            return replace(self, **values)
        ends = np.cumsum([len(pin.own.times) if pin.own else 0 for pin in self.pins])
        pins = tuple(
            replace(pin, position=replace(pin.own, values=part)) if pin.own else pin
            for pin, part in zip(self.pins, np.split(path, ends[:-1]), strict=True)
        )
        return replace(self, **values, pins=pins)

    def mode(self, name: str) -> str:
        """How a kind ("mass", "drag", …) is fitted: "n" not at all, or one of the modes of the kind."""
        return self.settings[LETTERED.index(name)] if name in LETTERED else self.fits.get(name, "n")

    def kind(self, name: str) -> Kind:
        """A kind as this object has it: the unit and the bounds of its drag are those of its law."""
        return DRAG_IN_AIR if name == "drag" and self.drag_law == AIR else KIND[name]

    @cached_property
    def lengths(self) -> Array:
        """Lengths (S,) of the springs at the initial positions, m, read-only."""
        lengths = checks.lengths(self.positions, self.springs)
        lengths.setflags(write=False)
        return lengths

    def default(self, kind: Kind) -> npt.ArrayLike:
        """The values of an optional kind where the file gives none."""
        return self.lengths if kind.name == "rest" else np.zeros_like(getattr(self, kind.name))

    @cached_property
    def air_drag(self) -> float:
        """The drag coefficient, kg/(m⁶ s), with which air of 1 m/s pushes a face as real air would, ϱ/(8 A²) with A the
        median area of the faces that have one; 0 without faces. In the law "air" that of a plate.
        """
        if self.drag_law == AIR:
            return PLATE
        area = self.areas
        square = float(np.median(area[area > 0])) ** 2 if (area > 0).any() else 0.0
        return AIR_DENSITY / (8.0 * square) if square > SMALLEST_SQUARE else 0.0

    @property
    def areas(self) -> Array:
        """Areas (T,) of the faces at the start, m²."""
        a, b, c = (self.positions[corner] for corner in self.triangles.T)
        return np.asarray(np.linalg.norm(np.cross(b - a, c - a), axis=1) / 2.0)

    @property
    def feels_air(self) -> bool:
        """Whether the air drags the cloth, or may do so in a fit."""
        return bool(len(self.triangles)) and (self.drag > 0 or self.mode("drag") != "n")


def wind_of(force: float, cloths: Sequence[Cloth], drags: Sequence[float]) -> float:
    """The wind, m/s, that pushes cloths with these drag coefficients by a force, N, where it meets all their faces at a
    right angle; 0 where none does.
    """
    linear = square = 0.0  # the force of a wind v is linear v + square v²
    for cloth, drag in zip(cloths, drags, strict=True):
        if cloth.drag_law == AIR:
            square += 0.5 * AIR_DENSITY * drag * float(cloth.areas.sum())
        else:
            linear += 4.0 * drag * float((cloth.areas**3).sum())
    push = linear + hypot(linear, 2.0 * sqrt(square * force))
    return 2.0 * force / push if push > 0 else 0.0


@dataclass(frozen=True, eq=False)
class Sphere(checks.ReadOnly):
    """A sphere that pushes cloths as the editor's does."""

    pos: Array  # (3,) m, read-only
    radius: float  # m, above 0
    position: Keys | None = None  # how far the centre moves over time, m
    offset: Array = field(default_factory=lambda: np.zeros(3))  # (3,) m, that of all colliders

    @property
    def centre(self) -> Array:
        """Where the centre is at the start, (3,) m, read-only."""
        return moved(self.pos, self.offset)


@dataclass(frozen=True, eq=False)
class Body(checks.ReadOnly):
    """A triangle mesh, in the scene or in a file, and the file of a motion of its vertices where it has one."""

    positions: Array  # (V, 3), in the collider's axes, before its scale; empty where a file has them
    triangles: Indices  # (T, 3), vertices; the same
    file: str | None  # a path
    said: Mapping[str, Any]  # scale, up, handedness of the file
    motion: Keys | None
    place: str  # in the scene, for messages


@dataclass(frozen=True, eq=False)
class Collider(checks.ReadOnly):
    """Any other obstacle: one that the editor does not have, or a sphere that rubs, is thick or has a stiffness."""

    kind: int  # PLANE, SPHERE, CAPSULE, BOX or MESH
    pos: Array  # (3,) m, read-only
    angles: Array  # (3,) degrees, read-only: Euler angles as the editor has them
    size: Array  # (3,) m, read-only: of a capsule, or a sphere, the radii at the bottom and at the top, and how far
    # their centres are apart; half of the lengths of a box; the factors of a mesh; 0 of a plane
    thickness: float  # m, 0 or more: how far from the surface it begins to push
    stiffness: float  # N/m, above 0: of each vertex
    friction: float  # coefficient, 0 or more
    position: Keys | None = None  # how far the centre moves over time, m
    rotation: Keys | None = None  # how it turns about the centre, degrees
    place: int = 0  # which of the colliders of the file it is
    offset: Array = field(default_factory=lambda: np.zeros(3))  # (3,) m, that of all colliders
    body: Body | None = None  # of a mesh
    scaling: Keys | None = None  # by what its size changes over time
    release: float = 0.0  # s, in which what begins inside leaves it

    @property
    def centre(self) -> Array:
        """Where the centre is at the start, (3,) m, read-only."""
        return moved(self.pos, self.offset)

    @property
    def name(self) -> str:
        """What it is."""
        return NAMES[self.kind]

    @property
    def moves(self) -> bool:
        """Whether it changes over time."""
        return bool(self.position or self.rotation or self.scaling or (self.body and self.body.motion))


def moved(pos: Array, offset: Array) -> Array:
    """The sum, read-only."""
    centre = np.asarray(pos + offset)
    centre.setflags(write=False)
    return centre


@dataclass(frozen=True)
class SelfContact:
    """How cloths push themselves apart."""

    thickness: float  # m, above 0: the distance below which two parts push each other
    stiffness: float  # N/m, above 0: of each pair
    friction: float  # coefficient, 0 or more
    release: float  # s, in which what crosses at the start goes back
    between: bool  # whether objects touch each other, too


def self_contact(document: Mapping[str, Any]) -> SelfContact | None:
    """What a document asks for; None where it does not."""
    own = document.get("selfCollision")
    if own is None:
        return None
    item = {**structure.defaults("selfCollision"), **own}
    thickness, stiffness, friction, release = (
        float(item[name]) for name in ("thickness", "stiffness", "friction", "release")
    )
    return SelfContact(thickness, stiffness, friction, release, item["betweenObjects"])


def together(cloths: Sequence[Cloth]) -> Cloth:
    """Several objects as one, vertices and springs of one after those of the other, with the damping and the drag of
    the first.
    """
    first = np.cumsum([0, *(len(each.mass) for each in cloths)], dtype=np.int32)  # as springs and triangles are
    joined: dict[str, Any] = {
        name: np.concatenate([getattr(each, name) for each in cloths])
        for name in ("positions", "fixed", "mass", "stiffness", "velocity", "rest")
    }
    joined |= {
        name: np.concatenate([getattr(each, name) + start for each, start in zip(cloths, first, strict=False)])
        for name in ("springs", "triangles")
    }
    pins = tuple(
        replace(pin, vertices=pin.vertices + start)
        for each, start in zip(cloths, first, strict=False)
        for pin in each.pins
    )
    modes = [{name: each.mode(name) for name in ("drag", "path")} for each in cloths]
    asked = {name: [own[name] for own in modes if own[name] != "n"] for name in ("drag", "path")}
    fits = {name: own[0] for name, own in asked.items() if own}
    return replace(cloths[0], **joined, pins=pins, fits=fits, layout=NOTHING, settings="nn")


def vector(item: Mapping[str, Any]) -> Array:
    """The array (3,) of a vector in the file."""
    return np.array([item["x"], item["y"], item["z"]], dtype=np.float64)


def vector_document(xyz: Iterable[float]) -> dict[str, float]:
    """A vector as a file has it."""
    x, y, z = map(float, xyz)
    return {"x": x, "y": y, "z": z}


def sphere_document(sphere: Sequence[float]) -> dict[str, Any]:
    """The collider of a sphere (x, y, z, radius), m, as a file has it."""
    *centre, radius = sphere
    place, turn, size = map(vector_document, (centre, (0, 0, 0), (2 * radius,) * 3))
    return {"type": SPHERE, "pos": place, "rot": turn, "scale": size}


def obstacles(
    document: Mapping[str, Any], folder: str, problems: list[str]
) -> tuple[tuple[Sphere, ...], tuple[Collider, ...]]:
    """The spheres and the other colliders of a document, without planes that are ignored; faults go to `problems`."""
    offset = vector(document["colliderOffset"])
    found = [_obstacle(own, i, offset, folder, problems) for i, own in enumerate(document["colliders"])]
    solid = document["planes"] == "solid"
    others = [each for each in found if isinstance(each, Collider) and (solid or each.kind != PLANE)]
    return tuple(each for each in found if isinstance(each, Sphere)), tuple(others)


def _obstacle(
    own: Mapping[str, Any], number: int, offset: Array, folder: str, problems: list[str]
) -> Sphere | Collider:
    item, place = {**structure.defaults("collider"), **own}, f"colliders[{number}]"
    position = keys(item.get("posKeys"), f"{place}.posKeys", folder, problems)
    rotation = keys(item.get("rotKeys"), f"{place}.rotKeys", folder, problems)
    scaling = scales(item.get("scaleKeys"), f"{place}.scaleKeys", folder, problems)
    if item["type"] == SPHERE and not {"friction", "thickness", "stiffness", "scaleKeys", "release"} & own.keys():
        return Sphere(vector(item["pos"]), float(item["scale"]["x"]) / 2, position, offset)
    body = _body(item, place, folder, problems)
    if scaling and body and body.motion:
        problems.append(f"{place}.scaleKeys: a mesh with a motion has its size from that")
    thickness, stiffness, friction = (float(item[name]) for name in ("thickness", "stiffness", "friction"))
    return Collider(
        item["type"], vector(item["pos"]), vector(item["rot"]), size(item, place, problems), thickness, stiffness,
        friction, position, rotation, number, offset, body, None if item["type"] == PLANE else scaling,
        float(item["release"]),
    )  # fmt: skip


def _body(item: Mapping[str, Any], place: str, folder: str, problems: list[str]) -> Body | None:
    """The mesh of a collider of that type; None for another, or where there is none, which goes to `problems`."""
    if item["type"] != MESH:
        return None
    here, given = f"{place}.mesh", item.get("mesh", {})
    own: Mapping[str, Any] = {"file": given} if isinstance(given, str) else given
    if ("file" in own) == ("vertices" in own or "triangles" in own):
        problems.append(f"{here}: needs a file, or vertices and triangles")
        return None
    motion = keys(item.get("motion"), f"{place}.motion", folder, problems)
    if motion and (motion.file is None or motion.points):
        problems.append(f"{place}.motion: needs the file of a motion of all vertices of the mesh")
    said = {name: own[name] for name in ("scale", "up", "handedness") if name in own}
    file = os.path.join(folder, own["file"]) if "file" in own else None
    positions = np.array([vector(each) for each in own.get("vertices", [])], np.float64).reshape(-1, 3)
    corners = np.array(own.get("triangles", []), np.int32)
    if len(corners) % 3:
        problems.append(f"{here}.triangles: has {len(corners)} items; three corners of each triangle are needed")
        return None
    return Body(positions, corners.reshape(-1, 3), file, said, motion, here)


def size(item: Mapping[str, Any], place: str, problems: list[str]) -> Array:
    """The size (3,) of a collider, as above, m; a scale that is not above 0 where it counts goes to `problems`."""
    scale = vector(item["scale"])
    round_one = "" if "radius" in item else "x"
    needed = {PLANE: "", SPHERE: "x", CAPSULE: round_one, BOX: "xyz", MESH: "xyz"}[item["type"]]
    flat = [axis for axis in needed if not item["scale"][axis] > 0]
    problems += [f"{place}.scale.{axis}: {item['scale'][axis]:g} is too small; it must be above 0" for axis in flat]
    if item["type"] in (BOX, MESH):
        return scale / 2 if item["type"] == BOX else scale
    if item["type"] == CAPSULE:
        radius = float(item.get("radius", scale[0] / 2))
        other = float(item.get("radius2", radius))
        return np.array([radius, other, float(item.get("height", max(2 * scale[1] - radius - other, 0.0)))])
    return np.array([scale[0] / 2, scale[0] / 2, 0.0]) if item["type"] == SPHERE else np.zeros(3)


def layout_of(fields: dict[str, Any], place: str, problems: list[str]) -> Layout:
    """The layout of an object whose structure has been checked; what is wrong goes to `problems`."""
    n, springs = len(fields["vertPos"]), len(fields["springs"]) // 2
    names: tuple[str, ...] = ()
    family = warp = None
    if "families" in fields:
        names = tuple(fields["families"]["names"])
        family = _family(fields["families"], springs, f"{place}.families", problems)
    regions = _regions(fields.get("regions", []), n, f"{place}.regions", problems)
    if "warp" in fields:
        warp = np.array([fields["warp"][axis] for axis in "xyz"], float)
        if not warp.any():
            problems.append(f"{place}.warp: has no length, so no direction")
    for array in (family, warp, *(region.vertices for region in regions)):
        if array is not None:
            array.setflags(write=False)
    same = not names and not regions and warp is None
    return NOTHING if same else Layout(names, family, regions, warp)


def _family(given: dict[str, Any], springs: int, place: str, problems: list[str]) -> Indices | None:
    """The family (S,) of each spring."""
    names, values = given["names"], given["springs"]
    _check_names(names, [f"{place}.names[{i}]" for i in range(len(names))], problems)
    if len(values) != springs:
        has, owners = counted(len(values), "value", "values"), counted(springs, "spring", "springs")
        problems.append(f"{place}.springs: {has} for {owners}; one each is needed")
    there = f"there are {counted(len(names), 'name', 'names')}"
    return checks.indices(values, len(names), "family", there, f"{place}.springs", problems)


def _regions(given: list[Any], n: int, place: str, problems: list[str]) -> tuple[Region, ...]:
    """The regions."""
    _check_names([each["name"] for each in given], [f"{place}[{i}].name" for i in range(len(given))], problems)
    found = []
    for i, each in enumerate(given):
        at = f"{place}[{i}].name"
        if each["name"] == ELSEWHERE:
            problems.append(f"{at}: {spelt(ELSEWHERE)} is what lies in no region; give it another name")
        vertices = checks.vertices(each["vertices"], n, 1, f"{place}[{i}].vertices", problems)
        if vertices is not None:
            found.append(Region(each["name"], np.unique(vertices)))
    return tuple(found)


def _check_names(names: list[str], places: list[str], problems: list[str]) -> None:
    """Check that names are not empty and differ."""
    uses = Counter(names)
    for i, name in enumerate(names):
        if not name.strip():
            problems.append(f"{places[i]}: is empty; give it a name")
        elif uses[name] > 1 and name in names[:i]:
            problems.append(f"{places[i]}: {spelt(name)} is there already; names must differ")
