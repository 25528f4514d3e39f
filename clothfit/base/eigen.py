"""Eigenvalues of symmetric matrices that may hold anything: those of absurd scenes overflow, or are beyond LAPACK."""

from __future__ import annotations

import numpy as np

from clothfit.base.arrays import Array
from clothfit.base.graph import independent


def eigen(H: Array) -> tuple[Array, Array] | None:
    """The eigenvalues (Q,), ascending, and vectors (Q, Q), in columns, of a symmetric matrix; None where it holds what
    is not finite, or the algorithm does not end. Parts that share nothing are taken each by itself.
    """
    if not np.isfinite(H).all():
        return None
    parts = independent(H)
    try:
        if len(parts) == 1:
            values, vectors = np.linalg.eigh(H)
            return values, vectors
        values, vectors, first = np.zeros(len(H)), np.zeros(H.shape), 0
        for own in parts:
            place = slice(first, first + len(own))
            values[place], vectors[own, place] = np.linalg.eigh(H[np.ix_(own, own)])
            first += len(own)
    except np.linalg.LinAlgError:
        return None
    order = np.argsort(values, kind="stable")
    return values[order], vectors[:, order]


def pseudo_inverse(H: Array) -> Array:
    """The inverse (Q, Q) of a symmetric matrix without what is rounding; NaN where it has no eigenvalues."""
    try:
        return np.asarray(np.linalg.pinv(H, hermitian=True), float)
    except np.linalg.LinAlgError:
        return np.full_like(H, np.nan)
