"""What a fit of a tool's values leaves: a summary, and files in which a tool, or an artist, finds the values."""

from __future__ import annotations

from typing import Any

import numpy as np

from clothfit.base.arrays import Array, Flags
from clothfit.export import blender as mapping
from clothfit.export import obi
from clothfit.export.tools import json_text
from clothfit.scene.scene import Scene
from clothfit.simulators.estimate import Options
from clothfit.simulators.values import Fitted
from clothfit.simulators.xpbd import GROUPS, SOLVED, Settings, groups_of

FORMAT = "clothfit-simulator-1"


def summary(found: list[Fitted], options: Options) -> dict[str, Any]:
    """Values, and what remains beside what the mapping leaves, by object."""
    objects = [one_summary(number, each) for number, each in enumerate(found)]
    own: dict[str, Any] = {"simulator": options.simulator, "objects": objects}
    if options.simulator == "xpbd":
        settings = options.settings
        own |= {"substeps": settings.substeps, "iterations": settings.iterations, "bending": settings.bending}
    return own


def one_summary(number: int, found: Fitted) -> dict[str, Any]:
    """The same of an object. Where many values were fitted, they stand in lists beside the few."""
    first = found.few or found
    own: dict[str, Any] = {
        "object": number,
        "values": [
            {"name": value.name, "unit": value.unit, "mapped": value.mapped, "fitted": float(fitted)}
            for value, fitted in zip(first.tool.values, first.found, strict=True)
        ],
        "travel": found.travel,
        "mapped_rmse": first.mapped_rmse if np.isfinite(first.mapped_rmse) else None,
        "rmse": found.rmse,
        "simulations": found.simulations,
    }
    if found.few:
        own["few_rmse"] = found.few.rmse
        own["each"] = {
            name: {"unit": unit, "mapped": mapped.tolist(), "fitted": fitted.tolist()}
            for name, unit, mapped, fitted in found.kinds()
        }
    return own


def files(scene: Scene, found: list[Fitted], options: Options) -> dict[str, bytes]:
    """The values as JSON; for Blender also the script that sets them, for XPBD every constraint as Obi takes it."""
    document = {"format": FORMAT, "units": "SI", **summary(found, options)}
    made = {f"{options.simulator}-values.json": json_text(document, options.simulator).encode()}
    if options.simulator == "blender":
        return made | blender(scene, found)
    return made | compliances(scene, found, options.settings)


def blender(scene: Scene, found: list[Fitted]) -> dict[str, bytes]:
    """The files of the export, with the fitted values."""
    from clothfit.simulators.blender import with_values

    objects = []
    for number, each in enumerate(found):
        base = mapping.one(number, scene.cloths[number], *mapping.steps_of(scene))
        objects.append(with_values(base, [value.name for value in each.tool.values], each.found))
    return mapping.files(scene, objects)


def compliances(scene: Scene, found: list[Fitted], settings: Settings) -> dict[str, bytes]:
    """The file of the export to Obi, with the fitted compliances, and how its solver is set; bending is that of
    distances across edges.
    """
    objects = []
    for number, each in enumerate(found):
        one, factor = obi.one(number, scene.cloths[number]), factors(scene, number, each)
        for kind in ("distance", "bend"):
            own = one[kind]
            for place, spring in enumerate(own["spring"]):
                if own["compliance"][place] is not None:
                    own["compliance"][place] *= float(factor[spring])
        if each.few:
            lengths(one, each)
            masses(one["particles"], scene.cloths[number].fixed, each)
        mean(one["actor"], "stretchCompliance", one["distance"]["compliance"])
        mean(one["actor"], "bendCompliance", one["bend"]["compliance"])
        one["solver"] = solver(each, settings)
        objects.append(one)
    return obi.files(scene, objects)


def solver(fitted: Fitted, settings: Settings) -> dict[str, Any]:
    """How a solver is set for an object, by Obi's names."""
    value = {each.name: float(own) for each, own in zip(fitted.tool.values, fitted.found, strict=True)}
    kinds = {kind: {"iterations": settings.iterations, "SORFactor": value[f"{kind} relaxation"]}
             for kind in SOLVED if f"{kind} relaxation" in value}
    return {"substeps": settings.substeps, **kinds}


def factors(scene: Scene, number: int, found: Fitted) -> Array:
    """What the compliance of each spring (S,) of an object is multiplied by."""
    if found.few:
        _, _, mapped, fitted = found.kinds()[0]
        return fitted / mapped
    factor = dict(zip((value.name for value in found.tool.values), found.found, strict=True))
    times: Array = np.array([factor.get(f"{name} compliance", 1.0) for name in GROUPS])[groups_of(scene, number)]
    return times


def lengths(one: dict[str, Any], found: Fitted) -> None:
    """Set the rest lengths of an object's distances; where bending is by angles, its springs keep theirs."""
    _, _, mapped, fitted = found.kinds()[2]
    distances, bends = ([spring for spring, rest in zip(one[kind]["spring"], one[kind]["restLength"], strict=True)
                         if rest > 0] for kind in ("distance", "bend"))
    both = sorted(distances + bends)
    by_spring = dict(zip(both if len(both) == len(mapped) else sorted(distances), fitted, strict=True))
    for kind in ("distance", "bend"):
        one[kind]["restLength"] = [
            float(by_spring.get(spring, length))
            for spring, length in zip(one[kind]["spring"], one[kind]["restLength"], strict=True)
        ]


def masses(particles: dict[str, Any], fixed: Flags, found: Fitted) -> None:
    """Set the masses of the free particles."""
    fitted = next(fitted for name, _, _, fitted in found.kinds() if name == "mass")
    for vertex, mass in zip(np.flatnonzero(~fixed), fitted, strict=True):
        particles["mass"][vertex], particles["inverseMass"][vertex] = float(mass), 1.0 / float(mass)


def mean(actor: dict[str, Any], name: str, values: list[float | None]) -> None:
    """Set the compliance of the mean stiffness."""
    known = [1.0 / value for value in values if value]
    if known:
        actor[name] = len(known) / sum(known)
