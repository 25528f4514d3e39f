"""What a fit of a tool's values leaves: a summary, and files in which a tool, or an artist, finds the values."""

from __future__ import annotations

from typing import Any

import numpy as np

from clothfit.export import blender as mapping
from clothfit.export import numbers, obi
from clothfit.export.blender import blender_files
from clothfit.scene.scene import Scene
from clothfit.simulators.estimate import Options
from clothfit.simulators.values import Fitted

FORMAT = "clothfit-simulator-1"


def summary(found: list[Fitted], options: Options) -> dict[str, Any]:
    """Values, and what remains beside what the mapping leaves, by object."""
    objects = [
        {
            "object": number,
            "values": [
                {"name": value.name, "unit": value.unit, "mapped": value.mapped, "fitted": float(fitted)}
                for value, fitted in zip(each.tool.values, each.found, strict=True)
            ],
            "travel": each.travel,
            "mapped_rmse": each.mapped_rmse if np.isfinite(each.mapped_rmse) else None,
            "rmse": each.rmse,
            "simulations": each.simulations,
        }
        for number, each in enumerate(found)
    ]
    own: dict[str, Any] = {"simulator": options.simulator, "objects": objects}
    if options.simulator == "xpbd":
        settings = options.settings
        own |= {"substeps": settings.substeps, "iterations": settings.iterations, "bending": settings.bending}
    return own


def files(scene: Scene, found: list[Fitted], options: Options) -> dict[str, bytes]:
    """The values as JSON; for Blender also the script that sets them, for XPBD every constraint as Obi takes it."""
    document = {"format": FORMAT, "units": "SI", **summary(found, options)}
    made = {f"{options.simulator}-values.json": numbers.text(document, options.simulator).encode()}
    if options.simulator == "blender":
        return made | blender(scene, found)
    return made | {"obi.json": compliances(scene, found)}


def blender(scene: Scene, found: list[Fitted]) -> dict[str, bytes]:
    """The files of the export, with the fitted values."""
    from clothfit.simulators.blender import with_values

    objects = []
    for number, each in enumerate(found):
        base = mapping.one(number, scene.cloths[number], mapping.step_of(scene))
        objects.append(with_values(base, [value.name for value in each.tool.values], each.found))
    return blender_files(scene, objects)


def compliances(scene: Scene, found: list[Fitted]) -> bytes:
    """The file of the export to Obi, with the fitted compliances; bending is that of distances across edges."""
    from clothfit.simulators.xpbd_values import GROUPS, groups_of

    objects = []
    for number, each in enumerate(found):
        one, group = obi.one(number, scene.cloths[number]), groups_of(scene, number)
        factor = dict(zip((value.name for value in each.tool.values), each.found, strict=True))
        for kind in ("distance", "bend"):
            own = one[kind]
            for place, spring in enumerate(own["spring"]):
                times = factor[f"{GROUPS[group[spring]]} compliance"]
                if own["compliance"][place] is not None:
                    own["compliance"][place] *= float(times)
        mean(one["actor"], "stretchCompliance", one["distance"]["compliance"])
        mean(one["actor"], "bendCompliance", one["bend"]["compliance"])
        objects.append(one)
    return obi.document(objects)


def mean(actor: dict[str, Any], name: str, values: list[float | None]) -> None:
    """Set the compliance of the mean stiffness."""
    known = [1.0 / value for value in values if value]
    if known:
        actor[name] = len(known) / sum(known)
