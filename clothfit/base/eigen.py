"""Symmetric matrices in NumPy alone, as SciPy takes long to import: which of their rows are connected, and eigenvalues
where they may hold anything. Those of absurd scenes overflow, or are beyond LAPACK.
"""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from clothfit.base.arrays import Array


def connected_components(pairs: npt.NDArray[np.integer], n: int) -> npt.NDArray[np.intp]:
    """The number (n,) of the piece of each of n nodes that pairs (P, 2) connect; pieces are numbered by their first
    nodes.

    Every node points to a lower one of its piece, or to itself. In turn, the ends of each pair let what they point to
    point to the lower of both, and every node then points to what its own points to, until nothing changes.
    """
    lowest = np.arange(n)
    a, b = pairs[:, 0], pairs[:, 1]
    while True:
        left, right = lowest[a], lowest[b]
        apart = left != right
        if not apart.any():
            return np.asarray(np.unique(lowest, return_inverse=True)[1], np.intp)
        a, b, left, right = a[apart], b[apart], left[apart], right[apart]
        np.minimum.at(lowest, np.maximum(left, right), np.minimum(left, right))
        while not np.array_equal(further := lowest[lowest], lowest):
            lowest = further


def independent(H: Array) -> list[npt.NDArray[np.intp]]:
    """The coordinates of the parts of a symmetric H (Q, Q) between which it is 0; at least one part."""
    left, found = np.ones(len(H), bool), list[npt.NDArray[np.intp]]()
    while left.any() or not found:
        own = np.zeros(len(H), bool)
        new = np.flatnonzero(left)[:1]
        while len(new):
            own[new] = True
            new = np.flatnonzero((H[new] != 0).any(axis=0) & ~own)
        found.append(np.flatnonzero(own))
        left &= ~own
    return found


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
