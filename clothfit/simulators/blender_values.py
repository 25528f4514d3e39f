"""Values of each vertex in Blender: stiffness, bending and rest length as its vertex groups have them.

A spring of Blender's takes the mean of its two ends, of the stiffness and of what its edge's length is multiplied by
("shrink", which may be negative); a hinge the mean of the ends of its edge. With the least and the largest of the
vertices as a range, weights make any of them.

Blender gives no derivatives. A model nearby has some: XPBD with the edges as distances and the hinges as angles, and
Blender's steps, masses and dampings. So steps of Gauss–Newton take the distances from Blender and their change from
that model, and a step counts where Blender itself comes nearer: each costs one run of Blender. (J. Bandler et al.,
*Space mapping: the state of the art*, 2004, where the model nearby is the coarse one.)
"""

from __future__ import annotations

import json
from typing import Any

import numpy as np

from clothfit.base.arrays import Array, Indices
from clothfit.export.blender import LARGEST_STIFFNESS, TIME_UNIT, steps_of
from clothfit.export.topology import roles
from clothfit.scene.scene import Scene
from clothfit.simulators import xpbd
from clothfit.simulators.directions import Seeds, Sweep, no_seeds
from clothfit.simulators.substep import Model
from clothfit.simulators.values import Tool, Value
from clothfit.simulators.xpbd_values import LEAST_TIME, SPREAD

ITERATIONS = 10
"""Of the model nearby, in a step of Blender's."""

STIFFNESS, BENDING, LENGTH = "stiffness", "bending", "rest length"
LEAST = 1e-3
"""Of the largest stiffness of a vertex: the least that is tried."""


def each_of(scene: Scene, index: int, few: Tool, begin: dict[str, Any], frames: int, frame: float, play: Any) -> Tool:
    """Blender with values of each vertex, from those of an object of the script on, over so many frames of some
    length, s; `play` gives the motion of an object's values.
    """
    cloth, start = scene.cloths[index], {}
    for name, group in ((STIFFNESS, begin["structural"]), (BENDING, begin["bending"])):
        if group and group["stiffness_max"] > 0:
            start[name] = at_vertices(group)
    start[LENGTH] = np.ones(len(cloth.mass))
    units = {STIFFNESS: "Blender's", BENDING: "Blender's", LENGTH: "times the edge's"}
    values = tuple(
        Value(name, units[name], float(value), float(value), *((SPREAD,) if name == LENGTH else ()))
        for name, own in start.items() for value in own
    )
    model, ends = nearby(scene, index, begin, frames, frame)

    def split(numbers: Array) -> dict[str, Array]:
        return dict(zip(start, np.split(numbers, len(start)), strict=True))

    def motion(numbers: Array) -> Array | None:
        found: Array | None = play(with_each(begin, split(numbers)))
        return found

    def sweep(numbers: Array, along: bool) -> Sweep:
        own = split(numbers)
        made = with_vertices(model, ends, start, own)
        return Sweep(made, seeds_of(made, ends, own), len(numbers)) if along else Sweep(made, no_seeds(made), 0)

    return Tool(few.name, values, motion, sweep=sweep, nearby=True)


def at_vertices(group: dict[str, Any]) -> Array:
    """The stiffness of each vertex of a group, above 0."""
    low, high = group["stiffness"], group["stiffness_max"]
    found: Array = np.maximum(low + (high - low) * np.array(group["weights"]), LEAST * high)
    return found


def weights_of(own: Array) -> tuple[float, float, list[float]]:
    """The least and the largest of the vertices' values, and the weights between them."""
    low, high = float(own.min()), float(own.max())
    return low, high, ((own - low) / (high - low) if high > low else np.zeros(len(own))).tolist()


def with_each(base: dict[str, Any], own: dict[str, Array]) -> dict[str, Any]:
    """The values of an object for the script, with those of each vertex."""
    found: dict[str, Any] = json.loads(json.dumps(base))
    if STIFFNESS in own:
        low, high, weights = weights_of(np.minimum(own[STIFFNESS], LARGEST_STIFFNESS))
        before = base["structural"]["stiffness_max"]
        found["structural"] |= {"stiffness": low, "stiffness_max": high, "weights": weights}
        for kind in ("tension", "compression"):
            if kind in found:
                factor = base[kind]["stiffness_max"] / before
                found[kind] = {"stiffness": min(low * factor, LARGEST_STIFFNESS),
                               "stiffness_max": min(high * factor, LARGEST_STIFFNESS)}
    if BENDING in own:
        low, high, weights = weights_of(np.minimum(own[BENDING], LARGEST_STIFFNESS))
        found["bending"] |= {"stiffness": low, "stiffness_max": high, "weights": weights}
    low, high, weights = weights_of(1.0 - own[LENGTH])
    found["shrink"] = {"least": low, "most": high, "weights": weights}
    return found


def nearby(scene: Scene, index: int, base: dict[str, Any], frames: int, frame: float) -> tuple[Model, Indices]:
    """XPBD with what Blender has, and the vertices (K, 2) whose values each of its constraints takes."""
    cloth = scene.cloths[index]
    role = roles(cloth)
    kept = role.traction | role.bending
    members, rest, compliance = xpbd.constraints(cloth, xpbd.ANGLE)
    ends = np.where(role.bending[:, None], role.hinges, cloth.springs)[kept]
    length, mass = base["mean_length"], np.where(cloth.fixed, np.inf, base["mass"])
    tension = base.get("tension", base["structural"])
    factor = tension["stiffness_max"] / max(base["structural"]["stiffness_max"], 1e-300)
    stiffness = factor * at_vertices(base["structural"])[ends].mean(axis=1) / (TIME_UNIT**2 * length)
    bent = members[kept, 2] >= 0
    soft = np.where(bent, compliance[kept], 1.0 / stiffness)
    damping = base.get("tension_damping", base["spring_damping"]) / TIME_UNIT
    full = xpbd.model_of(scene, index, xpbd.Settings(1, ITERATIONS), 2)
    still = np.zeros((frames, 3))
    return full._replace(
        inverse=1.0 / mass, members=members[kept], rest=rest[kept], compliance=soft,
        relaxation=full.relaxation[kept], time=np.maximum(np.where(bent, 0.0, damping * soft), LEAST_TIME),
        damping=np.full(len(mass), base["air_damping"] / (100.0 * TIME_UNIT * base["mass"])),
        faces=full.faces._replace(drag=0.0), radius=np.zeros(0), wind=still, gravity=still + scene.gravity,
        centre=np.zeros((frames, 0, 3)), path=np.zeros((frames, 0, 3)), pins=np.zeros(0, np.int32),
        h=frame, substeps=max(1, round(frame / steps_of(scene)[0])),
    ), ends.astype(np.int32)  # fmt: skip


def with_vertices(model: Model, ends: Indices, start: dict[str, Array], own: dict[str, Array]) -> Model:
    """The model nearby with other values of the vertices."""
    compliance, rest, bent = model.compliance.copy(), model.rest.copy(), model.members[:, 2] >= 0
    for name, chosen in ((STIFFNESS, ~bent), (BENDING, bent)):
        if name in own:
            both = ends[chosen]
            compliance[chosen] *= start[name][both].mean(axis=1) / own[name][both].mean(axis=1)
    rest[~bent] *= own[LENGTH][ends[~bent]].mean(axis=1)
    return model._replace(compliance=compliance, rest=rest, time=model.time * compliance / model.compliance)


def seeds_of(model: Model, ends: Indices, own: dict[str, Array]) -> Seeds:
    """The directions of the vertices' values: of compliances, with which the times of damping change as the
    coefficients stay, and of the lengths of edges.
    """
    n, bent, none = len(model.x0), model.members[:, 2] >= 0, np.full(ends.shape, -1, np.int32)
    compliance, rest, share = none.copy(), none.copy(), np.zeros((3, *ends.shape))
    for number, (name, values) in enumerate(own.items()):
        chosen = bent if name == BENDING else ~bent
        both = ends[chosen]
        part = values[both] / values[both].sum(axis=1, keepdims=True)
        if name == LENGTH:
            rest[chosen], share[2, chosen] = n * number + both, part
        else:
            compliance[chosen], share[:2, chosen] = n * number + both, -part
    return no_seeds(model)._replace(compliance=compliance, time=compliance, rest=rest, share=share)
