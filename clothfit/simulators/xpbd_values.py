"""The few values of XPBD: a factor on the compliances of each family, damping, and the air; or those of each constraint
and vertex.
"""

from __future__ import annotations

import numpy as np

from clothfit.base.arrays import Array, Indices
from clothfit.scene.families import FAMILIES, families_of
from clothfit.scene.scene import Scene
from clothfit.simulators import sweeps, xpbd
from clothfit.simulators.substep import Model, Values, zeros
from clothfit.simulators.values import Tool, Value

GROUPS = ("stretch", "shear", "bending")
LEAST_TIME, LEAST_DAMPING = 1e-4, 1e-3
"""Where the mapping has no damping: s along constraints, 1/s of the vertices."""


def groups_of(scene: Scene, index: int) -> Array:
    """The group of each constraint, an index into GROUPS."""
    own = scene.cloths[index]
    names = np.array([0 if not f.startswith(("edges diag", "bending")) else 1 if f.startswith("edges") else 2
                      for f in FAMILIES])
    return names[families_of(own.positions, own.triangles, own.springs)]


def tool_of(scene: Scene, index: int, settings: xpbd.Settings, frames: int) -> Tool:
    """XPBD for one cloth."""
    model = xpbd.model_of(scene, index, settings, frames)
    group = groups_of(scene, index)
    there = [g for g in range(len(GROUPS)) if (group == g).any()]
    time, damping = float(model.time[0]) if len(model.time) else 0.0, float(model.damping[0])
    values = [Value(f"{GROUPS[g]} compliance", "times the mapped one", 1.0, 1.0) for g in there]
    values += [Value(f"{GROUPS[g]} damping", "s", max(time, LEAST_TIME), time) for g in there]
    values.append(Value("air damping", "1/s", max(damping, LEAST_DAMPING), damping))
    drag = float(model.faces.drag)
    if drag > 0:
        values.append(Value("air drag", "kg/(m^6 s)", drag, drag))

    def at(numbers: Array) -> Model:
        return with_values(model, group, there, numbers)

    def motion(numbers: Array) -> Array | None:
        positions, good = sweeps.simulate(at(numbers), frames)
        return positions if good == frames else None

    def columns(numbers: Array) -> Array:
        made = at(numbers)
        return np.array([sweeps.tangent(made, each, frames) for each in directions(made, group, there)])

    return Tool("xpbd", tuple(values), motion, columns)


def each_of(scene: Scene, index: int, settings: xpbd.Settings, frames: int, begin: Array) -> Tool:
    """XPBD with a compliance and a damping of each constraint, and a mass of each free vertex; they start at the few
    values `begin`, and the air has those.
    """
    mapped, group = xpbd.model_of(scene, index, settings, frames), groups_of(scene, index)
    there = [g for g in range(len(GROUPS)) if (group == g).any()]
    first = with_values(mapped, group, there, begin)
    first = first._replace(time=np.maximum(first.time, LEAST_TIME))
    free = np.flatnonzero(mapped.free).astype(np.int32)

    def motion(numbers: Array) -> Array | None:
        positions, good = sweeps.simulate(with_each(first, free, numbers), frames)
        return positions if good == frames else None

    def push(numbers: Array, change: Array) -> Array:
        made = with_each(first, free, numbers)
        by_compliance, by_time, by_mass = parts(change, made)
        direction = zeros(made)._replace(compliance=made.compliance * by_compliance, time=made.time * by_time)
        direction.inverse[free] = -made.inverse[free] * by_mass
        return sweeps.tangent(made, direction, frames)

    def pull(numbers: Array, bars: Array) -> Array:
        made = with_each(first, free, numbers)
        by = sweeps.gradient(made, len(bars), lambda positions: bars)
        return np.concatenate(
            [by.compliance * made.compliance, by.time * made.time, -by.inverse[free] * made.inverse[free]]
        )

    values = []
    for name, unit, old, new in (
        ("compliance", "m/N", mapped.compliance, first.compliance),
        ("damping", "s", mapped.time, first.time),
        ("mass", "kg", 1.0 / mapped.inverse[free], 1.0 / first.inverse[free]),
    ):
        values += [Value(name, unit, float(b), float(a)) for a, b in zip(old, new, strict=True)]
    return Tool("xpbd", tuple(values), motion, push=push, pull=pull)


def parts(numbers: Array, model: Model) -> list[Array]:
    """What of a number for each constraint, again for each, and for each free vertex, belongs to which."""
    count = len(model.rest)
    return np.split(numbers, [count, 2 * count])


def with_each(model: Model, free: Indices, numbers: Array) -> Model:
    """The model with other values of each constraint and free vertex."""
    compliance, time, mass = parts(numbers, model)
    inverse = model.inverse.copy()
    inverse[free] = 1.0 / mass
    return model._replace(compliance=compliance, time=time, inverse=inverse)


def with_values(model: Model, group: Array, there: list[int], numbers: Array) -> Model:
    """The model with other values, in the order of the tool's."""
    count = len(there)
    compliance, time = model.compliance.copy(), model.time.copy()
    for k, g in enumerate(there):
        compliance[group == g] *= numbers[k]
        time[group == g] = numbers[count + k]
    faces = model.faces._replace(drag=float(numbers[2 * count + 1])) if len(numbers) > 2 * count + 1 else model.faces
    return model._replace(
        compliance=compliance, time=time, damping=np.array([float(numbers[2 * count])]), faces=faces
    )


def directions(model: Model, group: Array, there: list[int]) -> list[Values]:
    """The change of a model by the logarithm of each of its values."""
    found = []
    for name, own in (("compliance", model.compliance), ("time", model.time)):
        found += [zeros(model)._replace(**{name: np.where(group == g, own, 0.0)}) for g in there]
    found.append(zeros(model)._replace(damping=model.damping.copy()))
    if model.faces.drag > 0:
        found.append(zeros(model)._replace(drag=np.array([model.faces.drag])))
    return found
