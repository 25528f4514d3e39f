"""Conjugate gradients preconditioned by multigrid, for cloths of so many vertices that SSOR takes too many iterations.

A sweep of Gauss–Seidel carries news from vertex to vertex, so the finer a cloth, the more sweeps; sums over groups of
vertices carry it far at once. Each of two coarser levels joins a vertex and its neighbours into one, an aggregate.
With P the 0/1 matrix that says which vertex is in which aggregate, the coarse matrix is Pᵀ A P: sums of blocks, which
stay symmetric. One cycle

    z = (D + L)⁻¹ r,    z += γ P A_c⁻¹ Pᵀ (r − A z),    z += (D + Lᵀ)⁻¹ (r − A z)

is symmetric and positive definite; A_c⁻¹ is again such a cycle, and on the last level some sweeps of Gauss–Seidel,
which suffice there because the mass outweighs the springs ever more. γ makes up for the energy of a smooth correction,
which constant pieces underestimate. The last sweep also leaves r − A z, so nothing else multiplies by A.

References: P. Vaněk, J. Mandel, M. Brezina, Computing 56, 1996 (aggregation); D. Braess, Computing 55, 1995 (γ);
Y. Saad, Iterative Methods for Sparse Linear Systems, algorithm 9.1, whose lines `solve` numbers.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from clothfit.base.arrays import Array, Indices, aligned, staggered
from clothfit.engine.solve import sparse, ssor
from clothfit.engine.solve.cg import CONVERGED, INDEFINITE, LIMIT
from clothfit.engine.solve.sparse import BlockMatrix, Pattern, times
from clothfit.kernels.kernel import kernel
from clothfit.kernels.lanes.operations import add, clear3, fma, load, splat, store, sub, sum3

BOOST = 1.6
"""γ; with 1.4 … 1.8 the iterations differ by one."""

LAST_SWEEPS = 4
"""Symmetric sweeps on the coarsest level."""


class Coarsening(NamedTuple):
    """How a level is made of the next finer one, of n vertices, m free ones and E slots."""

    aggregate: Indices  # (n,), coarse vertex of each free vertex
    slot: Indices  # (E,), coarse slot of each fine slot; −1 where both ends are in one aggregate
    pattern: Pattern  # of the coarse matrix


class Level(NamedTuple):
    """A level and the memory of its part of a cycle, (n, 4) each but for the last two."""

    A: BlockMatrix
    r: Array
    z: Array
    own: Array  # right-hand sides, which sweeps overwrite
    rest: Array  # r − A z
    inverse: Array  # (n + 1, 8), D⁻¹
    whole: Indices  # (2,), all rows as one subdomain


class Hierarchy(NamedTuple):
    """The levels, from the finest, the matrix itself, and how each coarser one is made."""

    levels: tuple[Level, Level, Level]
    coarsenings: tuple[Coarsening, Coarsening]


def hierarchy(A: BlockMatrix) -> Hierarchy | None:
    """Two coarser levels for a matrix, by its pattern, and memory of cycles; None where it is small enough for SSOR."""
    if len(A.order) < sparse.MULTIGRID_FROM:
        return None
    first = coarsen(Pattern(A.order, A.row, A.column, A.subdomains), len(A.diagonal) - 1)
    second = coarsen(first.pattern, len(first.pattern.order))
    middle, last = (level(sparse.zeros(each.pattern, len(each.pattern.order))) for each in (first, second))
    return Hierarchy((level(A), middle, last), (first, second))


def level(A: BlockMatrix) -> Level:
    """Memory of a level."""
    n = len(A.diagonal) - 1
    r, z, own, rest = staggered(4, n, 4)
    return Level(A, r, z, own, rest, aligned(n + 1, sparse.BLOCK_SIZE), np.array([0, len(A.order)], np.int32))


def coarsen(pattern: Pattern, n: int) -> Coarsening:
    """Join each vertex and its neighbours where none of them is in an aggregate yet; the vertices left over go to a
    neighbour's aggregate.
    """
    from scipy.sparse import csr_array

    row = np.repeat(pattern.order, np.diff(pattern.row))
    ends = np.stack([row, pattern.column], axis=1)
    pairs = np.concatenate([ends, ends[:, ::-1]])
    joined = csr_array((np.ones(len(pairs)), (pairs[:, 0], pairs[:, 1])), shape=(n, n))
    aggregate = np.full(n, -1, np.int32)
    count = group(pattern.order, joined.indptr, joined.indices, aggregate)
    coarse = aggregate[ends]
    between = coarse[:, 0] != coarse[:, 1]
    slot = np.full(len(ends), -1, np.int32)
    made, slot[between] = sparse.pattern(coarse[between], np.ones(count, bool))
    return Coarsening(aggregate, slot, made)


@kernel
def group(order, start, neighbour, aggregate):
    """Fill `aggregate`, −1 before, for each vertex of `order`; returns how many aggregates there are."""
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
def project(A, coarsening, coarse):
    """coarse = Pᵀ A P."""
    aggregate, slot, _ = coarsening
    zero = splat(0.0)
    for blocks in (coarse.diagonal, coarse.upper):
        for k in range(len(blocks)):
            store(zero, blocks, k, 0)
            store(zero, blocks, k, 4)
    for k in range(len(A.order)):
        i = A.order[k]
        sparse.add_block(coarse.diagonal, aggregate[i], load(A.diagonal, i, 0), load(A.diagonal, i, 4))
        for e in range(A.row[k], A.row[k + 1]):
            low, high = load(A.upper, e, 0), load(A.upper, e, 4)
            if slot[e] < 0:  # a block and its mirror image
                sparse.add_block(coarse.diagonal, aggregate[i], add(low, low), add(high, high))
            else:
                sparse.add_block(coarse.upper, slot[e], low, high)


@kernel
def prepare(levels, coarsenings):
    """Fill the coarser levels from the finest; False when a diagonal block is not positive definite."""
    fine, middle, last = levels
    project(fine.A, coarsenings[0], middle.A)
    project(middle.A, coarsenings[1], last.A)
    definite = sparse.invert_diagonal(fine.A, 1.0, fine.inverse)
    definite = definite and sparse.invert_diagonal(middle.A, 1.0, middle.inverse)
    return definite and sparse.invert_diagonal(last.A, 1.0, last.inverse)


@kernel
def cycle(levels, coarsenings):
    """levels[0].z = M⁻¹ levels[0].r."""
    fine, middle, last = levels
    descend(fine)
    restrict(fine, coarsenings[0], middle)
    descend(middle)
    restrict(middle, coarsenings[1], last)
    relax(last)
    prolong(last, coarsenings[1], middle)
    ascend(middle)
    prolong(middle, coarsenings[0], fine)
    ascend(fine)


@kernel
def descend(at):
    """z = (D + L)⁻¹ r and rest = r − A z, which is −Lᵀ z."""
    A, r, z, own, rest, inverse, whole = at
    ssor.copy_rows(A, whole, r, own)
    ssor.solve_lower(A, whole, inverse, own, z)
    zero = splat(0.0)
    for k in range(len(A.order)):
        total = zero
        for e in range(A.row[k], A.row[k + 1]):
            total = times(A.upper, e, load(z, A.column[e], 0), total)
        store(sub(zero, total), rest, A.order[k], 0)


@kernel
def ascend(at):
    """z = (D + Lᵀ)⁻¹ (r − L z) and rest = r − A z, which is L times the decrease of z.

    Going back through the rows, a block is used for both while it is at hand: it is read from memory once.
    """
    A, r, z, _, rest, inverse, whole = at
    zero = splat(0.0)
    ssor.copy_rows(A, whole, r, rest)
    for k in range(len(A.order)):
        ssor.push(A, A.row, k, sub(zero, load(z, A.order[k], 0)), rest)
    for k in range(len(A.order) - 1, -1, -1):
        i = A.order[k]
        total = zero
        for e in range(A.row[k + 1] - 1, A.row[k] - 1, -1):
            total = times(A.upper, e, load(z, A.column[e], 0), total)
        z_i = clear3(times(inverse, i, sub(load(rest, i, 0), total), zero))
        less = sub(load(z, i, 0), z_i)
        store(z_i, z, i, 0)
        store(zero, rest, i, 0)
        ssor.push(A, A.row, k, less, rest)


@kernel
def restrict(fine, coarsening, coarse):
    """r of the coarse level = Pᵀ rest."""
    aggregate, zero = coarsening.aggregate, splat(0.0)
    for i in range(len(coarse.r)):
        store(zero, coarse.r, i, 0)
    for i in fine.A.order:
        j = aggregate[i]
        store(add(load(coarse.r, j, 0), load(fine.rest, i, 0)), coarse.r, j, 0)


@kernel
def prolong(coarse, coarsening, fine):
    """z += γ P z of the coarse level."""
    aggregate, boost = coarsening.aggregate, splat(BOOST)
    for i in fine.A.order:
        store(fma(boost, load(coarse.z, aggregate[i], 0), load(fine.z, i, 0)), fine.z, i, 0)


@kernel
def relax(at):
    """z = A⁻¹ r, nearly: the result of some symmetric sweeps of Gauss–Seidel from z = 0."""
    descend(at)
    ascend(at)
    for _ in range(1, LAST_SWEEPS):
        A, _, z, own, rest, inverse, whole = at
        ssor.copy_rows(A, whole, rest, own)
        ssor.solve_lower(A, whole, inverse, own, rest)
        for i in A.order:
            store(add(load(z, i, 0), load(rest, i, 0)), z, i, 0)
        ascend(at)


@kernel
def solve(A, b, tolerance, limit, work, hierarchy, w):
    """As `cg.solve`, preconditioned by cycles; of its memory x, p and q = A p are used.

    Returns the iterations used, and CONVERGED, INDEFINITE or LIMIT.
    """
    x, p, q, fine = work.x, work.p, work.q, hierarchy.levels[0]
    bb = ssor.enter(A, fine.whole, b, w, x, fine.own)
    rr = ssor.residual(A, fine.whole, x, fine.own, fine.r)  # 1: r = b − A x
    target = tolerance * tolerance * bb
    if ssor.is_solved(A, rr, bb, target, w):
        return 0, CONVERGED
    if not prepare(hierarchy.levels, hierarchy.coarsenings):
        return 0, INDEFINITE
    rz = 0.0
    for iteration in range(1, limit + 1):  # 2: for j = 0, 1, … until convergence
        cycle(hierarchy.levels, hierarchy.coarsenings)  # 6 of the last j: z = M⁻¹ r
        rz_new = dot(A, fine.z, fine.r)
        beta = rz_new / rz if iteration > 1 else 0.0  # 7: β = (r, z) / (r, z) before
        rz = rz_new
        curvature = follow(A, beta, fine, p, q)  # 8: p = z + β p, q = A p
        if not curvature > 0.0:
            return iteration, INDEFINITE
        rr = step(A, rz / curvature, p, q, x, fine.r)  # 3, 4, 5: α = (r, z) / (A p, p), x += α p, r −= α q
        if rr <= target:
            ssor.leave(A, x, w)
            return iteration, CONVERGED
    return limit, LIMIT


@kernel
def dot(A, a, b):
    """a·b over the free vertices."""
    total = splat(0.0)
    for i in A.order:
        total = fma(load(a, i, 0), load(b, i, 0), total)
    return sum3(total)


@kernel
def follow(A, beta, fine, p, q):
    """p = z + β p and q = A z + β q = A p; returns p·q. A cycle knows A z = r − rest."""
    total, growth = splat(0.0), splat(beta)
    for i in A.order:
        p_i = fma(growth, load(p, i, 0), load(fine.z, i, 0))
        q_i = fma(growth, load(q, i, 0), sub(load(fine.r, i, 0), load(fine.rest, i, 0)))
        store(p_i, p, i, 0)
        store(q_i, q, i, 0)
        total = fma(p_i, q_i, total)
    return sum3(total)


@kernel
def step(A, alpha, p, q, x, r):
    """x += α p, r −= α q; returns |r|²."""
    total, forward, back = splat(0.0), splat(alpha), splat(-alpha)
    for i in A.order:
        store(fma(forward, load(p, i, 0), load(x, i, 0)), x, i, 0)
        r_i = fma(back, load(q, i, 0), load(r, i, 0))
        store(r_i, r, i, 0)
        total = fma(r_i, r_i, total)
    return sum3(total)
