"""The blocks of contacts in the step's matrix, beside the pattern of the cloth: pairs change from step to step.

A pair with the weights c of its four vertices adds the blocks cᵢ cⱼ B, B = a n nᵀ + ρ (I − n nᵀ): their sum is C. What
of C is on the diagonal is added to the matrix' own as well, so that the preconditioner of the conjugate gradients knows
it; the rest, C without its diagonal, is applied to vectors pair by pair.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from clothfit.base.arrays import Array, Indices, aligned
from clothfit.kernels.kernel import kernel
from clothfit.kernels.lanes.operations import fma, load, load3, mul, splat, spread0, spread1, spread2, store, store3
from clothfit.kernels.vectors import dot

if TYPE_CHECKING:
    from scipy.sparse import coo_array

FREE, NORMAL, PUSH, RUB, WEIGHT, SIZE = 0, 4, 7, 8, 12, 16
"""Places in a row of `Joined`: c of free vertices and 0 of fixed ones, n, a and ρ, c."""


class Joined(NamedTuple):
    """The blocks of P pairs."""

    vertices: Indices  # (P, 4)
    rows: Array  # (P, 16)
    diagonal: Array  # (n + 1, 8), the diagonal of C, as `sparse.BlockMatrix` has its own
    free: Array  # (n,), 1 of free vertices, else 0


def joined(vertices: Indices, free: Array) -> Joined:
    """Memory for the blocks of pairs of these vertices (P, 4)."""
    return Joined(vertices, np.zeros((len(vertices), SIZE)), aligned(len(free) + 1, 8), free)


def is_there(joined: Joined | None) -> bool:
    """Whether there are such blocks at some steps."""
    return joined is not None and len(joined.free) > 0


@kernel
def mixed(c, own, a):
    """Σ cᵢ a_i over the four vertices `own` of an array (n, 3)."""
    total = mul(splat(c[0]), load3(a, own[0]))
    total = fma(splat(c[1]), load3(a, own[1]), total)
    total = fma(splat(c[2]), load3(a, own[2]), total)
    return fma(splat(c[3]), load3(a, own[3]), total)


@kernel
def spread(c, own, v, out):
    """out_i += cᵢ v."""
    store3(fma(splat(c[0]), v, load3(out, own[0])), out, own[0])
    store3(fma(splat(c[1]), v, load3(out, own[1])), out, own[1])
    store3(fma(splat(c[2]), v, load3(out, own[2])), out, own[2])
    store3(fma(splat(c[3]), v, load3(out, own[3])), out, own[3])


@kernel(absent=None)
def reset(joined):
    """Make the diagonal 0."""
    for i in range(len(joined.diagonal)):
        store(splat(0.0), joined.diagonal, i, 0)
        store(splat(0.0), joined.diagonal, i, 4)


@kernel
def keep(joined, k, c, n, push, rub):
    """Write row k."""
    row = joined.rows[k]
    for e in range(4):
        row[WEIGHT + e] = c[e]
        row[FREE + e] = c[e] * joined.free[joined.vertices[k, e]]
    store(n, joined.rows, k, NORMAL)  # and a place more, of what follows
    row[PUSH], row[RUB] = push, rub


@kernel
def block_product(rows, k, z):
    """B z of pair k."""
    n = load(rows, k, NORMAL)  # lane 3 is of no use
    return fma(splat((rows[k, PUSH] - rows[k, RUB]) * dot(n, z)), n, mul(splat(rows[k, RUB]), z))


@kernel(absent=None)
def add_product(joined, scale, x, out):
    """out += scale · (C without its diagonal) x, between free vertices; x, out (n, 3) or (n, 4)."""
    vertices, rows, diagonal, free = joined
    if len(rows) == 0:
        return
    less = splat(-scale)
    for i in range(len(free)):
        if free[i] > 0.0:
            x_i = mul(less, load3(x, i))
            total = fma(load(diagonal, i, 0), spread0(x_i), load3(out, i))
            total = fma(load(diagonal, i, 5), spread1(x_i), total)
            store3(fma(load(diagonal, i, 2), spread2(x_i), total), out, i)
    for k in range(len(rows)):
        # without `mixed` and `spread`, which would then be compiled for cloths without pairs as well
        i0, i1, i2, i3 = vertices[k, 0], vertices[k, 1], vertices[k, 2], vertices[k, 3]
        c0, c1, c2, c3 = splat(rows[k, 0]), splat(rows[k, 1]), splat(rows[k, 2]), splat(rows[k, 3])
        z = fma(c1, load3(x, i1), mul(c0, load3(x, i0)))
        z = fma(c3, load3(x, i3), fma(c2, load3(x, i2), z))
        z = mul(splat(scale), block_product(rows, k, z))
        store3(fma(c0, z, load3(out, i0)), out, i0)
        store3(fma(c1, z, load3(out, i1)), out, i1)
        store3(fma(c2, z, load3(out, i2)), out, i2)
        store3(fma(c3, z, load3(out, i3)), out, i3)


@kernel(absent=None)
def add_across(joined, scale, x, to_fixed, out):
    """out += scale · the blocks that join free vertices to fixed ones, times the x (n, 3) of these, or where it goes
    `to_fixed` the transposed ones times that of the free.
    """
    for k in range(len(joined.rows)):
        own, c, f = joined.vertices[k], joined.rows[k, WEIGHT:], joined.rows[k, FREE:]
        free, fixed = (f[0], f[1], f[2], f[3]), (c[0] - f[0], c[1] - f[1], c[2] - f[2], c[3] - f[3])
        of, to = (free, fixed) if to_fixed else (fixed, free)
        spread(to, own, mul(splat(scale), block_product(joined.rows, k, mixed(of, own, x))), out)


def to_scipy(vertices: Indices, rows: Array, order: Indices) -> coo_array:
    """The blocks off the diagonal as a SciPy sparse array (3 m, 3 m), of the m free vertices in ascending order."""
    from scipy.sparse import coo_array

    m, free = len(order), np.sort(order)
    place = np.full(max(int(vertices.max(initial=0)), int(free.max(initial=0))) + 1, -1)
    place[free] = np.arange(m)
    n = rows[:, NORMAL : NORMAL + 3]
    push, rub = rows[:, PUSH, None, None], rows[:, RUB, None, None]
    B = (push - rub) * n[:, :, None] * n[:, None, :] + rub * np.eye(3)
    data, row, column = [np.zeros(0)], [np.zeros(0, int)], [np.zeros(0, int)]
    for i, j in ((i, j) for i in range(4) for j in range(4) if i != j):
        at, to = place[vertices[:, i]], place[vertices[:, j]]
        both = (at >= 0) & (to >= 0)
        data.append(((rows[:, WEIGHT + i] * rows[:, WEIGHT + j])[:, None, None] * B)[both].ravel())
        row.append(np.repeat(3 * at[both, None] + np.arange(3), 3, axis=1).ravel())
        column.append(np.tile(3 * to[both, None] + np.arange(3), (1, 3)).ravel())
    entries = np.concatenate(data), (np.concatenate(row), np.concatenate(column))
    return coo_array(entries, shape=(3 * m, 3 * m))
