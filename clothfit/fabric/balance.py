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
    from scipy.sparse import diags_array, vstack
    from scipy.sparse.linalg import lsmr

    count = matrix.shape[1]
    x, held = np.ones(count), np.zeros(count, bool)
    for _ in range(ROUNDS):
        free = np.flatnonzero(~held)
        system = vstack([matrix[:, free], TRUST * diags_array(np.ones(len(free)))]).tocsr()
        right = np.concatenate([target - matrix @ np.where(held, FLOOR, 0.0), np.full(len(free), TRUST)])
        x = np.full(count, FLOOR)
        x[free] = lsmr(system, right, atol=1e-8, btol=1e-8, maxiter=2000, x0=np.ones(len(free)))[0]
        low = ~held & (x < FLOOR)
        if not low.any():
            break
        held |= low
    return np.maximum(x, FLOOR)
