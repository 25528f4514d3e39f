"""Conjugate gradients preconditioned by `multigrid`, for very large cloths: Y. Saad, Iterative Methods for Sparse
Linear Systems, algorithm 9.1, whose lines `solve` numbers. Vectors are (n, 4), lane 3 being 0.
"""

from __future__ import annotations

from math import sqrt

from clothfit.engine.solve import multigrid, ssor
from clothfit.engine.solve.cg import CONVERGED, INDEFINITE, LIMIT
from clothfit.engine.solve.sparse import times, times_spread
from clothfit.kernels.kernel import kernel
from clothfit.kernels.lanes.operations import clear3, fma, load, mul, splat, spread0, spread1, spread2, store, sum3


@kernel
def solve(A, b, tolerance, limit, work, hierarchy, w):
    """As `cg.solve`; of its memory x, r, p, q = A p and `own` are used."""
    x, r, p, q, whole, fine = work.x, work.r, work.p, work.q, A.subdomains[0], hierarchy.levels[0]
    bb = ssor.enter(A, whole, b, w, x, work.own)
    rr = ssor.residual(A, whole, x, work.own, r)  # 1: r = b − A x
    target = tolerance * tolerance * bb
    if ssor.is_solved(A, rr, bb, target, w):
        return 0, CONVERGED
    if not multigrid.prepare(A, hierarchy.levels, hierarchy.coarsenings, False):
        return 0, INDEFINITE
    rz = 1.0
    for iteration in range(1, limit + 1):  # 2: for j = 0, 1, … until convergence
        size = sqrt(rr)
        rz_new = multigrid.precondition(hierarchy, r, size)  # 6 of the last j: z = M⁻¹ r
        beta = rz_new / rz if iteration > 1 else 0.0  # 7: β = (r, z) / (r, z) before
        rz = rz_new
        curvature = follow(A, size, fine.z, beta, p, q)  # 8: p = z + β p, q = A p
        if not curvature > 0.0:
            return iteration, INDEFINITE
        rr = step(A, rz / curvature, p, q, x, r)  # 3, 4, 5: α = (r, z) / (A p, p), x += α p, r −= α q
        if rr <= target:
            ssor.leave(A, x, w)
            return iteration, CONVERGED
    return limit, LIMIT


@kernel
def follow(A, scale, z, beta, p, q):
    """p = scale · z + β p and q = A p; returns p·q."""
    zero, factor, growth = splat(0.0), splat(scale), splat(beta)
    for i in A.order:
        store(fma(growth, load(p, i, 0), mul(factor, load(z, i, 0))), p, i, 0)
        store(zero, q, i, 0)
    total = zero
    for k in range(len(A.order)):
        i = A.order[k]
        p_i = load(p, i, 0)
        p0, p1, p2 = spread0(p_i), spread1(p_i), spread2(p_i)
        q_i = times_spread(A.diagonal, i, p0, p1, p2, load(q, i, 0))
        for e in range(A.row[k], A.row[k + 1]):
            j = A.column[e]
            q_i = times(A.upper, e, load(p, j, 0), q_i)
            store(times_spread(A.upper, e, p0, p1, p2, load(q, j, 0)), q, j, 0)
        q_i = clear3(q_i)
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
