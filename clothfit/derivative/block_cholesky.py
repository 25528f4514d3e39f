"""The Cholesky factor of a step's matrix in blocks, for many right-hand sides at once.

Reverse Cuthill–McKee orders the unknowns so that each touches only near ones; cut into blocks that are large enough,
the matrix is block tridiagonal, with D_k on its diagonal and E_k below it:

    L_k L_kᵀ = D_k − C_k C_kᵀ,    C_k = E_k L_{k−1}⁻ᵀ,    L = (L_k on the diagonal, C_k below it)

All is done by dense matrices of the size of a block: on a cloth of n rows of n vertices its cost grows as n⁴ where that
of one dense matrix grows as n⁶. A. George, J. W. H. Liu, Computer Solution of Large Sparse Positive Definite Systems,
1981.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING, NamedTuple

import numpy as np
from numpy.typing import NDArray

from clothfit.base.arrays import Array

if TYPE_CHECKING:
    from scipy.sparse import csc_array

SMALLEST_BLOCK = 24
"""Unknowns of a block at least: smaller ones cost more calls than they save operations."""

SMALL_MATRICES = 0.7
"""Speed of operations with small matrices, relative to that with a large one."""


class Blocks(NamedTuple):
    """How the unknowns of matrices of one pattern are ordered and cut."""

    order: NDArray[np.intp]  # (N,): the unknown at each place
    back: NDArray[np.intp]  # (N,): the place of each unknown
    ends: tuple[int, ...]  # places at which blocks begin and end, from 0 to N

    def operations(self, columns: int) -> float:
        """Those of a factor and of so many right-hand sides, roughly."""
        sizes = np.diff(self.ends).astype(float)
        return float(7.0 / 3.0 * (sizes**3).sum() + 6.0 * (sizes**2).sum() * columns)


def blocks_of(matrix: csc_array) -> Blocks:
    """The blocks for matrices of the pattern of a symmetric `matrix` (N, N)."""
    from scipy.sparse.csgraph import reverse_cuthill_mckee

    order = np.asarray(reverse_cuthill_mckee(matrix, symmetric_mode=True), np.intp)
    back = np.empty_like(order)
    back[order] = np.arange(len(order))
    rows = np.repeat(np.arange(len(order)), np.diff(matrix.indptr))
    reach = np.arange(len(order))  # the farthest place that each place touches
    np.maximum.at(reach, back[rows], back[matrix.indices])
    reach = np.maximum.accumulate(reach) + 1
    ends = [0]
    end = min(max(int(reach[0]), SMALLEST_BLOCK), len(order)) if len(order) else 0
    while ends[-1] < len(order):
        ends.append(end)
        end = min(max(int(reach[end - 1]), end + SMALLEST_BLOCK), len(order))
    return Blocks(order, back, tuple(ends))


def is_cheaper(blocks: Blocks, columns: int) -> bool:
    """Whether the factor in blocks and the solution of so many right-hand sides take fewer operations than the inverse
    of a dense matrix and a product with it.
    """
    size = float(len(blocks.order))
    return blocks.operations(columns) < SMALL_MATRICES * (size**3 + 2.0 * size**2 * columns)


def solver(matrix: csc_array, blocks: Blocks) -> Callable[[Array], Array] | None:
    """Factorise a matrix (N, N); returns a function that solves for right-hand sides (N, Q), or None where the matrix
    is not positive definite.
    """
    factor = factorise(matrix, blocks)
    return None if factor is None else lambda right: solve(*factor, blocks, right)


def factorise(matrix: csc_array, blocks: Blocks) -> tuple[list[Array], list[Array]] | None:
    """All L_k and C_k (the first is empty), in the order of Fortran; None where the matrix is not positive definite."""
    from scipy.linalg import blas, lapack

    diagonal, below = cut(matrix, blocks)
    for k, D in enumerate(diagonal):
        if k:
            below[k] = blas.dtrsm(1.0, diagonal[k - 1], below[k], side=1, lower=1, trans_a=1, overwrite_b=1)
            D = blas.dsyrk(-1.0, below[k], beta=1.0, c=D, lower=1, overwrite_c=1)
        diagonal[k], fault = lapack.dpotrf(D, lower=1, clean=0, overwrite_a=1)
        if fault:
            return None
    return diagonal, below


def cut(matrix: csc_array, blocks: Blocks) -> tuple[list[Array], list[Array]]:
    """All D_k and E_k of a matrix; the first E is empty."""
    ends = np.array(blocks.ends)
    entry_row = blocks.back[np.repeat(np.arange(len(blocks.order)), np.diff(matrix.indptr))]
    entry_column = blocks.back[matrix.indices]
    block = np.searchsorted(ends, np.arange(len(blocks.order)), side="right") - 1
    row_block, column_block = block[entry_row], block[entry_column]
    diagonal, below = [], []
    order = np.argsort(row_block, kind="stable")
    starts = np.searchsorted(row_block[order], np.arange(len(ends)))
    for k, (begin, end) in enumerate(zip(blocks.ends[:-1], blocks.ends[1:], strict=True)):
        own = order[starts[k] : starts[k + 1]]
        D = np.zeros((end - begin, end - begin), order="F")
        inside = own[column_block[own] == k]
        D[entry_row[inside] - begin, entry_column[inside] - begin] = matrix.data[inside]
        last = blocks.ends[k - 1] if k else 0
        E = np.zeros((end - begin, begin - last), order="F")
        before = own[column_block[own] == k - 1]
        E[entry_row[before] - begin, entry_column[before] - last] = matrix.data[before]
        diagonal.append(D)
        below.append(E)
    return diagonal, below


def solve(diagonal: list[Array], below: list[Array], blocks: Blocks, right: Array) -> Array:
    """The solution (N, Q) for right-hand sides (N, Q)."""
    from scipy.linalg import blas

    x = right[blocks.order]  # a copy; its rows transposed are columns in the order of Fortran, solved in place
    parts = [x[begin:end].T for begin, end in zip(blocks.ends[:-1], blocks.ends[1:], strict=True)]
    for k, part in enumerate(parts):
        if k:
            blas.dgemm(-1.0, parts[k - 1], below[k], beta=1.0, c=part, trans_b=1, overwrite_c=1)
        blas.dtrsm(1.0, diagonal[k], part, side=1, lower=1, trans_a=1, overwrite_b=1)
    for k in reversed(range(len(parts))):
        if k + 1 < len(parts):
            blas.dgemm(-1.0, parts[k + 1], below[k + 1], beta=1.0, c=parts[k], overwrite_c=1)
        blas.dtrsm(1.0, diagonal[k], parts[k], side=1, lower=1, overwrite_b=1)
    return np.asarray(x[blocks.back])
