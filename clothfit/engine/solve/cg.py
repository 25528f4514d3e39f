"""Conjugate gradients with the symmetric successive over-relaxation (SSOR) preconditioner, for the matrix of a cloth.

Solves A w = b from a given first guess until |b − A w| ≤ tolerance · |b|. With A = L + D + Lᵀ, D its diagonal blocks,
and D̂ = D/ω, the preconditioner is (D̂ + L) D̂⁻¹ (D̂ + Lᵀ). It needs half the iterations of D alone, or a third, and
Eisenstat's trick makes one of them as cheap: in x̂ = (D̂ + Lᵀ) x and r̂ = (D̂ + L)⁻¹ r the matrix is

    Â = (D̂ + L)⁻¹ A (D̂ + Lᵀ)⁻¹,    Â p = t + (D̂ + L)⁻¹ (p − K t),    t = (D̂ + Lᵀ)⁻¹ p,    K = 2 D̂ − D,

two triangular solves that together read A once, and the preconditioner is D̂. The direction in w itself is t. The
residual r is not at hand: its norm is foretold from r̂ᵀ D̂ r̂, and when that says it is small enough, computed.

How it ended is said: a negative curvature proves that A is not positive definite (strongly compressed springs do
that), and then, or when the iterations run out, a direct solver takes over. The passes over the rows are in `ssor`;
on a large cloth a second thread takes its share of each (`team`). References: Y. Saad, Iterative Methods for Sparse
Linear Systems, 2nd ed., SIAM 2003, algorithm 9.1 and section 9.2.2; O. Axelsson, Iterative Solution Methods, Cambridge
1994, section 7.4, on ω.
"""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from typing import NamedTuple

import numpy as np

from clothfit.base.arrays import Array, aligned, staggered
from clothfit.engine.solve import multigrid, sparse, ssor
from clothfit.engine.solve import two_threads as team
from clothfit.engine.solve.multigrid import Coarsening
from clothfit.engine.solve.two_threads import SERVES, STOP, Team
from clothfit.kernels.kernel import kernel

CONVERGED, INDEFINITE, LIMIT, ABSENT = 0, 1, 2, 3
"""How a solve ended: within tolerance; A shown to be not positive definite; iterations used up; no such way."""

NEAR = 4.0
"""The residual is computed when its foretold square is within this factor of the target's."""

RESIDUAL, PREPARE, PRECONDITION, WEIGH = 0.0, 1.0, 2.0, 3.0
UPPER, LOWER, ADVANCE, CLEAR, CHECK = 4.0, 5.0, 6.0, 7.0, 8.0
"""Passes over the rows. No whole numbers: numba would compile all that follows anew for each that it knows."""


class Workspace(NamedTuple):
    """Memory of the solver, (n, 4) each but for the last two; lane 3 is 0."""

    x: Array  # w, as far as it is known
    r: Array  # r̂; at first r
    p: Array  # search direction
    t: Array  # (D̂ + Lᵀ)⁻¹ p, the direction in w
    q: Array  # Â p
    z: Array  # D̂ r̂
    own: Array  # right-hand side of a solve with D̂ + L, used up by it
    far: Array  # the same of the second share of rows
    inverse: Array  # (n + 1, 8), D̂⁻¹
    team: Team | None  # for large cloths, and the next for very large ones; types of their own, so that
    hierarchy: multigrid.Hierarchy | None  # others need not compile what serves these


def workspace(A: sparse.BlockMatrix, coarser: tuple[Coarsening, Coarsening] | None = None) -> Workspace:
    """Memory for systems with the matrix A; with the coarser levels of a cloth that has them."""
    n = len(A.diagonal) - 1
    x, r, p, t, q, z, own, far = staggered(8, n, 4)
    levels = multigrid.hierarchy(A, coarser) if coarser and len(coarser[0].slot) else None
    crew = team.team() if A.shares[1, 0] < A.shares[1, 1] else None
    return Workspace(x, r, p, t, q, z, own, far, aligned(n + 1, sparse.BLOCK), crew, levels)


@kernel
def solve(A, b, tolerance, limit, work, w):
    """Improve the guess w (n, 3) until it solves A w = b; rows of fixed vertices are left alone.

    Returns the iterations used and CONVERGED, INDEFINITE or LIMIT. A guess that is good enough costs 0 iterations.
    A small matrix has all its rows in one share, and each pass over them is one call; see `act` for the others.
    """
    x, r, p, t, q, z, own, far, inverse, crew, hierarchy = work
    whole, split = A.shares[0], A.shares[1, 0] < A.shares[1, 1]
    bb = ssor.enter(A, whole, b, w, x, own)
    if split:
        bb += ssor.enter(A, A.shares[1], b, w, x, far) + ssor.enter(A, A.shares[2], b, w, x, own)
    rr = sweep(A, work, crew, RESIDUAL, 0.0, 0.0) if split else ssor.residual(A, whole, x, own, r)
    target = tolerance * tolerance * bb
    if rr <= target < np.inf:  # an infinite residual is no smaller than an infinite right-hand side
        return 0, CONVERGED
    if bb == 0.0:  # no residual but 0 is small beside it
        ssor.clear(A, np.array([0, len(A.order)], np.int32), x)
        ssor.leave(A, x, w)
        return 0, CONVERGED
    iterations, ended = by_cycles(hierarchy, A, target, limit, work, w)
    if ended != ABSENT:
        return iterations, ended
    relaxation = ssor.omega(A)
    if not sparse.invert_diagonal(A, relaxation, inverse):
        return 0, INDEFINITE
    scale, kappa = 1.0 / relaxation, 2.0 / relaxation - 1.0
    if split:
        sweep(A, work, crew, PREPARE, 0.0, 0.0)
        sweep(A, work, crew, PRECONDITION, 0.0, 0.0)
        rz = sweep(A, work, crew, WEIGH, scale, 0.0)
    else:
        ssor.solve_lower(A, whole, inverse, r, r)
        rz = ssor.weigh(A, whole, scale, r, z)
    ratio = rr / rz
    beta = 0.0
    for iteration in range(1, limit + 1):
        if split:
            sweep(A, work, crew, UPPER, kappa, beta)
            curvature = sweep(A, work, crew, LOWER, 0.0, 0.0)
        else:
            ssor.solve_upper(A, whole, inverse, kappa, beta, z, p, t, own)
            curvature = ssor.apply_lower(A, whole, inverse, p, t, own, q)
        if not curvature > 0.0:
            return iteration, INDEFINITE
        alpha = rz / curvature
        if split:
            rz_new = sweep(A, work, crew, ADVANCE, alpha, scale)
        else:
            rz_new = ssor.advance(A, whole, alpha, scale, t, q, x, r, z)
        if rz_new * ratio <= NEAR * target:
            if split:
                sweep(A, work, crew, CLEAR, 0.0, 0.0)
                rr = sweep(A, work, crew, CHECK, scale, 0.0)
            else:
                ssor.clear(A, whole, own)
                rr = ssor.squared_residual(A, whole, scale, r, own)
            if rr <= target:
                ssor.leave(A, x, w)
                return iteration, CONVERGED
            ratio = rr / rz_new
        beta = rz_new / rz
        rz = rz_new
    return limit, LIMIT


@kernel
def by_cycles(hierarchy, A, target, limit, work, w):
    """The same by multigrid, from work.x with the residual work.r, where there are coarser levels."""
    if hierarchy is None:
        return 0, ABSENT
    for s in range(3):
        ssor.copy_rows(A, A.shares[s], work.r, hierarchy.levels[0].r)
    iterations, near = multigrid.solve(hierarchy, target, limit, work.x, work.q, work.p)
    if near:
        ssor.leave(A, work.x, w)
        return iterations, CONVERGED
    return max(iterations, 0), INDEFINITE if iterations < 0 else LIMIT


@kernel
def sweep(A, work, crew, phase, first, second):
    """A pass over all rows, the third share first where it goes against the order; returns its sum over the rows."""
    if crew is None:  # nor is there more than one share
        return 0.0
    shared = crew.flags[SERVES] == 1
    notes = crew.notes
    total = 0.0
    for turn in range(3):
        s = (turn + 2) % 3 if phase == UPPER else turn
        if shared and s == 1 and not team.claim(crew):
            team.wait(crew)
            total += notes[0, 3]
            continue
        if shared and s == 0:
            notes[0, 1], notes[0, 2] = first, second
            team.post(crew, phase)
        total += act(A, work, s, phase, first, second)
        if shared and s == 1:
            team.done(crew)
    return total


@kernel
def act(A, work, s, phase, first, second):
    """A pass over share s of the rows; returns its sum."""
    x, r, p, t, q, z, own, far, inverse, _, _ = work
    share = A.shares[s]
    if s == 1:
        own = far
    if s == 2 and phase in (RESIDUAL, PRECONDITION, LOWER, CHECK):
        ssor.gather(A, share, far, own)
    if phase == RESIDUAL:
        return ssor.residual(A, share, x, own, r)
    if phase == PREPARE:
        ssor.copy_rows(A, share, r, own)
    elif phase == PRECONDITION:
        ssor.solve_lower(A, share, inverse, own, r)
    elif phase == WEIGH:
        return ssor.weigh(A, share, first, r, z)
    elif phase == UPPER:
        ssor.solve_upper(A, share, inverse, first, second, z, p, t, own)
    elif phase == LOWER:
        return ssor.apply_lower(A, share, inverse, p, t, own, q)
    elif phase == ADVANCE:
        return ssor.advance(A, share, first, second, t, q, x, r, z)
    elif phase == CLEAR:
        ssor.clear(A, share, own)
    elif phase == CHECK:
        return ssor.squared_residual(A, share, first, r, own)
    return 0.0


@kernel(nogil=True)
def serve(A, work):
    """The second thread's share of every pass, until it is told to stop."""
    crew = work.team
    team.enter(crew)
    while True:
        phase = team.next_phase(crew)
        if phase == STOP:
            return
        crew.notes[0, 3] = act(A, work, 1, phase, crew.notes[0, 1], crew.notes[0, 2])
        team.done(crew)


@contextmanager
def helped(A: sparse.BlockMatrix, work: Workspace) -> Iterator[None]:
    """Within, a second thread does its share in solves with this matrix and workspace, where its share is not empty."""
    if work.team is None:
        yield
        return
    with team.serving(work.team, lambda: serve(A, work)):
        yield
