"""Coarser levels of a matrix for `multigrid`: which vertices make one, and what a level's matrix is.

An aggregate is a vertex and its neighbours. The coarse values are those of the aggregates, and a vertex takes the mean
of the values that it and its neighbours have: with P₀ the 0/1 matrix that says which vertex is in which aggregate and N
the neighbours, a vertex itself among them, P = D_N⁻¹ N P₀. The coarse matrix is Pᵀ A P: sums of blocks, which stay
symmetric, as the weights are numbers. Vertices of a level are counted in its order of sweep (`in_places`).

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
from clothfit.kernels.lanes.operations import fma8f, index, load8f, splat8f, store8f

MOST_REACHED = 64
"""Coarse vertices that a row may reach before `project` takes more memory."""

NOTHING: Indices = np.empty(0, np.int32)


class Coarsening(NamedTuple):
    """How a level is made of the next finer one, of m vertices; W weights in all."""

    start: Indices  # (m + 1,), vertex i has the weights from start[i] to below start[i + 1]
    aggregate: Indices  # (W,), coarse vertices, ascending for each vertex
    weight: Array  # (W,), they add up to 1 for each vertex
    reach: Indices  # (m,), how many coarse vertices d a row of the finer matrix reaches
    local: Indices  # which of these a weight of the row's own vertex or of a block's belongs to, in that order
    slot: Indices  # coarse slot of each of the row's own aggregates with each of these, −1 on the diagonal
    begins: Indices  # (3, 2), where in `local` and `slot` each subdomain's rows begin
    pattern: Pattern  # of the coarse matrix


def in_places(pattern: Pattern, n: int) -> Pattern:
    """The pattern of a matrix of n vertices, of which those with a row are counted in the order of sweep."""
    place = np.zeros(n, np.int32)
    place[pattern.order] = np.arange(len(pattern.order))
    return pattern._replace(order=np.arange(len(pattern.order), dtype=np.int32), column=place[pattern.column])


def coarsen(pattern: Pattern) -> Coarsening:
    """Join vertices, counted in the order of sweep, and find where the blocks of the coarse matrix come from."""
    from scipy.sparse import csr_array

    m = len(pattern.order)
    row = np.repeat(pattern.order, np.diff(pattern.row))
    pairs = np.concatenate([np.stack([row, pattern.column]), np.stack([pattern.column, row])], axis=1)
    both = np.concatenate([pairs, np.stack([pattern.order, pattern.order])], axis=1)
    near = csr_array((np.ones(both.shape[1]), (both[0], both[1])), shape=(m, m))
    aggregate = np.full(m, -1, np.int32)
    count = group(pattern.order, near.indptr, near.indices, aggregate)
    P = csr_array(near @ csr_array((np.ones(m), (pattern.order, aggregate)), shape=(m, count)))
    coarse = csr_array(P.T @ near @ P).tocoo()
    above = coarse.row < coarse.col
    ends = np.stack([coarse.row[above], coarse.col[above]], axis=1)
    found, _ = sparse.pattern(ends, np.ones(count, bool), whole=True)
    P = csr_array(P[:, found.order])
    P.sort_indices()
    made = in_places(found, count)
    start, weight = P.indptr.astype(np.int32), P.data / np.repeat(near.sum(axis=1), np.diff(P.indptr))
    columns = P.indices.astype(np.int32)
    given = (pattern.row, pattern.column), (start, columns), (made.row, made.column)
    reach, most, begins = np.empty(m, np.int32), np.empty(int(start[-1]) + 1, np.int32), np.zeros((m + 1, 2), np.int32)
    fill_slots(*given, reach, most, NOTHING, NOTHING, begins)
    local, slot = (np.empty(size, np.int32) for size in begins[-1])
    fill_slots(*given, reach, most, local, slot, begins)
    parts = np.ascontiguousarray(begins[np.minimum(pattern.subdomains[:, 0], m)])
    return Coarsening(start, columns, weight, reach, local, slot, parts, made)


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
def fill_slots(fine, P, coarse, reach, reached, local, slot, begins):
    """Fill `reach`, `local` and `slot`, the last two unless they are empty, and where in them each row begins, and the
    last one ends. `reached` is memory for the coarse vertices that a row reaches.
    """
    row, column = fine
    start, aggregate = P
    entries, places = 0, 0
    for i in range(len(reach)):
        begins[i, 0], begins[i, 1] = entries, places
        count = 0
        for e in range(row[i] - 1, row[i + 1]):
            j = i if e < row[i] else column[e]
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
        reach[i] = count
        for a in range(start[i], start[i + 1]):
            for at in range(count):
                if len(slot) > 0:
                    slot[places] = slot_of(coarse, aggregate[a], reached[at])
                places += 1
    begins[len(reach), 0], begins[len(reach), 1] = entries, places


@kernel
def slot_of(coarse, c, d):
    """The slot of the coarse vertices c and d, −1 where they are one."""
    row, column = coarse
    first, last = min(c, d), max(c, d)
    for e in range(row[first], row[first + 1]):
        if column[e] == last:
            return e
    return -1


@kernel
def clear(A):
    """A = 0."""
    for blocks in (A.diagonal, A.upper):
        for k in range(len(blocks)):
            store8f(splat8f(0.0), blocks, k, 0)


@kernel
def join(A, other):
    """A += other, of the same pattern."""
    for blocks, more in ((A.diagonal, other.diagonal), (A.upper, other.upper)):
        for k in range(len(blocks)):
            add_times(1.0, load8f(more, k, 0), blocks, k)


@kernel
def project(A, s, begin, end, coarsening, coarse):
    """coarse += what the rows `begin` to below `end` of A, those of subdomain s, add to Pᵀ A P.

    That is S + Sᵀ, S = Pᵀ (U + ½ D) P with the blocks U above the diagonal D of A: row by row, first what the row
    reaches, then that for each of its own aggregates.
    """
    start, aggregate, weight, reach, local, slot, begins, _ = coarsening
    reached = np.zeros((MOST_REACHED, sparse.BLOCK_SIZE), np.float32)
    entry, place = begins[s, 0], begins[s, 1]
    for i in range(begin, end):
        if reach[i] > len(reached):
            reached = np.zeros((2 * reach[i], sparse.BLOCK_SIZE), np.float32)
        for at in range(reach[i]):
            store8f(splat8f(0.0), reached, at, 0)
        block = load8f(A.diagonal, i, 0)
        for b in range(index(start, i), index(start, i + 1)):
            add_times(0.5 * weight[b], block, reached, index(local, entry))
            entry += 1
        for e in range(index(A.row, i), index(A.row, i + 1)):
            j = index(A.column, e)
            block = load8f(A.upper, e, 0)
            for b in range(index(start, j), index(start, j + 1)):
                add_times(weight[b], block, reached, index(local, entry))
                entry += 1
        for a in range(index(start, i), index(start, i + 1)):
            for at in range(reach[i]):
                block = load8f(reached, at, 0)
                if index(slot, place) < 0:  # a block and its mirror image
                    add_times(2.0 * weight[a], block, coarse.diagonal, index(aggregate, a))
                else:
                    add_times(weight[a], block, coarse.upper, index(slot, place))
                place += 1


@kernel
def add_times(factor, block, blocks, i):
    """Add a block, times a factor, to block i."""
    store8f(fma8f(splat8f(factor), block, load8f(blocks, i, 0)), blocks, i, 0)
