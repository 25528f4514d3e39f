"""Stiffnesses that are not negative, near those of a plain rule, by sparse linear least squares."""

from __future__ import annotations

from typing import Any

import numpy as np

from clothfit.base.arrays import Array

FLOOR = 1e-3
"""The least stiffness, as a share of that of the plain rule."""

TRUST = 1e-2
"""Weight of the plain rule."""

ROUNDS = 12
"""Most solutions, while what would be negative is held at the least."""


def shares(matrix: Any, target: Array) -> Array:
    """The stiffnesses x (S,), as shares of those of the plain rule, with the least |matrix · x − target|."""
    from scipy.sparse import diags_array
    from scipy.sparse.linalg import splu

    count = matrix.shape[1]
    normal = (matrix.T @ matrix + TRUST**2 * diags_array(np.ones(count))).tocsr()
    right = matrix.T @ target + TRUST**2
    x, held = np.ones(count), np.zeros(count, bool)
    for _ in range(ROUNDS):
        free = np.flatnonzero(~held)
        x = np.full(count, FLOOR)
        known = normal @ np.where(held, FLOOR, 0.0)
        x[free] = splu(normal[free][:, free].tocsc()).solve((right - known)[free])
        low = ~held & (x < FLOOR)
        if not low.any():
            break
        held |= low
    return np.maximum(x, FLOOR)
