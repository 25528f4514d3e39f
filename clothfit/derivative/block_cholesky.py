"""The Cholesky factor of a step's matrix in blocks, for many right-hand sides at once.

Reverse Cuthill–McKee orders the unknowns so that each touches only near ones; cut into blocks that are large enough,
the matrix is block tridiagonal, with D_k on its diagonal and E_k below it:

    L_k L_kᵀ = D_k − C_k C_kᵀ,    C_k = E_k L_{k−1}⁻ᵀ,    L = (L_k on the diagonal, C_k below it)

All is done by dense matrices of the size of a block: on a cloth of n rows of n vertices its cost grows as n⁴ where that
of one dense matrix grows as n⁶. A. George, J. W. H. Liu, Computer Solution of Large Sparse Positive Definite Systems,
1981.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple

import numpy as np
from numpy.typing import NDArray

from clothfit.base.arrays import Array
from clothfit.kernels import lapack

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


class Cut:
    """Where the numbers of matrices of one pattern are in their blocks D_k and E_k."""

    def __init__(self, matrix: csc_array, blocks: Blocks, source: NDArray[np.intp] | None = None) -> None:
        """`source`: where the entries of the matrix stand in what they are taken from, by default one after the other.
        """
        ends = np.array(blocks.ends)
        row = blocks.back[np.repeat(np.arange(len(blocks.order)), np.diff(matrix.indptr))]
        column = blocks.back[matrix.indices]
        block = np.searchsorted(ends, np.arange(len(blocks.order)), side="right") - 1
        own, other = block[row], block[column]
        kept = (own == other) | (own == other + 1)
        begin, size = ends[:-1], np.diff(ends)
        self.shapes = [(m, n) for m, n in zip(size, size, strict=True)]
        self.shapes += [(m, n) for m, n in zip(size, np.append(0, size[:-1]), strict=True)]
        self.starts = np.append(0, np.cumsum([m * n for m, n in self.shapes]))
        which = own + np.where(own == other, 0, len(size))
        within = row - begin[own] + size[own] * (column - begin[other])  # column by column
        self.place = (self.starts[which] + within)[kept]
        self.source = (np.arange(len(row)) if source is None else source)[kept]

    def __call__(self, numbers: Array) -> tuple[list[Array], list[Array]]:
        """All D_k and E_k, in the order of Fortran; the first E is empty."""
        made = np.zeros(self.starts[-1])
        made[self.place] = numbers[self.source]
        ends = zip(self.starts[:-1], self.starts[1:], self.shapes, strict=True)
        parts = [made[begin:end].reshape(shape, order="F") for begin, end, shape in ends]
        return parts[: len(parts) // 2], parts[len(parts) // 2 :]


def factorise(diagonal: list[Array], below: list[Array]) -> tuple[list[Array], list[Array]] | None:
    """All L_k and C_k (the first is empty) in the place of D_k and E_k; None where the matrix is not positive definite.
    """
    for k, D in enumerate(diagonal):
        if k:
            lapack.solve_right(diagonal[k - 1], below[k], transposed=True)
            lapack.subtract_square(below[k], D)
        if not lapack.factorise(D):
            return None
    return diagonal, below


def solve(diagonal: list[Array], below: list[Array], blocks: Blocks, right: Array) -> Array:
    """The solution (N, Q) for right-hand sides (N, Q)."""
    x = right[blocks.order]  # a copy; its rows transposed are columns in the order of Fortran, solved in place
    parts = [x[begin:end].T for begin, end in zip(blocks.ends[:-1], blocks.ends[1:], strict=True)]
    for k, part in enumerate(parts):
        if k:
            lapack.subtract_product(parts[k - 1], below[k], part, transposed=True)
        lapack.solve_right(diagonal[k], part, transposed=True)
    for k in reversed(range(len(parts))):
        if k + 1 < len(parts):
            lapack.subtract_product(parts[k + 1], below[k + 1], parts[k], transposed=False)
        lapack.solve_right(diagonal[k], parts[k], transposed=False)
    return np.asarray(x[blocks.back])
