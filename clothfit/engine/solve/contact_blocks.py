"""The blocks of contacts in the step's matrix, beside the pattern of the cloth: pairs change from step to step.

A pair with the weights c of its four vertices adds the blocks cᵢ cⱼ B, B = a n nᵀ + ρ (I − n nᵀ): their sum is C. What
of C is on the diagonal is in the matrix' own, so that the preconditioner of the conjugate gradients knows it; the rest,
C without its diagonal, is applied to vectors pair by pair.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from clothfit.base.arrays import Array, Indices
from clothfit.kernels.kernel import kernel
from clothfit.kernels.lanes.operations import add, fma, load, load3, mul, splat, store, store3, sub
from clothfit.kernels.vectors import dot

if TYPE_CHECKING:
    from scipy.sparse import coo_array

FREE, NORMAL, PUSH, RUB, WEIGHT, SIZE = 0, 4, 7, 8, 12, 16
"""Places in a row of `ContactBlocks`: c of free vertices and 0 of fixed ones, n, a and ρ, c."""


class ContactBlocks(NamedTuple):
    """The blocks of P pairs."""

    vertices: Indices  # (P, 4)
    rows: Array  # (P, 16)
    free: Array  # (n,), 1 of free vertices, else 0


def no_blocks(vertices: Indices, free: Array) -> ContactBlocks:
    """Memory for the blocks of pairs of these vertices (P, 4)."""
    return ContactBlocks(vertices, np.zeros((len(vertices), SIZE)), free)


def is_there(blocks: ContactBlocks | None) -> bool:
    """Whether there are such blocks at some steps."""
    return blocks is not None and len(blocks.free) > 0


@kernel(absent=None)
def clear(blocks):
    """No pair adds anything."""
    for k in range(len(blocks.rows)):
        blocks.rows[k, PUSH] = blocks.rows[k, RUB] = 0.0


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


@kernel
def keep(blocks, k, c, n, push, rub):
    """Write row k."""
    row = blocks.rows[k]
    for e in range(4):
        row[WEIGHT + e] = c[e]
        row[FREE + e] = c[e] * blocks.free[blocks.vertices[k, e]]
    store(n, blocks.rows, k, NORMAL)  # and a place more, of what follows
    row[PUSH], row[RUB] = push, rub


@kernel
def block_product(rows, k, z):
    """B z of pair k."""
    n = load(rows, k, NORMAL)  # lane 3 is of no use
    return fma(splat((rows[k, PUSH] - rows[k, RUB]) * dot(n, z)), n, mul(splat(rows[k, RUB]), z))


@kernel(absent=0.0)
def add_product(blocks, scale, x, out):
    """out += scale · (C without its diagonal) x, between free vertices; x, out (n, 3) or (n, 4). Returns what is added
    times x.
    """
    total = 0.0
    for k in range(len(blocks.rows)):
        if blocks.rows[k, PUSH] != 0.0:
            total += scale * add_row(blocks.vertices[k], blocks.rows, k, scale, x, out)
    return total


@kernel
def add_row(own, rows, k, scale, x, out):
    """What pair k adds; returns it times x, for a scale of 1."""
    # without `mixed` and `spread`, which would then be compiled for cloths without pairs as well
    x0, x1 = mul(splat(rows[k, 0]), load3(x, own[0])), mul(splat(rows[k, 1]), load3(x, own[1]))
    x2, x3 = mul(splat(rows[k, 2]), load3(x, own[2])), mul(splat(rows[k, 3]), load3(x, own[3]))
    z = add(add(x0, x1), add(x2, x3))
    total = add_end(own[0], rows, k, 0, scale, z, x0, out) + add_end(own[1], rows, k, 1, scale, z, x1, out)
    return total + add_end(own[2], rows, k, 2, scale, z, x2, out) + add_end(own[3], rows, k, 3, scale, z, x3, out)


@kernel
def add_end(i, rows, k, e, scale, z, own, out):
    """The same at vertex i, number e of the pair, whose part of z is `own`."""
    push = block_product(rows, k, sub(z, own))
    store3(fma(splat(scale * rows[k, e]), push, load3(out, i)), out, i)
    return dot(own, push)


@kernel(absent=None)
def add_across(blocks, scale, x, to_fixed, out):
    """out += scale · the blocks that join free vertices to fixed ones, times the x (n, 3) of these, or where it goes
    `to_fixed` the transposed ones times that of the free.
    """
    for k in range(len(blocks.rows)):
        own, c, f = blocks.vertices[k], blocks.rows[k, WEIGHT:], blocks.rows[k, FREE:]
        free, fixed = (f[0], f[1], f[2], f[3]), (c[0] - f[0], c[1] - f[1], c[2] - f[2], c[3] - f[3])
        of, to = (free, fixed) if to_fixed else (fixed, free)
        spread(to, own, mul(splat(scale), block_product(blocks.rows, k, mixed(of, own, x))), out)


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
