"""Normals straight from the coordinates, by linear regression: n ≈ N (1, q), a product like that of the positions.

The exact ones need the faces around every vertex (`frames`); these need nothing but the coordinates, so that a graph, a
shader, or one product for many instances gives them. N minimises Σ |N (1, q) − n|² over frames of the recorded motions,
n the exact normals of the full cloth, weighted by the areas of the faces. Its columns are found with the coordinates
scaled to a variance of 1 and a ridge that holds those back that the frames hardly show.

D. Holden et al., Subspace Neural Physics, SCA 2019, section 4.4.
"""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np
from numpy.typing import NDArray

from clothfit.base.arrays import Array, Indices
from clothfit.subspace.frames import fill_normals

RIDGE = 1e-6
"""Of the scaled coordinates, relative to the number of frames."""

MOST_FRAMES = 800
"""That the regression sees, spread over all motions."""


def regression(frames: Iterable[tuple[Array, Array]], triangles: Indices) -> NDArray[np.float32]:
    """N (n, 3, 1 + r) from coordinates (F, r) and positions (F, n, 3), part by part, for faces (T, 3)."""
    faces = np.ascontiguousarray(triangles, np.int32)
    gram, onto, count = np.zeros(0), np.zeros(0), 0
    for q, x in frames:
        known = np.column_stack([np.ones(len(q)), q])
        if not count:
            gram, onto = np.zeros((known.shape[1],) * 2), np.zeros((known.shape[1], x[0].size))
        normals = np.empty(x.shape, np.float32)
        for each, out in zip(x, normals, strict=True):
            fill_normals(faces, np.ascontiguousarray(each, np.float32), out)
        gram += known.T @ known
        onto += known.T @ normals.reshape(len(q), -1)
        count += len(q)
    scale = np.sqrt(np.maximum(np.diag(gram) / max(count, 1), 1e-300))
    ridge = np.full(len(scale), RIDGE * count)
    ridge[0] = 0.0
    found = np.linalg.solve(gram / np.outer(scale, scale) + np.diag(ridge), onto / scale[:, None]) / scale[:, None]
    return np.ascontiguousarray(found.T.reshape(-1, 3, len(scale)), np.float32)


def angles(a: NDArray[np.floating], b: NDArray[np.floating]) -> Array:
    """The angles (…), degrees, between unit vectors (…, 3); NaN where one of them is 0, as there are no faces."""
    with np.errstate(invalid="ignore"):
        gap, both = np.linalg.norm(a - b, axis=-1), np.linalg.norm(a + b, axis=-1)
        none = (np.abs(a).sum(axis=-1) == 0.0) | (np.abs(b).sum(axis=-1) == 0.0)
    return np.where(none, np.nan, np.degrees(2.0 * np.arctan2(gap, both)))
