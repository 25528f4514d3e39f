"""Conjugate gradients preconditioned by `multigrid`, for large cloths: Y. Saad, Iterative Methods for Sparse
Linear Systems, algorithm 9.1, whose lines `solve` numbers. Vectors are (n, 4), lane 3 being 0.

The rows are in subdomains, of which a second thread, where there is one, takes 1 (see `two_threads`, `multigrid`). The
numbers are the same to the last bit with one thread or two.
"""

from __future__ import annotations

from math import sqrt
from typing import NamedTuple

import numpy as np

from clothfit.base.arrays import Array, staggered
from clothfit.engine.solve import cg, multigrid, ssor, two_threads
from clothfit.engine.solve.cg import CONVERGED, INDEFINITE, LIMIT
from clothfit.engine.solve.multigrid import AFTER, Hierarchy, rows
from clothfit.engine.solve.sparse import BlockMatrix, added, spread, times_row, times_spread
from clothfit.engine.solve.two_threads import SERVES, STOP, Worker
from clothfit.kernels.kernel import kernel
from clothfit.kernels.lanes.operations import add, clear3, fma, index, load4, mul, splat, store4, sum3

RESIDUAL, PREPARE, DESCEND, ASCEND, FOLLOW, STEP = 0.0, 1.0, 2.0, 3.0, 4.0, 5.0
"""Passes over the rows, as messages to the second thread have them."""


class Second(NamedTuple):
    """What the second subdomain needs of its own."""

    far: Array  # (n, 4), as `own` of `cg.Workspace`
    worker: Worker


class Large(NamedTuple):
    """What only large cloths need."""

    second: Second
    hierarchy: Hierarchy


NONE = Large(Second(np.zeros((0, 4)), two_threads.worker()), multigrid.nothing())
"""What there is of them for a cloth that is not large."""


def large(A: BlockMatrix) -> Large:
    """Memory for a matrix, by its pattern; NONE where it is small enough for SSOR, or all its rows are in the first
    subdomain.
    """
    begin, end = A.subdomains[1]
    hierarchy = multigrid.hierarchy(A) if begin < end else None
    if hierarchy is None:
        return NONE
    _, far = staggered(2, len(A.diagonal) - 1, 4)  # half a page from where x begins, and away from the others
    return Large(Second(far, two_threads.worker()), hierarchy)


@kernel(apart=(0, 0))
def solve(A, b, tolerance, limit, work, second, hierarchy, w):
    """As `cg.solve`; of its memory x, r, p, q = A p and `own` are used."""
    x = work.x
    bb = cg.enter(A, A.subdomains[0], b, w, x, work.own)
    bb += cg.enter(A, A.subdomains[1], b, w, x, second.far) + cg.enter(A, A.subdomains[2], b, w, x, work.own)
    rr = sweep(A, work, second, hierarchy, RESIDUAL, 0.0, 0.0)  # 1: r = b − A x
    target = tolerance * tolerance * bb
    if cg.is_solved(A, rr, bb, target, w):
        return 0, CONVERGED
    if sweep(A, work, second, hierarchy, PREPARE, 0.0, 0.0) > 0.0 or not multigrid.prepare_coarse(hierarchy, False):
        return 0, INDEFINITE
    rz = 1.0
    for iteration in range(1, limit + 1):  # 2: for j = 0, 1, … until convergence
        size = sqrt(rr)
        sweep(A, work, second, hierarchy, DESCEND, size, 0.0)
        multigrid.coarse_cycle(hierarchy)
        rz_new = size * sweep(A, work, second, hierarchy, ASCEND, 0.0, 0.0)  # 6 of the last j: z = M⁻¹ r
        beta = rz_new / rz if iteration > 1 else 0.0  # 7: β = (r, z) / (r, z) before
        rz = rz_new
        curvature = sweep(A, work, second, hierarchy, FOLLOW, size, beta)  # 8: p = z + β p, q = A p
        if not curvature > 0.0:
            return iteration, INDEFINITE
        rr = sweep(A, work, second, hierarchy, STEP, rz / curvature, 0.0)  # 3, 4, 5: α, x += α p, r −= α q
        if rr <= target:
            cg.leave(A, x, w)
            return iteration, CONVERGED
    return limit, LIMIT


@kernel
def sweep(A, work, second, hierarchy, phase, first, other):
    """A pass over all rows with its parameters; returns its sum over the rows."""
    worker = second.worker
    serves = worker.flags[SERVES] == 1
    total = act(A, work, second.far, hierarchy, 2, phase, first, other)
    if serves:
        worker.message[0, 1], worker.message[0, 2] = first, other
        two_threads.post(worker, phase)
    total += act(A, work, second.far, hierarchy, 0, phase, first, other)
    if serves and not two_threads.claim(worker):
        two_threads.wait(worker)
        total += worker.message[0, 3]
    else:
        total += act(A, work, second.far, hierarchy, 1, phase, first, other)
        if serves:
            two_threads.done(worker)
    return total + act(A, work, second.far, hierarchy, AFTER, phase, first, other)


@kernel
def act(A, work, far, hierarchy, s, phase, first, other):
    """The part of subdomain s in a pass; returns its sum."""
    x, r, p, q = work.x, work.r, work.p, work.q
    if phase == DESCEND:
        multigrid.descend_part(A, hierarchy, s, r, first)
    elif phase == ASCEND:
        return multigrid.ascend_part(A, hierarchy, s, r)
    elif phase == FOLLOW:
        return follow_part(A, s, first, hierarchy.levels[0].z, other, p, q, far)
    elif phase == STEP and s != AFTER:
        return step(A, s, first, p, q, x, r)
    elif phase == PREPARE and s != AFTER:
        return multigrid.prepare_part(A, hierarchy, s, False)
    elif phase == RESIDUAL and s == 2:
        ssor.clear(A, A.subdomains[2], far)
    elif phase == RESIDUAL:
        if s == AFTER:
            ssor.gather(A, A.subdomains[2], far, work.own)
        return ssor.residual(A, A.subdomains[min(s, 2)], x, far if s == 1 else work.own, r)
    return 0.0


@kernel
def follow(A, scale, z, beta, p, q, far):
    """p = scale · z + β p and q = A p, z by rows; returns p·q. `far` is memory."""
    total = 0.0
    for s in (2, 0, 1, AFTER):
        total += follow_part(A, s, scale, z, beta, p, q, far)
    return total


@kernel
def follow_part(A, s, scale, z, beta, p, q, far):
    """The part of subdomain s in that; what 1 adds to q at other rows goes to `far` (n, 4)."""
    begin, end = rows(A, s)
    zero = splat(0.0)
    out = far if s == 1 else q
    if s == AFTER:
        for k in range(begin, end):
            i = index(A.order, k)
            store4(add(load4(q, i), load4(far, i)), q, i)
    else:
        factor, growth = splat(scale), splat(beta)
        for k in range(begin, end):
            i = index(A.order, k)
            store4(fma(growth, load4(p, i), mul(factor, load4(z, k))), p, i)
            store4(zero, out, i)
        if s == 2:
            ssor.clear(A, A.subdomains[2], far)
            return 0.0
    total = zero
    for k in range(begin, end):
        i = index(A.order, k)
        p_i = load4(p, i)
        wide = spread(p_i)
        sums = load4(out, i), zero, zero
        for e in range(index(A.row, k), index(A.row, k + 1)):
            j = index(A.column, e)
            sums = times_row(A.upper, e, p, j, sums)
            store4(times_spread(A.upper, e, wide, load4(out, j)), out, j)
        q_i = clear3(times_spread(A.diagonal, i, wide, added(sums)))
        store4(q_i, q, i)
        total = fma(p_i, q_i, total)
    return sum3(total)


@kernel
def step(A, s, alpha, p, q, x, r):
    """x += α p, r −= α q in subdomain s; returns |r|² there."""
    begin, end = rows(A, s)
    total, forward, back = splat(0.0), splat(alpha), splat(-alpha)
    for k in range(begin, end):
        i = index(A.order, k)
        store4(fma(forward, load4(p, i), load4(x, i)), x, i)
        r_i = fma(back, load4(q, i), load4(r, i))
        store4(r_i, r, i)
        total = fma(r_i, r_i, total)
    return sum3(total)


@kernel(nogil=True)
def serve(A, work, second, hierarchy):
    """The second thread: the part of subdomain 1 whenever a phase is posted, until the phase is STOP."""
    worker = second.worker
    two_threads.enter(worker)
    while True:
        phase = two_threads.next_phase(worker)
        if phase == STOP:
            return
        first, other = worker.message[0, 1], worker.message[0, 2]
        worker.message[0, 3] = act(A, work, second.far, hierarchy, 1, phase, first, other)
        two_threads.done(worker)
