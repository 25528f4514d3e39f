"""What contacts between free and fixed vertices add to a step: blocks of the matrix that no row of it has.

A pair with the weights c of its four vertices adds the blocks cᵢ cⱼ B, B = a n nᵀ + ρ (I − n nᵀ). Those between free
vertices are in the matrix (`sparse.joined`); here is what is left, pair by pair.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from clothfit.base.arrays import Array, Indices
from clothfit.kernels.kernel import kernel
from clothfit.kernels.lanes.operations import fma, load, load3, mul, splat, store, store3
from clothfit.kernels.vectors import dot

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
