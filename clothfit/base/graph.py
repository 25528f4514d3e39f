"""Which nodes of a graph are connected: in NumPy alone, as SciPy's graphs take long to import."""

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
