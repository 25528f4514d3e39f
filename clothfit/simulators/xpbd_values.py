"""The few values of XPBD: a factor on the compliances of each family, damping, relaxation, and the air; or with them
those of each constraint and vertex.

Values are those of rows of a field of the model, such as the compliances of all bending springs, or of one of them.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

from clothfit.base.arrays import Array, Flags, Indices
from clothfit.scene.families import FAMILIES, families_of
from clothfit.scene.scene import Scene
from clothfit.simulators import xpbd
from clothfit.simulators.directions import Seeds, Sweep, no_seeds, simulate
from clothfit.simulators.substep import Model
from clothfit.simulators.values import RANGE, Tool, Value

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
    rows: Array = np.array([model.faces.drag]) if name == "drag" else getattr(model, name)
    return rows


def with_rows(model: Model, name: str, rows: Array) -> Model:
    """A model with other rows of a field."""
    if name == "drag":
        return model._replace(faces=model.faces._replace(drag=float(rows[0])))
    change: dict[str, Any] = {name: rows}
    return model._replace(**change)


def groups_of(scene: Scene, index: int) -> Array:
    """The group of each constraint, an index into GROUPS."""
    own = scene.cloths[index]
    names = np.array([0 if not f.startswith(("edges diag", "bending")) else 1 if f.startswith("edges") else 2
                      for f in FAMILIES])
    return names[families_of(own.positions, own.triangles, own.springs)]


def tool_of(scene: Scene, index: int, settings: xpbd.Settings, frames: int) -> Tool:
    """XPBD for one cloth."""
    model = xpbd.model_of(scene, index, settings, frames)
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
    values = [Value(f"{xpbd.SOLVED[int(bends)]} relaxation", "", 1.0, 1.0, RELAXED) for bends in there]
    return Part(values, "relaxation", owner.astype(np.int32))


def drag(model: Model) -> list[Part]:
    """That of the air, where the scene has some."""
    own = float(model.faces.drag)
    return [Part([Value("air drag", "kg/(m^6 s)", own, own)], "drag", np.zeros(1, np.int32))] if own > 0 else []


def each_of(scene: Scene, index: int, settings: xpbd.Settings, frames: int) -> Parts:
    """XPBD with a compliance and a damping of each constraint, a rest length of each distance, a mass and an air
    damping of each free vertex, and the relaxations and the drag of the few values, which start at the mapped ones.
    """
    mapped = xpbd.model_of(scene, index, settings, frames)
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
