"""Eigenvalues of symmetric matrices that may hold anything: those of absurd scenes overflow, or are beyond LAPACK."""

from __future__ import annotations

import numpy as np

from clothfit.base.arrays import Array


def eigen(H: Array) -> tuple[Array, Array] | None:
    """The eigenvalues (Q,), ascending, and vectors (Q, Q), in columns, of a symmetric matrix; None where it holds what
    is not finite, or the algorithm does not end.
    """
    if not np.isfinite(H).all():
        return None
    try:
        values, vectors = np.linalg.eigh(H)
    except np.linalg.LinAlgError:
        return None
    return values, vectors


def pseudo_inverse(H: Array) -> Array:
    """The inverse (Q, Q) of a symmetric matrix without what is rounding; NaN where it has no eigenvalues."""
    try:
        return np.asarray(np.linalg.pinv(H, hermitian=True), float)
    except np.linalg.LinAlgError:
        return np.full_like(H, np.nan)
