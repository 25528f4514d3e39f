"""Symmetric 3×3-block sparse matrix of a cloth: the pattern is built once, the values are scattered at each step.

Only free vertices have rows. They stand in an order of sweep; row r, of vertex order[r], owns the blocks that join it
to vertices later in the order, and the other half is their mirror image. Every block of the cloth is itself symmetric
(a spring acts along and across one axis), so its eight numbers

    xx xy xz yz | zz xy yy yz

hold the columns x, y, z as the triples that begin at 0, 5 and 2, each one vector load; what a load finds in its fourth
lane is cleared where it would matter. A block is a cache line, and a small cloth's matrix stays in the fastest
caches. Blocks that join fixed vertices go to one last slot, which no row reads.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from clothfit.base.arrays import Array, Flags, Indices, aligned
from clothfit.kernels.kernel import kernel
from clothfit.kernels.lanes.operations import (
    add,
    column,
    fma,
    index,
    load3,
    mul,
    splat,
    spread0,
    spread1,
    spread2,
    spread4,
    store3,
    store_column,
    sub,
    xxxy,
    xyzz,
    zxyy,
    zyyz,
)

if TYPE_CHECKING:
    from scipy.sparse import csc_array

XX, XY, XZ, YZ, ZZ, YY = 0, 1, 2, 3, 4, 6
"""Places in a block; xy and yz stand a second time behind zz and yy."""

SQUARE = [[XX, XY, XZ], [XY, YY, YZ], [XZ, YZ, ZZ]]
BLOCK_SIZE = 8

MULTIGRID_FROM = 3000
"""Free vertices from which multigrid beats SSOR, measured between grids of 40² and 64²."""


NOTHING: Indices = np.zeros((0, 2), np.int32)

SIDES = [[0, 1], [0, 2], [0, 3], [1, 2], [1, 3], [2, 3]]
"""Which vertices of a pair its blocks join."""


class BlockMatrix(NamedTuple):
    """A x for x (n, 3); m free vertices, E blocks between them."""

    order: Indices  # (m,), the free vertices in the order of sweep
    row: Indices  # (m + 1,), row r owns the slots row[r] … row[r + 1] − 1
    column: Indices  # (E,), vertex of each slot, later in the order than the row's
    subdomains: Indices  # (3, 2), first row and end of each subdomain; no spring joins the first two
    diagonal: Array  # (n + 1, 8), diagonal blocks; the last is only read into by loads of the one before
    upper: Array  # (E + X + 1, 8), blocks of the slots and of `across`; the last takes what belongs to neither
    across: Indices | None = None  # (X, 2), a free and a fixed vertex that touch; None on levels of `multigrid`


class Pattern(NamedTuple):
    """Where the blocks of a matrix are; see BlockMatrix."""

    order: Indices
    row: Indices
    column: Indices
    subdomains: Indices


def pattern(ends: Indices, free: Flags, whole: bool = False) -> tuple[Pattern, Indices]:
    """The pattern, and the slot of each pair, for the vertex pairs `ends` (S, 2) that are joined.

    Pairs that join the same two vertices share a slot; pairs with a fixed vertex get the slot that no row reads. A
    `whole` pattern has one subdomain, however large it is.
    """
    order, subdomains = sweep(ends, free, whole)
    place = np.zeros(len(free), np.int64)
    place[order] = np.arange(len(order))
    kept = free[ends].all(axis=1)
    rank = np.sort(place[ends[kept]], axis=1)
    m = len(order)
    keys, inverse = np.unique(rank[:, 0] * m + rank[:, 1], return_inverse=True)
    row = np.searchsorted(keys, np.arange(m + 1, dtype=np.int64) * m)
    slot = np.full(len(ends), len(keys), np.int32)
    slot[kept] = inverse
    column = order[keys % m] if m else keys
    return Pattern(order, row.astype(np.int32), column.astype(np.int32), subdomains), slot


def sweep(ends: Indices, free: Flags, whole: bool = False) -> tuple[Indices, Indices]:
    """The order of sweep (m,) and its subdomains (3, 2): two that are not joined, and the separator between them.

    A small cloth is swept in the order of its vertices and is one subdomain. A large one is swept along its bandwidth
    where the vertices' own order jumps about: each row then works on what the last ones left in the caches. Its halves
    are the first two subdomains, but for the vertices of the second half that are joined to the first: the separator.
    """
    order = np.flatnonzero(free).astype(np.int32)
    m = len(order)
    if m < MULTIGRID_FROM:
        return order, np.array([[0, m], [m, m], [m, m]], np.int32)
    place = np.full(len(free), -1)
    place[order] = np.arange(m)
    edges = place[ends[free[ends].all(axis=1)]]
    along = along_bandwidth(edges, m)
    order, edges = order[along], np.argsort(along)[edges]
    if whole:
        return order, np.array([[0, m], [m, m], [m, m]], np.int32)
    first = (edges < m // 2).any(axis=1)
    between = np.zeros(m, bool)
    between[edges[first].max(axis=1)] = True
    between[: m // 2] = False
    separator = np.flatnonzero(between)
    rest = np.flatnonzero(~between)
    middle, end = m // 2, m - len(separator)
    return order[np.concatenate([rest, separator])], np.array([[0, middle], [middle, end], [end, m]], np.int32)


def along_bandwidth(edges: Indices, m: int) -> Indices:
    """An order (m,) in which joined vertices are near: their own, or reverse Cuthill–McKee where that is far better."""
    from scipy.sparse import csr_array
    from scipy.sparse.csgraph import reverse_cuthill_mckee

    ones = np.ones(2 * len(edges))
    both_ways = (np.concatenate([edges[:, 0], edges[:, 1]]), np.concatenate([edges[:, 1], edges[:, 0]]))
    better = reverse_cuthill_mckee(csr_array((ones, both_ways), shape=(m, m)), symmetric_mode=True)
    distance = np.abs(edges[:, 0] - edges[:, 1]).sum()
    after = np.argsort(better)[edges]
    jumps = distance > 2.0 * np.abs(after[:, 0] - after[:, 1]).sum()
    return np.asarray(better, np.int32) if jumps else np.arange(m, dtype=np.int32)


def zeros(pattern: Pattern, n: int, across: Indices = NOTHING) -> BlockMatrix:
    """A matrix of that pattern for n vertices, all zero, with blocks between these (X, 2) as well."""
    blocks = aligned(n + 1, BLOCK_SIZE), aligned(len(pattern.column) + len(across) + 1, BLOCK_SIZE)
    return BlockMatrix(*pattern, *blocks, across)


def joined(A: BlockMatrix, vertices: Indices, free: Flags) -> tuple[BlockMatrix, Indices, Indices]:
    """A matrix with the blocks between the vertices (P, 4) of pairs as well, all zero, the slot there of each slot
    (E + 1,) of A, and the places (P, 6) of the pairs' blocks; `free` (n,).
    """
    own = np.stack([np.repeat(A.order, np.diff(A.row)), A.column], axis=1)
    ends = np.concatenate([own, vertices[:, SIDES].reshape(-1, 2)])
    found, slot = pattern(ends, free)
    count, between = len(found.column), np.flatnonzero(free[ends].sum(axis=1) == 1)
    slot[between] = count + np.arange(len(between))
    slot[~free[ends].any(axis=1)] = last = count + len(between)
    across = np.where(free[ends[between, :1]], ends[between], ends[between, ::-1])
    return zeros(found, len(free), across), np.append(slot[: len(own)], np.int32(last)), slot[len(own) :].reshape(-1, 6)


@kernel
def add_across(A, x, to_fixed, out):
    """out −= the blocks that join free vertices to fixed ones which they touch, times the x (n, 3) of these, or where
    it goes `to_fixed`, times that of the free.
    """
    for k in range(len(A.across)):
        i, j = A.across[k, 0], A.across[k, 1]
        to, of = (j, i) if to_fixed else (i, j)
        push = times(A.upper, len(A.column) + k, load3(x, of), splat(0.0))
        store3(sub(load3(out, to), push), out, to)


@kernel
def reset(A, mass):
    """A = the masses (n,) on the diagonal."""
    zero = splat(0.0)
    for e in range(len(A.upper)):
        store_column(zero, A.upper, e, 0)
        store_column(zero, A.upper, e, 4)
    for i in range(len(mass)):
        store_column(zero, A.diagonal, i, 0)
        store_column(zero, A.diagonal, i, 4)
        A.diagonal[i, XX] = A.diagonal[i, YY] = A.diagonal[i, ZZ] = mass[i]


@kernel
def add_block(blocks, i, low, high):
    """Add to block i its two halves."""
    store_column(add(column(blocks, i, 0), low), blocks, i, 0)
    store_column(add(column(blocks, i, 4), high), blocks, i, 4)


@kernel
def subtract_block(blocks, i, low, high):
    """Subtract from block i its two halves."""
    store_column(sub(column(blocks, i, 0), low), blocks, i, 0)
    store_column(sub(column(blocks, i, 4), high), blocks, i, 4)


@kernel
def outer(p, q):
    """The halves of the block p qᵀ, for p along q."""
    return mul(xxxy(p), xyzz(q)), mul(zxyy(p), zyyz(q))


@kernel
def spread(x):
    """Each component of a vector in all lanes, for several products with it."""
    return spread0(x), spread1(x), spread2(x)


@kernel
def times_spread(blocks, i, x, total):
    """total + B x for block i and a vector that is `spread`; lane 3 is of no use."""
    total = fma(column(blocks, i, 0), x[0], total)
    total = fma(column(blocks, i, 5), x[1], total)
    return fma(column(blocks, i, 2), x[2], total)


@kernel
def times(blocks, i, x, total):
    """total + B x for block i; lane 3 is of no use."""
    return times_spread(blocks, i, spread(x), total)


@kernel
def times_row(blocks, i, x, j, sums):
    """Three sums, to be added up, with B x_j more, for block i and row j of x (m, 4); lane 3 is of no use. Each product
    would wait for the last in one.
    """
    a = fma(column(blocks, i, 0), spread4(x, j, 0), sums[0])
    b = fma(column(blocks, i, 5), spread4(x, j, 1), sums[1])
    return a, b, fma(column(blocks, i, 2), spread4(x, j, 2), sums[2])


@kernel
def added(sums):
    """The three together."""
    return add(add(sums[0], sums[1]), sums[2])


@kernel
def multiply(A, x, out):
    """out = A x for x, out (n, 3), zero at fixed vertices. Each stored block serves its row and its column."""
    out[:] = 0.0
    for r in range(len(A.order)):
        i = A.order[r]
        x_i = load3(x, i)
        wide = spread(x_i)
        total = times_spread(A.diagonal, i, wide, load3(out, i))
        for e in range(A.row[r], A.row[r + 1]):
            j = index(A.column, e)
            total = times(A.upper, e, load3(x, j), total)
            store3(times_spread(A.upper, e, wide, load3(out, j)), out, j)
        store3(total, out, i)


@kernel
def invert_diagonal(A, scale, inverse):
    """scale · the inverses of the diagonal blocks (n + 1, 8); False when a block is not positive definite."""
    definite = True
    for r in range(len(A.order)):
        definite = invert_block(A.diagonal, A.order[r], scale, inverse) and definite
    return definite


@kernel
def invert_block(blocks, i, scale, inverse):
    """Block i of `inverse` = scale · the inverse of block i; False when that is not positive definite."""
    xx, xy, xz = float(blocks[i, XX]), float(blocks[i, XY]), float(blocks[i, XZ])
    yy, yz, zz = float(blocks[i, YY]), float(blocks[i, YZ]), float(blocks[i, ZZ])
    c0, c1, c2 = yy * zz - yz * yz, xz * yz - xy * zz, xy * yz - xz * yy
    minor = xx * yy - xy * xy
    determinant = xx * c0 + xy * c1 + xz * c2
    factor = scale / determinant
    inverse[i, XX] = c0 * factor
    inverse[i, XY] = inverse[i, XY + 4] = c1 * factor
    inverse[i, XZ] = c2 * factor
    inverse[i, YZ] = inverse[i, YZ + 4] = (xy * xz - xx * yz) * factor
    inverse[i, ZZ] = minor * factor
    inverse[i, YY] = (xx * zz - xz * xz) * factor
    return xx > 0.0 and minor > 0.0 and determinant > 0.0


def to_scipy(
    order: Indices, row: Indices, column: Indices, _subdomains: Indices, diagonal: Array, upper: Array, *_: Any,
) -> csc_array:  # fmt: skip
    """The matrix as a SciPy sparse array (3 m, 3 m), both halves: of the free vertices, in ascending order."""
    from scipy.sparse import bsr_array

    m, place = len(order), np.zeros(len(diagonal), np.int32)
    place[np.sort(order)] = np.arange(m)
    own, above, beside = place[order], place[np.repeat(order, np.diff(row))], place[column]
    rows, columns = np.concatenate([own, above, beside]), np.concatenate([own, beside, above])
    sorting = np.lexsort((columns, rows))
    upper = upper[: len(column)]
    blocks = np.concatenate([diagonal[order], upper, upper])[sorting][:, SQUARE]
    starts = np.searchsorted(rows[sorting], np.arange(m + 1))
    return bsr_array((blocks, columns[sorting], starts), shape=(3 * m, 3 * m)).tocsr().T  # it is symmetric


def places(A: BlockMatrix) -> csc_array:
    """The same matrix of the places of its numbers in those of its arrays: any A of the pattern has them there."""
    own, n = np.arange(8.0 * (len(A.diagonal) + len(A.upper))).reshape(-1, 8), len(A.diagonal)
    return to_scipy(*A._replace(diagonal=own[:n], upper=own[n:])).astype(np.intp)
