"""A first path through the keys, and how strongly springs hold a cloth near it.

A displacement from the motion without control goes through the keys: by a cubic spline in time from rest, and over the
cloth so that vertices without a key lie between those with one (the discrete harmonic function).
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from clothfit.base.arrays import Array, Flags, Indices
from clothfit.control.keyframes import Key
from clothfit.engine.inputs.interpolation import splined


def path(free: Array, keys: Sequence[Key], springs: Indices, fixed: Flags) -> Array:
    """A path (T + 1, n, 3), m, through the keys, T the last of them, from the motion `free` (T + 1, n, 3)."""
    wanted: dict[int, tuple[Array, Flags]] = {}
    for key in keys:
        away, known = wanted.setdefault(key.step, (np.zeros_like(free[0]), np.zeros(len(fixed), bool)))
        if key.share is None:
            away[key.vertices] = key.positions - free[key.step, key.vertices]
        else:
            more = key.positions[0] - key.share @ free[key.step, key.vertices]
            away[key.vertices] = np.where(known[key.vertices, None], away[key.vertices], more)
        known[key.vertices] = True
    steps = sorted(wanted)
    rows = [np.zeros_like(free[0])]
    for step in steps:
        away, known = wanted[step]
        away[fixed & ~known] = 0.0
        rows.append(harmonic(away, known | fixed, springs))
    times = np.array([0, *steps], float)
    found = splined(times, np.array(rows), "keys")(np.arange(len(free)))
    moved: Array = free + found
    moved[:, fixed] = free[:, fixed]
    return moved


def harmonic(values: Array, known: Flags, springs: Indices) -> Array:
    """Values (n, 3) where they are known, and means of their neighbours elsewhere."""
    from scipy.sparse import csr_array, diags_array
    from scipy.sparse.linalg import splu

    n = len(values)
    ends = np.concatenate([springs, springs[:, ::-1]])
    graph = csr_array((np.ones(len(ends)), (ends[:, 0], ends[:, 1])), shape=(n, n))
    laplacian = csr_array(diags_array(graph.sum(axis=1) + 1e-9) - graph)  # vertices without springs get 0
    open_ = np.flatnonzero(~known)
    if not len(open_):
        return values
    right = graph[open_][:, np.flatnonzero(known)] @ values[known]
    found = values.copy()
    found[open_] = splu(laplacian[open_][:, open_].tocsc()).solve(np.asarray(right))
    return found
