"""Obi Cloth for Unity: masses of particles, compliances of distance and bend constraints.

Obi's constraints are compliant (XPBD): their compliance, m/N, is the inverse of a stiffness, 1/k; 0 is as stiff as the
solver gets. A particle of inverse mass 0 does not move. An actor has one compliance for all its constraints of a kind,
here that of the mean stiffness. Axes and units are the scene's, which are Unity's.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from clothfit.base.arrays import Array, Flags
from clothfit.export.tools import json_text
from clothfit.export.topology import roles
from clothfit.scene.cloth import Cloth
from clothfit.scene.scene import Scene

OBI_FORMAT = "clothfit-obi-1"


def files(scene: Scene, objects: list[dict[str, Any]] | None = None) -> dict[str, bytes]:
    """One file of JSON, of objects that are by default the scene's own."""
    own = [one(number, cloth) for number, cloth in enumerate(scene.cloths)] if objects is None else objects
    units = {"mass": "kg", "compliance": "m/N", "length": "m"}
    return {"obi.json": json_text({"format": OBI_FORMAT, "units": units, "objects": own}, "obi").encode()}


def one(number: int, cloth: Cloth) -> dict[str, Any]:
    """The values of an object for Obi."""
    role = roles(cloth)
    stretch = ~role.bending  # springs of role "other" become distances
    inverse = np.where(cloth.fixed, 0.0, 1.0 / cloth.mass)
    return {
        "object": number,
        "actor": {
            "stretchingScale": 1.0,
            "stretchCompliance": overall(cloth.stiffness[stretch]),
            "maxCompression": 0.0,
            "bendCompliance": overall(cloth.stiffness[role.bending]),
            "maxBending": 0.0,
        },
        "particles": {
            "position": cloth.positions.tolist(),
            "mass": cloth.mass.tolist(),
            "inverseMass": inverse.tolist(),
        },
        "distance": constraints(cloth, stretch),
        "bend": constraints(cloth, role.bending),
    }


def constraints(cloth: Cloth, chosen: Flags) -> dict[str, list[Any]]:
    """The chosen springs: their number, ends, rest lengths and compliances."""
    return {
        "spring": np.flatnonzero(chosen).tolist(),
        "particles": cloth.springs[chosen].tolist(),
        "restLength": cloth.rest[chosen].tolist(),
        "compliance": [compliance(k) for k in cloth.stiffness[chosen].tolist()],
    }


def compliance(stiffness: float) -> float | None:
    """1/k, m/N; None for a spring without stiffness, which is not a constraint."""
    return 1.0 / stiffness if stiffness > 0 and np.isfinite(1.0 / stiffness) else None


def overall(stiffness: Array) -> float | None:
    """The compliance of the mean stiffness; None without springs."""
    return compliance(float(np.mean(stiffness))) if len(stiffness) else None
