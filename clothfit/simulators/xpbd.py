"""A cloth of a scene as XPBD has it, the method of Obi, Vellum and many engines of games.

Every spring is a constraint of compliance 1/k. Its damping (α/2) k is, times the compliance, the time α/2. Bending
springs stay distances across an edge, or become angles between the faces there: with the length L of a spring, its
torque in the third order of the angle, k L² θ³/32, is that of the compliance 32/(k L² FOLD²) at the angle FOLD. As
compliances are 1/k, what differs from the springs' motion is the length of substeps and what the iterations leave;
with many of both it is the springs' (`tests/simulators/test_xpbd.py`).

Its few values are a factor on the compliances of each family, damping, relaxation, and the air; with them there may be
those of each constraint and vertex. Values are those of rows of a field of the model, such as the compliances of all
bending springs, or of one of them.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np

from clothfit.base.arrays import Array, Flags, Indices
from clothfit.base.errors import InvalidInput
from clothfit.engine.forces.spheres import STIFFNESS
from clothfit.engine.inputs.tables import Inputs
from clothfit.engine.system import System, build
from clothfit.export.blender import FOLD
from clothfit.export.topology import roles
from clothfit.scene.cloth import Cloth
from clothfit.scene.families import FAMILIES, families_of
from clothfit.scene.kinds import DRAG_IN_AIR, KIND
from clothfit.scene.scene import Scene
from clothfit.simulators.directions import Seeds, Sweep, no_seeds, simulate
from clothfit.simulators.substep import Model
from clothfit.simulators.values import RANGE, Tool, Value

DISTANCE, ANGLE = "distance", "angle"
BENDING = (DISTANCE, ANGLE)
"""What a bending spring becomes."""

SOLVED = ("distance", "bending")
"""Kinds of constraints of which a solver has its own settings."""

STIFFEST, SOFTEST = 1e-12, 1e12
"""Compliances, m/N: a spring that is not, and one without stiffness."""


@dataclass(frozen=True)
class Settings:
    """How a solver is set."""

    substeps: int = 4  # of a step of the scene
    iterations: int = 5  # of a substep
    bending: str = DISTANCE

    def check(self) -> None:
        """Raise InvalidInput on what cannot be."""
        for name in ("substeps", "iterations"):
            if not 1 <= getattr(self, name) <= 10_000:
                raise InvalidInput(f"{name} must be within 1 … 10000; {getattr(self, name)} was given")
        if self.bending not in BENDING:
            raise InvalidInput(f"bending: there is no {self.bending!r}; use distance or angle")


def refuse(scene: Scene, tool: str) -> None:
    """Raise InvalidInput for what of a scene no model here has."""
    found = {
        "colliders other than plain spheres": scene.colliders,
        "self-contact": scene.self_contact,
        "applied forces": scene.forces,
        "moving axes": scene.frame,
    }
    for what, there in found.items():
        if there:
            raise InvalidInput(f"{scene.name}: the model of {tool} has no {what}")


def model_of(scene: Scene, index: int, settings: Settings, frames: int) -> Model:
    """Cloth `index` of a scene as XPBD has it, for motions of so many frames. Raises InvalidInput, InvalidScene."""
    settings.check()
    refuse(scene, "xpbd")
    system, cloth = build(scene, index, steps=frames - 1), scene.cloths[index]
    members, rest, compliance = constraints(cloth, settings.bending)
    # there is one object: its faces are of one type, whatever else the scene has
    faces = system.faces._replace(wind=system.faces.wind.copy(), object=None)
    pins, path = pins_of(system.inputs, frames)
    return Model(
        x0=system.x0.copy(), v0=system.v0.copy(), free=~cloth.fixed,
        inverse=np.where(cloth.fixed, 0.0, 1.0 / cloth.mass),
        members=members, rest=rest, compliance=compliance, time=np.full(len(rest), 0.5 * cloth.damping),
        relaxation=np.ones(len(rest)), damping=np.full(len(cloth.mass), cloth.damping),
        faces=faces, radius=system.spheres.radius, contact=1.0 / STIFFNESS,
        **world(system, frames), path=path, pins=pins,
        h=scene.delta, substeps=settings.substeps, iterations=settings.iterations,
    )  # fmt: skip


def constraints(cloth: Cloth, bending: str) -> tuple[Indices, Array, Array]:
    """Members (K, 4), rest (K,) and compliances (K,) of the constraints, in the order of the springs."""
    members = np.full((len(cloth.springs), 4), -1, np.int32)
    members[:, :2] = cloth.springs
    rest: Array = cloth.rest.copy()
    with np.errstate(divide="ignore"):
        compliance: Array = np.clip(1.0 / cloth.stiffness, STIFFEST, SOFTEST)
    if bending == ANGLE:
        role = roles(cloth)
        chosen = role.bending
        members[chosen, :2], members[chosen, 2:] = role.hinges[chosen], cloth.springs[chosen]
        rest[chosen] = 0.0
        rest[chosen] = angles(members[chosen], cloth.positions)
        compliance[chosen] *= 32.0 / (cloth.rest[chosen] * FOLD) ** 2
    return members, rest, compliance


def angles(members: Indices, x: Array) -> Array:
    """The angles of hinges (H, 4) at x (n, 3), rad, as `substep.angle` has them."""
    origin = x[members[:, 0]]
    e, a, b = (x[members[:, k]] - origin for k in (1, 2, 3))
    p, q = np.cross(e, a), np.cross(b, e)
    with np.errstate(all="ignore"):
        along = np.nan_to_num((np.cross(p, q) * e).sum(axis=1) / np.linalg.norm(e, axis=1))
    found: Array = np.arctan2(along, (p * q).sum(axis=1))
    return found


def world(system: System, frames: int) -> dict[str, Array]:
    """Wind, gravity and spheres at the times of the frames."""
    inputs, still = system.inputs, system.spheres.centre
    bases = (inputs.wind_base, inputs.gravity_base) if inputs else (system.faces.wind, system.vertex.gravity)
    wind, gravity, centre = (np.broadcast_to(each, (frames, *each.shape)).copy() for each in (*bases, still))
    if inputs:
        for own, table in ((wind, inputs.wind), (gravity, inputs.gravity)):
            if len(table):
                own += table[:frames]
        if len(inputs.centre):
            centre = inputs.centre[:frames, : len(still)].copy()
    return {"wind": wind, "gravity": gravity, "centre": centre}


def pins_of(inputs: Inputs | None, frames: int) -> tuple[Indices, Array]:
    """The pins (P,) and their places (frames, P, 3)."""
    if inputs is None or not len(inputs.path):
        return np.zeros(0, np.int32), np.zeros((frames, 0, 3))
    return inputs.pins, inputs.path[:frames].copy()


GROUPS = ("stretch", "shear", "bending")
LEAST_TIME, LEAST_DAMPING = 1e-4, 1e-3
SPREAD = np.log(4.0)
"""Where the mapping has no damping: s along constraints, 1/s of the vertices; and how far a rest length may go, in its
logarithm.
"""

RELAXED = np.log(1.95)
"""How far a relaxation may go from 1, in its logarithm: solvers diverge from 2 on."""

SHARE = 0.15
"""Of a substep: the least damping that a fit of each constraint starts with, s; a smaller one would not be felt."""


class Part(NamedTuple):
    """Values of one field of the model."""

    values: list[Value]
    field: str  # of the model; "drag": of its faces
    owner: Indices  # of each row of the field, the value that it has; −1: none
    kind: str = "same"  # a row is the value, its "inverse", or "times" what it is in the mapping


class Parts:
    """All values of a tool, in the order of the parts."""

    def __init__(self, model: Model, parts: list[Part]) -> None:
        self.model, self.parts = model, parts
        self.values = tuple(value for part in parts for value in part.values)
        self.ends = np.cumsum([len(part.values) for part in parts])
        seeds = no_seeds(model)
        for part, end in zip(parts, self.ends, strict=True):
            lane = np.where(part.owner < 0, -1, end - len(part.values) + part.owner).astype(np.int32)
            name = "mass" if part.field == "inverse" else part.field
            seeds = seeds._replace(**{name: lane})
        self.seeds: Seeds = seeds

    def at(self, numbers: Array) -> Model:
        """The model with some values."""
        made = self.model
        for part, own in zip(self.parts, np.split(numbers, self.ends[:-1]), strict=True):
            rows, chosen = field(made, part.field).copy(), part.owner >= 0
            found = own[part.owner[chosen]]
            found = 1 / found if part.kind == "inverse" else found
            rows[chosen] = rows[chosen] * found if part.kind == "times" else found
            made = with_rows(made, part.field, rows)
        return made

    def numbers(self, made: Model) -> Array:
        """The values (V,) of a model whose rows are none times the mapped ones."""
        found = []
        for part in self.parts:
            own, chosen = np.empty(len(part.values)), part.owner >= 0
            own[part.owner[chosen]] = field(made, part.field)[chosen] ** (-1.0 if part.kind == "inverse" else 1.0)
            found.append(own)
        return np.concatenate(found)

    def tool(self, frames: int) -> Tool:
        """The tool that has these values."""

        def sweep(numbers: Array, along: bool) -> Sweep:
            made = self.at(numbers)
            return Sweep(made, self.seeds, len(self.values)) if along else Sweep(made, no_seeds(made), 0)

        def motion(numbers: Array) -> Array | None:
            positions, good = simulate(self.at(numbers), frames)
            return positions if good == frames else None

        def columns(numbers: Array) -> Array:
            own, found = sweep(numbers, True), np.zeros((len(self.values), frames, *self.model.x0.shape))
            for t in range(frames - 1):
                own.advance(t)
                found[:, t + 1] = np.moveaxis(own.dx, 2, 0)
            return found

        return Tool("xpbd", self.values, motion, columns, sweep=sweep)


def field(model: Model, name: str) -> Array:
    """The rows of a field."""
    rows: Array = model.faces.drag if name == "drag" else getattr(model, name)
    return rows


def with_rows(model: Model, name: str, rows: Array) -> Model:
    """A model with other rows of a field."""
    if name == "drag":
        return model._replace(faces=model.faces._replace(drag=np.array(rows[:1], float)))
    change: dict[str, Any] = {name: rows}
    return model._replace(**change)


def groups_of(scene: Scene, index: int) -> Array:
    """The group of each constraint, an index into GROUPS."""
    own = scene.cloths[index]
    names = np.array([0 if not f.startswith(("edges diag", "bending")) else 1 if f.startswith("edges") else 2
                      for f in FAMILIES])
    return names[families_of(own.positions, own.triangles, own.springs)]


def tool_of(scene: Scene, index: int, settings: Settings, frames: int) -> Tool:
    """XPBD for one cloth."""
    model = model_of(scene, index, settings, frames)
    return few_of(model, groups_of(scene, index)).tool(frames)


def few_of(model: Model, group: Array) -> Parts:
    """The few values of a model with such groups."""
    time, damping = float(model.time[0]) if len(model.time) else 0.0, float(model.damping[0])
    there = np.unique(group)
    owner, air = (own.astype(np.int32) for own in (np.searchsorted(there, group), np.where(model.free, 0, -1)))
    names = [GROUPS[g] for g in there]
    return Parts(model, [
        Part([Value(f"{name} compliance", "times the mapped one", 1.0, 1.0) for name in names], "compliance", owner,
             "times"),
        Part([Value(f"{name} damping", "s", max(time, LEAST_TIME), time) for name in names], "time", owner),
        relaxations(group),
        Part([Value("air damping", "1/s", max(damping, LEAST_DAMPING), damping)], "damping", air),
        *drag(model),
    ])  # fmt: skip


def relaxations(group: Array) -> Part:
    """That of each kind of constraints."""
    there, owner = np.unique(group == GROUPS.index("bending"), return_inverse=True)
    values = [Value(f"{SOLVED[int(bends)]} relaxation", "", 1.0, 1.0, RELAXED) for bends in there]
    return Part(values, "relaxation", owner.astype(np.int32))


def drag(model: Model) -> list[Part]:
    """That of the air, where the scene has some."""
    own, kind = float(model.faces.drag[0]), DRAG_IN_AIR if model.faces.quadratic else KIND["drag"]
    return [Part([Value("air drag", kind.unit, own, own)], "drag", np.zeros(1, np.int32))] if own > 0 else []


def each_of(scene: Scene, index: int, settings: Settings, frames: int) -> Parts:
    """XPBD with a compliance and a damping of each constraint, a rest length of each distance, a mass and an air
    damping of each free vertex, and the relaxations and the drag of the few values, which start at the mapped ones.
    """
    mapped = model_of(scene, index, settings, frames)
    felt = np.maximum(mapped.time, SHARE * mapped.h / mapped.substeps)
    every = np.ones(len(mapped.rest), bool)
    long = (mapped.members[:, 2] < 0) & (mapped.rest > 0)
    return Parts(mapped, [
        rows("compliance", "m/N", "compliance", every, mapped.compliance),
        rows("damping", "s", "time", every, mapped.time, felt),
        rows("rest length", "m", "rest", long, mapped.rest, spread=SPREAD),
        rows("mass", "kg", "inverse", mapped.free, mapped.inverse),
        rows("air damping", "1/s", "damping", mapped.free, mapped.damping, np.maximum(mapped.damping, LEAST_DAMPING)),
        relaxations(groups_of(scene, index)), *drag(mapped),
    ])  # fmt: skip


def as_few(each: Parts, group: Array, few: Array) -> Array:
    """The values of each constraint and vertex that are the `few` ones of constraints of such groups."""
    first = few_of(each.model, group).at(few)
    return each.numbers(first._replace(
        time=np.maximum(first.time, LEAST_TIME), damping=np.maximum(first.damping, LEAST_DAMPING)
    ))  # fmt: skip


def rows(
    name: str, unit: str, of: str, chosen: Flags, mapped: Array, start: Array | None = None, spread: float = RANGE
) -> Part:
    """A value of each row that is chosen."""
    number = np.where(chosen, np.cumsum(chosen) - 1, -1).astype(np.int32)
    turned = of == "inverse"
    own = [(1.0 / a, 1.0 / b) if turned else (a, b)
           for a, b in zip(mapped[chosen], (mapped if start is None else start)[chosen], strict=True)]
    return Part([Value(name, unit, float(b), float(a), spread) for a, b in own], of, number,
                "inverse" if turned else "same")
