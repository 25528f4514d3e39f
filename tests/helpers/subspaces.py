"""Cloths and bases for tests of subspaces."""

from typing import Any

import numpy as np

from clothfit import load
from clothfit.base.arrays import Array
from clothfit.engine.system import System, build
from clothfit.scene.scene import dumps
from helpers.scenes import cloth, document


def xyz(*vectors: tuple[float, float, float]) -> list[dict[str, float]]:
    """Vectors as JSON has them."""
    return [dict(zip("xyz", each, strict=True)) for each in vectors]


def keys(times: list[float], *values: tuple[float, float, float]) -> dict[str, Any]:
    """Keys as a scene has them."""
    return {"times": times, "values": xyz(*values), "interpolation": "smooth"}


def moving(**fields: Any) -> dict[str, Any]:
    """A document with all that a subspace knows: wind and a pin that move, a sphere, a floor that rubs."""
    zero = xyz((0, 0, 0))[0]
    ball = {"type": 1, "pos": xyz((1.0, -0.35, 1.0))[0], "rot": zero, "scale": xyz((0.8, 0.8, 0.8))[0]}
    rubbing = {**ball, "pos": xyz((2.0, -0.45, 1.2))[0], "friction": 0.3, "thickness": 0.1, "stiffness": 200.0}
    pins = [{"vertices": [0], "posKeys": keys([0, 0.2, 0.5], (0, 0, 0), (0.2, 0.1, -0.1), (0.1, 0.3, 0))}]
    own = cloth(4, 3, pins=pins, damping=0.4)
    changing = {"windVelKeys": keys([0, 0.3, 0.6], (0, 0, 0), (6, 1, -4), (-3, 0, 5))}
    return document(own, colliders=[ball, rubbing], tolerance=1e-12, **changing, **fields)


def scene_of(made: dict[str, Any]) -> Any:
    """The scene of a document."""
    return load(made)


def whole(system: System) -> Array:
    """The basis (n, 3, 3 m) of all motions of the m free vertices."""
    free = np.flatnonzero(np.repeat(system.vertex.free, 3))
    made = np.zeros((3 * len(system.x0), len(free)))
    made[free, np.arange(len(free))] = 1.0
    return made.reshape(-1, 3, len(free))


def some(system: System, size: int, seed: int = 3) -> Array:
    """A basis (n, 3, size) of smooth random vectors, 0 at fixed vertices."""
    rng = np.random.default_rng(seed)
    made = np.cumsum(rng.standard_normal((len(system.x0), 3, size)), axis=0)
    made[~system.vertex.free] = 0.0
    return np.linalg.qr(made.reshape(-1, size))[0].reshape(made.shape)


def model_of(scene: Any, size: int = 9, normals: bool = False) -> Any:
    """A model of a scene on smooth random vectors, with all elements, whose inputs go far."""
    from clothfit.subspace.model import Model, Part
    from clothfit.subspace.physics.samples import everything

    parts = []
    rng = np.random.default_rng(1)
    for c in range(len(scene.cloths)):
        system = build(scene, c, steps=1)
        basis = some(system, size).astype(np.float32).astype(float)
        own = rng.standard_normal((len(basis), 3, 1 + size)).astype(np.float32) if normals else None
        parts.append(Part(basis, everything(system), np.stack([np.full(size, -9.0), np.full(size, 9.0)]), own))
    far = {name: [[-99.0] * 3, [99.0] * 3] for name in ("wind", "gravity", "pins")}
    return Model(dumps(scene), "", tuple(parts), far)
