"""Symmetric 3×3-block sparse matrix of a cloth: the pattern is built once, the values are scattered at each step.

Row i holds the diagonal block of vertex i and the blocks (i, j) with j > i; the lower half is the mirror image. Every
block of the cloth is itself symmetric (a spring acts along and across one axis), so a block is its six upper
numbers xx xy xz yy yz zz: a third of the memory that full storage takes, which keeps a small cloth in the
fastest cache. Rows and columns of fixed vertices are left out: the blocks that would join them go to one last
slot, which no row reads.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from clothfit.arrays import Array, Flags, Indices
from clothfit.kernel import kernel

if TYPE_CHECKING:
    from scipy.sparse import csc_array


class BlockMatrix(NamedTuple):
    """A x for x (n, 3); E blocks above the diagonal."""

    row: Indices  # (n + 1,), row i owns the slots row[i] … row[i + 1] − 1
    column: Indices  # (E,), column of each slot, ascending within a row
    diagonal: Array  # (n, 6), diagonal blocks
    upper: Array  # (E + 1, 6), blocks above the diagonal; the last takes what belongs to no row


def pattern(ends: Indices, free: Flags) -> tuple[Indices, Indices, Indices]:
    """Row starts, columns and the slot of each pair, for the vertex pairs `ends` (S, 2) that are joined.

    Pairs that join the same two vertices share a slot; pairs with a fixed vertex get the slot that no row reads.
    """
    low, high = ends.min(axis=1).astype(np.int64), ends.max(axis=1).astype(np.int64)
    kept = free[low] & free[high]
    n = len(free)
    keys, inverse = np.unique(low[kept] * n + high[kept], return_inverse=True)
    row = np.searchsorted(keys, np.arange(n + 1, dtype=np.int64) * n)
    slot = np.full(len(ends), len(keys), np.int32)
    slot[kept] = inverse
    return row.astype(np.int32), (keys % n).astype(np.int32), slot


def zeros(row: Indices, column: Indices) -> BlockMatrix:
    """A matrix of that pattern, all zero."""
    return BlockMatrix(row, column, np.zeros((len(row) - 1, 6)), np.zeros((len(column) + 1, 6)))


@kernel
def add_outer(diagonal, i, scale, n0, n1, n2):
    """Add scale · n nᵀ to the diagonal block of vertex i."""
    diagonal[i, 0] += scale * n0 * n0
    diagonal[i, 1] += scale * n0 * n1
    diagonal[i, 2] += scale * n0 * n2
    diagonal[i, 3] += scale * n1 * n1
    diagonal[i, 4] += scale * n1 * n2
    diagonal[i, 5] += scale * n2 * n2


@kernel
def multiply(A, x, out):
    """out = A x. Each stored block serves its row and, mirrored, its column."""
    diagonal, upper, row, column = A.diagonal, A.upper, A.row, A.column
    n = len(diagonal)
    for i in range(n):
        x0, x1, x2 = x[i, 0], x[i, 1], x[i, 2]
        out[i, 0] = diagonal[i, 0] * x0 + diagonal[i, 1] * x1 + diagonal[i, 2] * x2
        out[i, 1] = diagonal[i, 1] * x0 + diagonal[i, 3] * x1 + diagonal[i, 4] * x2
        out[i, 2] = diagonal[i, 2] * x0 + diagonal[i, 4] * x1 + diagonal[i, 5] * x2
    for i in range(n):
        x0, x1, x2 = x[i, 0], x[i, 1], x[i, 2]
        s0, s1, s2 = 0.0, 0.0, 0.0
        for e in range(row[i], row[i + 1]):
            j = column[e]
            xx, xy, xz, yy, yz, zz = upper[e, 0], upper[e, 1], upper[e, 2], upper[e, 3], upper[e, 4], upper[e, 5]
            z0, z1, z2 = x[j, 0], x[j, 1], x[j, 2]
            s0 += xx * z0 + xy * z1 + xz * z2
            s1 += xy * z0 + yy * z1 + yz * z2
            s2 += xz * z0 + yz * z1 + zz * z2
            out[j, 0] += xx * x0 + xy * x1 + xz * x2
            out[j, 1] += xy * x0 + yy * x1 + yz * x2
            out[j, 2] += xz * x0 + yz * x1 + zz * x2
        out[i, 0] += s0
        out[i, 1] += s1
        out[i, 2] += s2


@kernel
def invert_diagonal(A, free, inverse):
    """Inverses of the diagonal blocks (n, 6), zero for fixed vertices; False when a block is not positive definite."""
    definite = True
    for i in range(len(free)):
        xx, xy, xz = A.diagonal[i, 0], A.diagonal[i, 1], A.diagonal[i, 2]
        yy, yz, zz = A.diagonal[i, 3], A.diagonal[i, 4], A.diagonal[i, 5]
        c0, c1, c2 = yy * zz - yz * yz, xz * yz - xy * zz, xy * yz - xz * yy
        determinant = xx * c0 + xy * c1 + xz * c2
        if not free[i]:
            inverse[i] = 0.0
        elif xx > 0.0 and xx * yy - xy * xy > 0.0 and determinant > 0.0:
            inverse[i, 0] = c0 / determinant
            inverse[i, 1] = c1 / determinant
            inverse[i, 2] = c2 / determinant
            inverse[i, 3] = (xx * zz - xz * xz) / determinant
            inverse[i, 4] = (xy * xz - xx * yz) / determinant
            inverse[i, 5] = (xx * yy - xy * xy) / determinant
        else:
            definite = False
    return definite


def to_scipy(row: Indices, column: Indices, diagonal: Array, upper: Array) -> csc_array:
    """The matrix as a SciPy sparse array (3n, 3n), both halves."""
    from scipy.sparse import bsr_array

    n = len(row) - 1
    square = [[0, 1, 2], [1, 3, 4], [2, 4, 5]]
    rows_above = np.repeat(np.arange(n), np.diff(row))
    rows = np.concatenate([np.arange(n), rows_above, column])
    columns = np.concatenate([np.arange(n), column, rows_above])
    blocks = np.concatenate([diagonal, upper[:-1], upper[:-1]])[:, square]
    order = np.lexsort((columns, rows))
    starts = np.searchsorted(rows[order], np.arange(n + 1))
    return bsr_array((blocks[order], columns[order], starts), shape=(3 * n, 3 * n)).tocsc()
