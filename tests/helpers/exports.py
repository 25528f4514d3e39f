"""A scene for the tests of `clothfit.export`, and its files."""

import json
from functools import cache
from typing import Any

import numpy as np

from clothfit import load
from clothfit.export.tools import exported
from clothfit.meshes import mesh
from clothfit.scene.scene import Scene
from helpers.scenes import cloth, document

ROUNDING = 1e-15
"""Relative, of one division: two roundings of 1.1e-16 each, and some."""


def built(divisions: int = 4, seed: int = 2, **fields: Any) -> dict[str, Any]:
    """An object as the editor builds it, with bending springs, its values scattered."""
    plane = mesh.plane(divisions, 1.0)
    held = np.arange(len(plane.positions)) < 2
    made = mesh.object_document(plane, held, density=0.1, stiffness=50.0, damping=0.1, drag=0.1)
    rng = np.random.default_rng(seed)
    for name in ("vertMass", "springStiffness"):
        made[name] = (np.array(made[name]) * rng.lognormal(0.0, 0.3, len(made[name]))).tolist()
    return {**made, **fields}


def of(*objects: dict[str, Any]) -> Scene:
    """A scene of objects."""
    return load(document(*objects))


@cache
def two() -> Scene:
    """Two objects: one with bending springs, one without, and with a velocity."""
    moving = [{"x": 0.1 * i, "y": 0.0, "z": 0.3} for i in range(12)]
    return of(built(), cloth(4, 3, vertVel=moving))


def content(scene: Scene, tool: str, name: str) -> Any:
    """A file of JSON."""
    return json.loads(exported(scene, tool)[name])
