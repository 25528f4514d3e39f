"""What carries a cloth whose pins move: their mean displacement, which all free vertices share.

    x = x₀ + T(t) + U q,     T the mean over the pins of their way since the start, 0 without pins.

So U holds how a cape hangs and swings, not where its wearer walks. The coordinates q of a motion are those of the
nearest shape, by mass.
"""

from __future__ import annotations

import numpy as np

from clothfit.base.arrays import Array
from clothfit.engine.inputs.tables import Inputs
from clothfit.engine.system import System


def shift(inputs: Inputs | None, frames: int, first: int = 0) -> Array:
    """T (frames, 1, 3), m, from frame `first` on."""
    if inputs is None or not inputs.path.size:
        return np.zeros((frames, 1, 3))
    return np.asarray((inputs.path[first : first + frames] - inputs.path[0]).mean(axis=1, keepdims=True))


def paths(system: System) -> tuple[Array, Array, Array]:
    """The places (T, P + 1, 3), m, of the pins and, in the last row, T; where they start, 0 for T; their velocities
    (P + 1, 3) at the start, m/s. Without pins they have no rows.
    """
    inputs = system.inputs
    if inputs is None or not inputs.path.size:
        return np.zeros((0, 0, 3)), np.zeros((0, 3)), np.zeros((0, 3))
    own = shift(inputs, len(inputs.path))
    velocity = system.v0[inputs.pins]
    start = np.concatenate([system.x0[inputs.pins], np.zeros((1, 3))])
    return np.concatenate([inputs.path, own], axis=1), start, np.vstack([velocity, velocity.mean(axis=0)])


def start_velocity(system: System, basis: Array) -> Array:
    """The velocity p (r,) of the coordinates at the start, 1/s, past what carries the cloth."""
    _, _, held = paths(system)
    v = system.v0 - (held[-1] if len(held) else 0.0)
    flat = basis.reshape(-1, basis.shape[2])
    weighted = (basis * system.vertex.mass[:, None, None]).reshape(flat.shape)
    return np.asarray(np.linalg.solve(weighted.T @ flat, weighted.T @ v.ravel()))


def relative(x: Array, system: System) -> Array:
    """Displacements (frames, n, 3) without T, and 0 at fixed vertices."""
    moved = x - shift(system.inputs, len(x))
    moved[:, ~system.vertex.free] = 0.0
    return np.asarray(moved)


def projection(basis: Array, system: System) -> Array:
    """What displacements (…, 3 n) past the translation are multiplied by to get coordinates on a basis U (n, 3, r):
    M U (Uᵀ M U)⁻¹, (3 n, r).
    """
    flat = basis.reshape(-1, basis.shape[2])
    weighted = (basis * system.vertex.mass[:, None, None]).reshape(flat.shape)
    return np.asarray(np.linalg.solve(weighted.T @ flat, weighted.T).T)


def coordinates(x: Array, system: System, onto: Array) -> Array:
    """The coordinates (frames, r) of displacements (frames, n, 3), by a `projection`."""
    return np.asarray(relative(x, system).reshape(len(x), -1) @ onto)
