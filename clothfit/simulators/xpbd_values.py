"""The few values of XPBD: a factor on the compliances of each family, damping, and the air; or those of each constraint
and vertex.
"""

from __future__ import annotations

import numpy as np

from clothfit.base.arrays import Array, Indices
from clothfit.scene.families import FAMILIES, families_of
from clothfit.scene.scene import Scene
from clothfit.simulators import sweeps, xpbd
from clothfit.simulators.directions import Seeds, Sweep, no_seeds
from clothfit.simulators.substep import Model, Values, zeros
from clothfit.simulators.values import RANGE, Tool, Value

GROUPS = ("stretch", "shear", "bending")
LEAST_TIME, LEAST_DAMPING = 1e-4, 1e-3
SPREAD = np.log(4.0)
"""Where the mapping has no damping: s along constraints, 1/s of the vertices; and how far a rest length may go, in its
logarithm.
"""

SHARE = 0.15
"""Of a substep: the least damping that a fit of each constraint starts with, s; a smaller one would not be felt."""



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


def each_of(scene: Scene, index: int, settings: xpbd.Settings, frames: int, few: Array) -> tuple[Tool, Array]:
    """XPBD with a compliance and a damping of each constraint, a rest length of each distance, and a mass of each free
    vertex, which start at the mapped ones; and these values as the few have them. The air has those of the few.
    """
    mapped, group = xpbd.model_of(scene, index, settings, frames), groups_of(scene, index)
    there = [g for g in range(len(GROUPS)) if (group == g).any()]
    first = with_values(mapped, group, there, few)
    first = first._replace(time=np.maximum(first.time, LEAST_TIME))
    felt = np.maximum(mapped.time, SHARE * mapped.h / mapped.substeps)
    free = np.flatnonzero(mapped.free).astype(np.int32)
    long = np.flatnonzero((mapped.members[:, 2] < 0) & (mapped.rest > 0)).astype(np.int32)
    seeds = seeds_of(mapped, long, free)
    count = 2 * len(mapped.rest) + len(long) + len(free)

    def at(numbers: Array) -> Model:
        compliance, time, rest, mass = parts(numbers, mapped, long)
        lengths, inverse = mapped.rest.copy(), mapped.inverse.copy()
        lengths[long], inverse[free] = rest, 1.0 / mass
        return first._replace(compliance=compliance, time=time, rest=lengths, inverse=inverse)

    def sweep(numbers: Array, along: bool) -> Sweep:
        return Sweep(at(numbers), seeds, count) if along else Sweep(at(numbers), no_seeds(first), 0)

    def motion(numbers: Array) -> Array | None:
        positions, good = sweeps.simulate(at(numbers), frames)
        return positions if good == frames else None

    def push(numbers: Array, change: Array) -> Array:
        made = at(numbers)
        by_compliance, by_time, by_rest, by_mass = parts(change, made, long)
        direction = zeros(made)._replace(compliance=made.compliance * by_compliance, time=made.time * by_time)
        direction.rest[long] = made.rest[long] * by_rest
        direction.inverse[free] = -made.inverse[free] * by_mass
        return sweeps.tangent(made, direction, frames)

    def pull(numbers: Array, bars: Array) -> Array:
        made = at(numbers)
        by = sweeps.gradient(made, len(bars), lambda positions: bars)
        return np.concatenate(
            [by.compliance * made.compliance, by.time * made.time, by.rest[long] * made.rest[long],
             -by.inverse[free] * made.inverse[free]]
        )  # fmt: skip

    values = []
    for name, unit, old, new, spread in (
        ("compliance", "m/N", mapped.compliance, mapped.compliance, RANGE),
        ("damping", "s", mapped.time, felt, RANGE),
        ("rest length", "m", mapped.rest[long], mapped.rest[long], SPREAD),
        ("mass", "kg", 1.0 / mapped.inverse[free], 1.0 / mapped.inverse[free], RANGE),
    ):
        values += [Value(name, unit, float(b), float(a), spread) for a, b in zip(old, new, strict=True)]
    begin = np.concatenate([first.compliance, first.time, mapped.rest[long], 1.0 / mapped.inverse[free]])
    return Tool("xpbd", tuple(values), motion, push=push, pull=pull, sweep=sweep), begin


def seeds_of(model: Model, long: Indices, free: Indices) -> Seeds:
    """The directions of the values of each constraint and free vertex, in their order."""
    count, seeds = len(model.rest), no_seeds(model)
    first = np.arange(count, dtype=np.int32)[:, None]
    rest = seeds.rest.copy()
    rest[long, 0] = 2 * count + np.arange(len(long))
    seeds.mass[free] = 2 * count + len(long) + np.arange(len(free))
    return seeds._replace(compliance=first, time=first + np.int32(count), rest=rest)


def parts(numbers: Array, model: Model, long: Indices) -> list[Array]:
    """What of a number for each constraint, again for each, for each distance, and for each free vertex, belongs to
    which.
    """
    count = len(model.rest)
    return np.split(numbers, [count, 2 * count, 2 * count + len(long)])


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
