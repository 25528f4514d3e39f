"""The Cholesky factor L Lᵀ of a step's matrix within its envelope, for many right-hand sides at once.

Reverse Cuthill–McKee orders the unknowns so that each touches only near ones. L then has entries only from the first
unknown that a row touches to the diagonal: on a cloth of n rows of n vertices its cost grows as n⁴ where that of a
dense matrix grows as n⁶. A. George, J. W. H. Liu, Computer Solution of Large Sparse Positive Definite Systems, 1981.

Eight rows are a panel, and begin with the same column, the first of a panel. A panel is kept column by column, so two
vectors of four lanes hold a column; eight sums at once then stay in registers while the entries pass by: of eight rows
and four columns of L, or of eight rows and as many lanes of right-hand sides. Calls of LAPACK with blocks of this size
take longer than their operations. The diagonal has the inverses of its entries; rows behind the last are those of the
unit matrix.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple

import numpy as np
from numpy.typing import NDArray

from clothfit.base.arrays import Array, Indices, aligned
from clothfit.kernels.kernel import kernel
from clothfit.kernels.lanes.operations import column, fma, load, mul, splat, store, store_column, sub

if TYPE_CHECKING:
    from scipy.sparse import csc_array

PANEL = 8
"""Rows of a panel."""


class Envelope(NamedTuple):
    """Where the entries of the factors of matrices of one pattern are, in P panels."""

    order: NDArray[np.intp]  # (N,): the unknown at each place
    back: NDArray[np.intp]  # (N,): the place of each unknown
    first: Indices  # (P,): the panel at whose first unknown each panel begins
    start: Indices  # (P + 1,): its first column in L (start[P], 8)
    place: NDArray[np.intp]  # where the numbers of a matrix are in L
    source: NDArray[np.intp]  # which numbers these are


def envelope(matrix: csc_array, source: NDArray[np.intp] | None = None) -> Envelope:
    """The envelope for matrices of the pattern of a symmetric `matrix` (N, N).

    `source`: where its entries stand in what they are taken from, by default one after the other.
    """
    from scipy.sparse.csgraph import reverse_cuthill_mckee

    order = np.asarray(reverse_cuthill_mckee(matrix, symmetric_mode=True), np.intp)
    back = np.empty_like(order)
    back[order] = np.arange(len(order))
    row, col = back[np.repeat(np.arange(len(order)), np.diff(matrix.indptr))], back[matrix.indices]
    first = np.arange(-(-len(order) // PANEL))
    np.minimum.at(first, row // PANEL, col // PANEL)
    start = np.append(0, np.cumsum(PANEL * (np.arange(len(first)) - first + 1)))
    place = PANEL * (start[row // PANEL] + col - PANEL * first[row // PANEL]) + row % PANEL
    kept = col // PANEL <= row // PANEL
    numbers = np.arange(len(row)) if source is None else source
    return Envelope(order, back, first.astype(np.int32), start.astype(np.int32), place[kept], numbers[kept])


def factorise(envelope: Envelope, numbers: Array) -> Array | None:
    """L of a matrix of these numbers; None where it is not positive definite."""
    L = aligned(int(envelope.start[-1]), PANEL)
    L.reshape(-1)[envelope.place] = numbers[envelope.source]
    last = np.arange(-len(envelope.order) % PANEL)
    L[-1 - last, PANEL - 1 - last] = 1.0
    return L if fill(envelope.first, envelope.start, L) else None


def solve(envelope: Envelope, L: Array, right: Array) -> Array:
    """The solution (N, Q) for right-hand sides (N, Q)."""
    size, columns = right.shape
    x = np.zeros((PANEL * len(envelope.first), columns + -columns % 4))
    x[:size, :columns] = right[envelope.order]
    substitute(envelope.first, envelope.start, L, x)
    return x[envelope.back, :columns]


@kernel(nogil=True)
def fill(first, start, L):
    """Write the factor over the entries of a matrix; False where it is not positive definite."""
    for p in range(len(first)):
        for m in range(first[p], p + 1):
            own, other = start[p] + PANEL * (m - first[p]), start[m] + PANEL * (m - first[m])
            subtract_products(L, own, other, PANEL * (m - max(first[p], first[m])))
            for c in range(PANEL):
                pivot = L[own + c, c]
                for e in range(c if m == p else 0):
                    pivot -= L[own + e, c] * L[own + e, c]
                if m == p and not pivot > 0.0:
                    return False
                inverse = 1.0 / np.sqrt(pivot) if m == p else L[other + c, c]
                for half in range(0, PANEL, 4):
                    left = column(L, own + c, half)
                    for e in range(c):
                        left = fma(splat(-L[other + e, c]), column(L, own + e, half), left)
                    store_column(mul(splat(inverse), left), L, own + c, half)
                L[other + c, c] = inverse
    return True


@kernel
def subtract_products(L, own, other, count):
    """Subtract from the eight columns from `own` on the products of the `count` columns before them with the rows of
    those before `other`.
    """
    for half in range(0, PANEL, 4):
        a0 = a1 = a2 = a3 = b0 = b1 = b2 = b3 = splat(0.0)
        for k in range(-count, 0):
            low, high, row = column(L, own + k, 0), column(L, own + k, 4), L[other + k]
            c0, c1, c2, c3 = splat(row[half]), splat(row[half + 1]), splat(row[half + 2]), splat(row[half + 3])
            a0, a1, a2, a3 = fma(c0, low, a0), fma(c1, low, a1), fma(c2, low, a2), fma(c3, low, a3)
            b0, b1, b2, b3 = fma(c0, high, b0), fma(c1, high, b1), fma(c2, high, b2), fma(c3, high, b3)
        for c, (low, high) in enumerate(((a0, b0), (a1, b1), (a2, b2), (a3, b3))):
            store_column(sub(column(L, own + half + c, 0), low), L, own + half + c, 0)
            store_column(sub(column(L, own + half + c, 4), high), L, own + half + c, 4)


@kernel(nogil=True)
def substitute(first, start, L, x):
    """x = L⁻ᵀ L⁻¹ x, for columns that are a multiple of four."""
    for p in range(len(first)):
        own, diagonal = PANEL * p, start[p + 1] - PANEL
        for q in range(0, x.shape[1], 4):
            s0 = s1 = s2 = s3 = s4 = s5 = s6 = s7 = splat(0.0)
            for k in range(start[p], diagonal):
                v, row = load(x, PANEL * first[p] + k - start[p], q), L[k]
                s0, s1, s2 = fma(splat(row[0]), v, s0), fma(splat(row[1]), v, s1), fma(splat(row[2]), v, s2)
                s3, s4, s5 = fma(splat(row[3]), v, s3), fma(splat(row[4]), v, s4), fma(splat(row[5]), v, s5)
                s6, s7 = fma(splat(row[6]), v, s6), fma(splat(row[7]), v, s7)
            for c, total in enumerate((s0, s1, s2, s3, s4, s5, s6, s7)):
                left = sub(load(x, own + c, q), total)
                for e in range(c):
                    left = fma(splat(-L[diagonal + e, c]), load(x, own + e, q), left)
                store(mul(splat(L[diagonal + c, c]), left), x, own + c, q)
    for p in range(len(first) - 1, -1, -1):
        own, diagonal = PANEL * p, start[p + 1] - PANEL
        for q in range(0, x.shape[1], 4):
            for c in range(PANEL - 1, -1, -1):
                left = load(x, own + c, q)
                for e in range(c + 1, PANEL):
                    left = fma(splat(-L[diagonal + c, e]), load(x, own + e, q), left)
                store(mul(splat(L[diagonal + c, c]), left), x, own + c, q)
            v0, v1, v2, v3 = load(x, own, q), load(x, own + 1, q), load(x, own + 2, q), load(x, own + 3, q)
            v4, v5, v6, v7 = load(x, own + 4, q), load(x, own + 5, q), load(x, own + 6, q), load(x, own + 7, q)
            for k in range(start[p], diagonal):
                row, to = L[k], PANEL * first[p] + k - start[p]
                even = fma(splat(row[0]), v0, fma(splat(row[2]), v2, mul(splat(row[4]), v4)))
                odd = fma(splat(row[1]), v1, fma(splat(row[3]), v3, mul(splat(row[5]), v5)))
                even, odd = fma(splat(row[6]), v6, even), fma(splat(row[7]), v7, odd)
                store(sub(sub(load(x, to, q), even), odd), x, to, q)
