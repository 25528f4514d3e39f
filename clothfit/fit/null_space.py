"""Directions in which a sum of squares does not change, whatever the units of its parameters."""

from __future__ import annotations

import numpy as np

from clothfit.base.arrays import Array
from clothfit.optimise.prior import inverse

NULL_EIGENVALUE = 1e-12
"""Eigenvalue of H with a unit diagonal, relative to the largest, below which it is rounding."""


def scaled(H: Array) -> tuple[Array, Array]:
    """H (F, F) with a unit diagonal, and the divisors (F,) of its rows and columns; zeros stay."""
    size = np.sqrt(np.maximum(np.diag(H), 0.0))
    size[size <= NULL_EIGENVALUE * size.max(initial=0.0)] = 0.0
    by = np.where(size > 0, size, 1.0)
    return H / np.outer(by, by) * np.outer(size > 0, size > 0), by


def null_space(H: Array) -> Array:
    """An orthonormal basis (F, ·) of the directions in which H is zero but for rounding."""
    unit, by = scaled(H)
    values, vectors = np.linalg.eigh(unit)
    null = vectors[:, values <= NULL_EIGENVALUE * values.max(initial=0.0)] / by[:, None]
    return np.asarray(np.linalg.qr(null / np.maximum(np.linalg.norm(null, axis=0), np.finfo(float).tiny))[0])


def inverse_beside(H: Array, null: Array) -> Array:
    """The inverse (F, F) of H on the complement of its null space (F, ·)."""
    unit, by = scaled(H)
    basis = null * by[:, None]
    basis = np.linalg.qr(basis)[0]
    K = inverse(unit + basis @ basis.T) / np.outer(by, by)
    across = np.eye(len(H)) - null @ null.T
    return np.asarray(across @ K @ across)
