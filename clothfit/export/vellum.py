"""Houdini's Vellum: geometry with masses, and one distance constraint for each spring.

Two files of Houdini's JSON geometry (.geo) for each object, with the same points: the mesh, for the solver's first
input, and the constraints, two-point polylines with `type`, `restlength`, `stiffness`, `dampingratio`, for its second.
A point of mass 0 is pinned. Bending springs are distances too, across an edge, and stay as they are. Houdini shows a
stiffness as mantissa × 10^exponent; for users who set one value there, a third file has the means in that form.
Houdini's axes are right-handed, so z changes its sign and faces reverse their corners.

The damping ratio of a spring is the textbook's: (α/2) k / (2 √(k m)), with the reduced mass m = m_a m_b / (m_a + m_b),
where the mass of a fixed end is infinite.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from clothfit.base.arrays import Array, Flags, Indices
from clothfit.export.tools import json_text
from clothfit.export.topology import roles
from clothfit.scene.cloth import Cloth
from clothfit.scene.scene import Scene

VELLUM_FORMAT = "clothfit-vellum-1"
FLIP = np.array([1.0, 1.0, -1.0])  # from left- to right-handed axes


def files(scene: Scene) -> dict[str, bytes]:
    """Two files of geometry for each object, and one of means."""
    made = {}
    for number, cloth in enumerate(scene.cloths):
        mass = np.where(cloth.fixed, 0.0, cloth.mass)
        points = {"P": cloth.positions * FLIP, "v": cloth.velocity * FLIP, "mass": mass}
        faces = cloth.triangles[:, ::-1]
        made[f"object{number}.cloth.geo"] = geometry(points, {}, faces, closed=True)
        made[f"object{number}.constraints.geo"] = geometry(points, constraints(cloth), cloth.springs, closed=False)
    summary = {"format": VELLUM_FORMAT, "objects": [one(number, cloth) for number, cloth in enumerate(scene.cloths)]}
    return made | {"vellum.json": json_text(summary, "vellum").encode()}


def constraints(cloth: Cloth) -> dict[str, Array | list[str]]:
    """The attributes of the constraints."""
    return {
        "type": ["distance"] * len(cloth.springs),
        "role": roles(cloth).names,
        "restlength": cloth.rest,
        "stiffness": cloth.stiffness,
        "dampingratio": damping_ratio(cloth),
    }


def damping_ratio(cloth: Cloth) -> Array:
    """The damping ratios (S,) of the springs; 0 where both ends are fixed."""
    a, b = (np.where(cloth.fixed, 0.0, 1.0 / cloth.mass)[cloth.springs[:, end]] for end in (0, 1))
    with np.errstate(over="ignore"):  # of values that `text` refuses
        ratios: Array = 0.25 * cloth.damping * np.sqrt(cloth.stiffness * (a + b))
    return ratios


def one(number: int, cloth: Cloth) -> dict[str, Any]:
    """The means of an object, for users who set one value."""
    role = roles(cloth)
    return {
        "object": number,
        "mass": float(cloth.mass.mean()),
        "traction": scientific(cloth.stiffness, ~role.bending),
        "bending": scientific(cloth.stiffness, role.bending),
    }


def scientific(stiffness: Array, chosen: Flags) -> dict[str, float | int] | None:
    """The mean of the chosen stiffnesses, and the same as mantissa × 10^exponent, the mantissa from 1 to below 10."""
    mean = float(stiffness[chosen].mean()) if chosen.any() else 0.0
    if not mean > 0:
        return None
    mantissa, exponent = f"{mean:.16e}".split("e")
    return {"mean": mean, "mantissa": float(mantissa), "exponent": int(exponent)}


def geometry(
    points: dict[str, Array], primitives: dict[str, Array | list[str]], corners: Indices, closed: bool
) -> bytes:
    """A .geo file: points and polygons of the same number of corners each, `corners` (count, per polygon)."""
    count, sides = corners.shape
    run = ["startvertex", 0, "nprimitives", count, "nvertices_rle", [sides, count]]
    attributes = ["pointattributes", [numbers(name, values) for name, values in points.items()]]
    if primitives:
        own = [strings(k, v) if isinstance(v, list) else numbers(k, v) for k, v in primitives.items()]
        attributes += ["primitiveattributes", own]
    document = [
        "fileversion", "18.0.0", "hasindex", False,
        "pointcount", len(points["P"]), "vertexcount", count * sides, "primitivecount", count,
        "topology", ["pointref", ["indices", corners.reshape(-1).tolist()]],
        "attributes", attributes,
        "primitives", [[["type", "Polygon_run" if closed else "PolygonCurve_run"], run]] if count else [],
    ]  # fmt: skip
    return json_text(document, "vellum").encode()


def numbers(name: str, values: Array) -> list[Any]:
    """An attribute of one number each (count,), or of vectors (count, 3)."""
    size = 1 if values.ndim == 1 else values.shape[1]
    kind = {"P": "point", "v": "vector"}.get(name)
    options = {} if kind is None else {"type": {"type": "string", "value": kind}}
    head = ["scope", "public", "type", "numeric", "name", name, "options", options]
    held = ["tuples", values.tolist()] if size > 1 else ["arrays", [values.tolist()]]
    default = ["size", 1, "storage", "fpreal64", "values", [0.0]]
    content = ["size", size, "storage", "fpreal64", *held]
    return [head, ["size", size, "storage", "fpreal64", "defaults", default, "values", content]]


def strings(name: str, values: list[str]) -> list[Any]:
    """An attribute of strings."""
    known = list(dict.fromkeys(values))
    head = ["scope", "public", "type", "string", "name", name, "options", {}]
    places = ["size", 1, "storage", "int32", "arrays", [[known.index(word) for word in values]]]
    return [head, ["size", 1, "storage", "int32", "strings", known, "indices", places]]
