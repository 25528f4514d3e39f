"""Colliders of every shape, and cloths that they hold while they move."""

from typing import Any

import numpy as np

from clothfit.engine.forces.collider_rows import Colliders
from clothfit.engine.inputs.tables import set_inputs
from clothfit.engine.system import System
from helpers.physics import ball, full, keys, xyz
from helpers.surfaces import body, torus

RUB = {"friction": 0.6, "thickness": 0.1, "stiffness": 700.0, "release": 0}
TURN = {"rotKeys": keys([0, 1], [(0, 0, 0), (40, 90, -30)]), "posKeys": keys([0, 1], [(0, 0, 0), (0.8, 0.5, 0.4)])}


def plane(at: Any = (0, 0, 0), angles: Any = (0, 0, 0), **fields: Any) -> dict[str, Any]:
    """A plane through a point, turned by these angles, degrees."""
    return {"type": 0, "pos": xyz(at), "rot": xyz(angles), "scale": xyz((1, 1, 1)), **fields}


def capsule(
    at: Any = (0, 0, 0), radius: float = 0.3, radius2: float = 0.3, height: float = 1.0, **fields: Any
) -> dict[str, Any]:
    """A round cone about the y axis."""
    own = {"radius": radius, "radius2": radius2, "height": height}
    return {"type": 2, "pos": xyz(at), "scale": xyz((1, 1, 1)), "release": 0, **own, **fields}


def box(at: Any = (0, 0, 0), lengths: Any = (1, 1, 1), **fields: Any) -> dict[str, Any]:
    """A box with these lengths."""
    return {"type": 3, "pos": xyz(at), "scale": xyz(lengths), **fields}


def ring(wobble: str, **fields: Any) -> dict[str, Any]:
    """A torus that bends as the file says, and goes and turns as well."""
    motion = {"file": wobble, "interpolation": "smooth"}
    place = {"pos": xyz((0.3, -0.15, 1.0)), "rot": xyz((10, 20, 30))}
    return body(torus(12, 8, 0.8, 0.4), **{**RUB, **TURN, **place, "motion": motion, **fields})


SHAPES = {
    "plane": plane((0, 0.1, 0), (10, 20, 30), **RUB),
    "capsule": capsule((1.0, -0.1, 1.0), 0.5, 0.3, 1.1, rot=xyz((70, 20, 30)), **RUB, **TURN),
    "sphere": {**ball((1.0, -0.3, 1.0), 0.9), **RUB, **TURN},
    "box": box((0.9, 0.0, 1.0), (1.2, 0.7, 1.4), rot=xyz((15, 25, 5)), **RUB, **TURN),
}


def touching(obstacle: dict[str, Any], step: int = 1, **fields: Any) -> System:
    """A cloth that this collider holds in its middle, both where they are in a step."""
    made = full(colliders=[obstacle], planes="solid", **fields)
    set_inputs(made.inputs, made, step)
    return made


def with_room(own: Colliders, count: int) -> Colliders:
    """The same colliders for so many points."""
    names = "last", "asked", "found", "clear"
    room = {name: np.repeat(getattr(own.bodies, name)[:, :1], count, axis=1) for name in names}
    return own._replace(bodies=own.bodies._replace(**room))
