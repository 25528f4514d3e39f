"""Coarser levels of a matrix for `multigrid`: which vertices make one, and what a level's matrix is.

An aggregate is a vertex and its neighbours. The coarse values are those of the aggregates, and a vertex takes the mean
of the values that it and its neighbours have: with P₀ the 0/1 matrix that says which vertex is in which aggregate and N
the neighbours, a vertex itself among them, P = D_N⁻¹ N P₀. The coarse matrix is Pᵀ A P: sums of blocks, which stay
symmetric, as the weights are numbers.

Reference: P. Vaněk, J. Mandel, M. Brezina, Algebraic multigrid by smoothed aggregation for second and fourth order
elliptic problems, Computing 56, 1996; here the smoothing follows the springs, not the matrix, and is done once.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from clothfit.base.arrays import Array, Indices
from clothfit.engine.solve import sparse
from clothfit.engine.solve.sparse import Pattern
from clothfit.kernels.kernel import kernel
from clothfit.kernels.lanes.operations import fma, load, splat, store

MOST_REACHED = 64
"""Coarse vertices that a row may reach before `project` takes more memory."""

NOTHING: Indices = np.empty(0, np.int32)


class Coarsening(NamedTuple):
    """How a level is made of the next finer one, of n vertices; W weights in all."""

    start: Indices  # (n + 1,), vertex i has the weights from start[i] to below start[i + 1]; a fixed one has none
    aggregate: Indices  # (W,), coarse vertices, ascending for each vertex
    weight: Array  # (W,), they add up to 1 for each free vertex
    reach: Indices  # (m,), how many coarse vertices d a row of the finer matrix reaches
    local: Indices  # which of these a weight of the row's own vertex or of a block's belongs to, in that order
    slot: Indices  # coarse slot of each of the row's own aggregates with each of these, −1 on the diagonal
    pattern: Pattern  # of the coarse matrix


def coarsen(pattern: Pattern, n: int) -> Coarsening:
    """Join vertices, and find where the blocks of the coarse matrix come from."""
    from scipy.sparse import csr_array

    row = np.repeat(pattern.order, np.diff(pattern.row))
    pairs = np.concatenate([np.stack([row, pattern.column]), np.stack([pattern.column, row])], axis=1)
    both = np.concatenate([pairs, np.stack([pattern.order, pattern.order])], axis=1)
    near = csr_array((np.ones(both.shape[1]), (both[0], both[1])), shape=(n, n))
    aggregate = np.full(n, -1, np.int32)
    count = group(pattern.order, near.indptr, near.indices, aggregate)
    own = np.sort(pattern.order)
    alone = csr_array((np.ones(len(own)), (own, aggregate[own])), shape=(n, count))
    P = csr_array(near @ alone)
    P.sort_indices()
    coarse = csr_array(P.T @ near @ P).tocoo()
    above = coarse.row < coarse.col
    ends = np.stack([coarse.row[above], coarse.col[above]], axis=1)
    made, _ = sparse.pattern(ends, np.ones(count, bool), whole=True)
    start, weight = P.indptr.astype(np.int32), P.data / np.repeat(np.maximum(near.sum(axis=1), 1.0), np.diff(P.indptr))
    columns = P.indices.astype(np.int32)
    place = np.zeros(count, np.int32)
    place[made.order] = np.arange(count)
    given = (pattern.order, pattern.row, pattern.column), (start, columns), (made.row, made.column, place)
    reach, most = np.empty(len(pattern.order), np.int32), np.empty(int(start[-1]) + 1, np.int32)
    found = fill_slots(*given, reach, most, NOTHING, NOTHING)
    local, slot = np.empty(found[0], np.int32), np.empty(found[1], np.int32)
    fill_slots(*given, reach, most, local, slot)
    return Coarsening(start, columns, weight, reach, local, slot, made)


@kernel
def group(order, start, neighbour, aggregate):
    """Fill `aggregate`, −1 before, for each vertex of `order`: a vertex and its neighbours where none of them is in an
    aggregate yet; the vertices left over go to a neighbour's. Returns how many aggregates there are.
    """
    count = 0
    for i in order:
        alone = aggregate[i] < 0
        for e in range(start[i], start[i + 1]):
            alone = alone and aggregate[neighbour[e]] < 0
        if alone:
            aggregate[i] = count
            for e in range(start[i], start[i + 1]):
                aggregate[neighbour[e]] = count
            count += 1
    whole = count
    for i in order:
        if aggregate[i] < 0:
            for e in range(start[i], start[i + 1]):
                if 0 <= aggregate[neighbour[e]] < whole:
                    aggregate[i] = aggregate[neighbour[e]]
    for i in order:
        if aggregate[i] < 0:
            aggregate[i] = count
            count += 1
    return count


@kernel
def fill_slots(fine, P, coarse, reach, reached, local, slot):
    """Fill `reach`, `local` and `slot`, the last two unless they are empty; returns their lengths. `reached` is memory
    for the coarse vertices that a row reaches.
    """
    order, row, column = fine
    start, aggregate = P
    entries, places = 0, 0
    for k in range(len(order)):
        i, count = order[k], 0
        for e in range(row[k] - 1, row[k + 1]):
            j = i if e < row[k] else column[e]
            for b in range(start[j], start[j + 1]):
                at = 0
                while at < count and reached[at] != aggregate[b]:
                    at += 1
                if at == count:
                    reached[at] = aggregate[b]
                    count += 1
                if len(local) > 0:
                    local[entries] = at
                entries += 1
        reach[k] = count
        for a in range(start[i], start[i + 1]):
            for at in range(count):
                if len(slot) > 0:
                    slot[places] = slot_of(coarse, aggregate[a], reached[at])
                places += 1
    return entries, places


@kernel
def slot_of(coarse, c, d):
    """The slot of the coarse vertices c and d, −1 where they are one."""
    row, column, place = coarse
    first, last = (c, d) if place[c] < place[d] else (d, c)
    for e in range(row[place[first]], row[place[first] + 1]):
        if column[e] == last:
            return e
    return -1


@kernel
def clear(blocks):
    """blocks = 0."""
    zero = splat(0.0)
    for k in range(len(blocks)):
        store(zero, blocks, k, 0)
        store(zero, blocks, k, 4)


@kernel
def project(A, coarsening, coarse):
    """coarse = Pᵀ A P = S + Sᵀ, S = Pᵀ (U + ½ D) P with the blocks U above the diagonal D of A: row by row, first what
    the row reaches, then that for each of its own aggregates.
    """
    start, aggregate, weight, reach, local, slot, _ = coarsening
    clear(coarse.diagonal)
    clear(coarse.upper)
    rows = np.zeros((MOST_REACHED, sparse.BLOCK_SIZE))
    entry, place = 0, 0
    for k in range(len(A.order)):
        i = A.order[k]
        if reach[k] > len(rows):
            rows = np.zeros((2 * reach[k], sparse.BLOCK_SIZE))
        for at in range(reach[k]):
            store(splat(0.0), rows, at, 0)
            store(splat(0.0), rows, at, 4)
        low, high = load(A.diagonal, i, 0), load(A.diagonal, i, 4)
        for b in range(start[i], start[i + 1]):
            add_times(0.5 * weight[b], low, high, rows, local[entry])
            entry += 1
        for e in range(A.row[k], A.row[k + 1]):
            j = A.column[e]
            low, high = load(A.upper, e, 0), load(A.upper, e, 4)
            for b in range(start[j], start[j + 1]):
                add_times(weight[b], low, high, rows, local[entry])
                entry += 1
        for a in range(start[i], start[i + 1]):
            for at in range(reach[k]):
                low, high = load(rows, at, 0), load(rows, at, 4)
                if slot[place] < 0:  # a block and its mirror image
                    add_times(2.0 * weight[a], low, high, coarse.diagonal, aggregate[a])
                else:
                    add_times(weight[a], low, high, coarse.upper, slot[place])
                place += 1


@kernel
def add_times(factor, low, high, blocks, i):
    """Add a block, times a factor, to block i."""
    times = splat(factor)
    store(fma(times, low, load(blocks, i, 0)), blocks, i, 0)
    store(fma(times, high, load(blocks, i, 4)), blocks, i, 4)
