"""Faces of a cloth in the air: what both laws of the air work with.

The corners of a face are a, b, c, its edges p = y_b − y_a and q = y_c − y_a, and n = p × q, as long as twice its area.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from clothfit.base.arrays import Array, Indices
from clothfit.engine.solve.sparse import add_block
from clothfit.kernels.fours import four_of, halves, of_four
from clothfit.kernels.kernel import kernel
from clothfit.kernels.lanes.operations import add, fma, index3, load3, mul, splat, store3, sub
from clothfit.kernels.vectors import cross, item, vector


class Faces(NamedTuple):
    """Constants of the faces of one cloth that feel the air."""

    corners: Indices  # (T, 3), the vertices a, b, c; no rows where the air does nothing
    drag: Array  # drag coefficient of each object, (K,), kg/(m⁶ s); of the law "air" without unit
    wind: Array  # W, (3,), m/s
    quadratic: bool  # whether the law is that of `air`, not that of `wind`
    object: Indices | None = None  # (T,), the object of each face; None: there is one


def build(
    triangles: Indices, drag: Array, wind: Array, fitted: bool = False, quadratic: bool = False,
    owner: Indices | None = None,
) -> Faces:  # fmt: skip
    """The faces of objects with drag coefficients (K,), and whose they are (T,) where there are several; none of them
    where all coefficients are 0 and not `fitted`: no pass over them is ever made.
    """
    kept = slice(None if fitted or drag.any() else 0)
    corners = np.ascontiguousarray(triangles[kept])
    return Faces(corners, drag, np.array(wind, float), quadratic, owner if owner is None else owner[kept])


@kernel
def drag_of(faces, i):
    """The drag coefficient of face i."""
    return faces.drag[item(faces.object, i)]


@kernel
def at(x, faces, i):
    """The rows of x (n, 3) of the corners of face i."""
    return load3(x, faces.corners[i, 0]), load3(x, faces.corners[i, 1]), load3(x, faces.corners[i, 2])


@kernel
def edges(faces, y, i):
    """p and q of face i."""
    a, b, c = at(y, faces, i)
    return sub(b, a), sub(c, a)


@kernel
def mean(faces, u, i):
    """ū, the mean over the corners of face i."""
    a, b, c = at(u, faces, i)
    return mul(splat(1.0 / 3.0), add(add(a, b), c))


@kernel
def relative(faces, u, i):
    """W − ū of face i."""
    return sub(vector(faces.wind), mean(faces, u, i))


@kernel
def add_along(out, i, scale, n):
    """out_i += scale · n."""
    store3(fma(splat(scale), n, load3(out, i)), out, i)


@kernel
def add_by_normal(gy, faces, y, i, g):
    """gy += the gradient by the corners of face i, where g is that by n."""
    p, q = edges(faces, y, i)
    by_b, by_c = cross(q, g), cross(g, p)  # g·(dp × q) = dp·(q × g) and g·(p × dq) = dq·(g × p)
    add_along(gy, faces.corners[i, 1], 1.0, by_b)
    add_along(gy, faces.corners[i, 2], 1.0, by_c)
    add_along(gy, faces.corners[i, 0], -1.0, add(by_b, by_c))


@kernel
def fours(x, faces, i, end, corner):
    """The rows of x (n, 3) of one corner of up to four faces from i, before `end`."""
    p, q = load3(x, index3(faces.corners, i, corner)), load3(x, index3(faces.corners, min(i + 1, end - 1), corner))
    r, s = index3(faces.corners, min(i + 2, end - 1), corner), index3(faces.corners, min(i + 3, end - 1), corner)
    return of_four(p, q, load3(x, r), load3(x, s))


@kernel
def all_fours(x, faces, i, end):
    """The same for all three corners."""
    return fours(x, faces, i, end, 0), fours(x, faces, i, end, 1), fours(x, faces, i, end, 2)


@kernel
def add_fours(out, faces, i, end, corner, v):
    """Add vectors to the rows of one corner of up to four faces from i, before `end`."""
    p, q, r, s = four_of(v, splat(0.0))
    add_along(out, index3(faces.corners, i, corner), 1.0, p)
    if i + 1 < end:
        add_along(out, index3(faces.corners, i + 1, corner), 1.0, q)
    if i + 2 < end:
        add_along(out, index3(faces.corners, i + 2, corner), 1.0, r)
    if i + 3 < end:
        add_along(out, index3(faces.corners, i + 3, corner), 1.0, s)


@kernel
def add_blocks(A, faces, i, end, six):
    """Add the blocks of up to four faces from i, before `end`, to the diagonal at each corner; see `fours.blocks`."""
    p, q, r, s = halves(six)
    add_at_corners(A, faces, i, p)
    if i + 1 < end:
        add_at_corners(A, faces, i + 1, q)
    if i + 2 < end:
        add_at_corners(A, faces, i + 2, r)
    if i + 3 < end:
        add_at_corners(A, faces, i + 3, s)


@kernel
def add_at_corners(A, faces, i, own):
    """Add a block, given in two halves, to the diagonal at the corners of face i."""
    for corner in range(3):
        add_block(A.diagonal, index3(faces.corners, i, corner), own[0], own[1])


@kernel
def change_of_normal(faces, y, dy, i):
    """dn of face i along dy."""
    (p, q), (dp, dq) = edges(faces, y, i), edges(faces, dy, i)
    return add(cross(dp, q), cross(p, dq))
