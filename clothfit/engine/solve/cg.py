"""Conjugate gradients with the symmetric successive over-relaxation (SSOR) preconditioner, for the matrix of a cloth.

Solves A w = b from a given first guess until |b − A w| ≤ tolerance · |b|. With A = L + D + Lᵀ, D its diagonal blocks,
and D̂ = D/ω, the preconditioner is M = (D̂ + L) D̂⁻¹ (D̂ + Lᵀ). It needs half the iterations of D alone, or a third, and
Eisenstat's trick makes one of them as cheap. In x̂ = (D̂ + Lᵀ) x and r̂ = (D̂ + L)⁻¹ r the matrix is

    Â = (D̂ + L)⁻¹ A (D̂ + Lᵀ)⁻¹,    Â p = t + (D̂ + L)⁻¹ (p − K t),    t = (D̂ + Lᵀ)⁻¹ p,    K = 2 D̂ − D,

two triangular solves that together read A once, and the preconditioner of Â is D̂: z = D̂ r̂, without a solve. The
direction in w itself is t. The residual r is not at hand: its norm is predicted from r̂ᵀ D̂ r̂, and when the prediction
is small enough, r is computed.

A negative curvature pᵀ Â p proves that A is not positive definite (strongly compressed springs do that).

References: Y. Saad, Iterative Methods for Sparse Linear Systems, 2nd ed., SIAM 2003, algorithm 9.1, whose lines are
numbered below, and section 9.2.2; O. Axelsson, Iterative Solution Methods, Cambridge 1994, section 7.4, on ω.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from clothfit.base.arrays import Array, aligned, staggered
from clothfit.engine.solve import sparse, ssor
from clothfit.kernels.kernel import kernel
from clothfit.kernels.lanes.operations import add, column, fma, lane0, lane2, load3, load4, splat, store3, store4, sum3

CONVERGED, INDEFINITE, LIMIT = 0, 1, 2
"""How a solve ended: within tolerance; A shown to be not positive definite; iterations used up."""

CHECK_WITHIN = 4.0
"""The residual is computed when its predicted square is within this factor of the target's."""


class Workspace(NamedTuple):
    """Memory of the solver, (n, 4) each but for the last; lane 3 is 0."""

    x: Array  # w, as far as it is known
    r: Array  # r̂; at first r
    p: Array  # search direction
    t: Array  # (D̂ + Lᵀ)⁻¹ p, the direction in w
    q: Array  # Â p
    z: Array  # D̂ r̂
    own: Array  # right-hand side of a solve with D̂ + L, which overwrites it
    inverse: Array  # (n + 1, 8), D̂⁻¹


def workspace(n: int) -> Workspace:
    """Memory for systems of n vertices."""
    x, r, p, t, q, z, own = staggered(7, n, 4)
    return Workspace(x, r, p, t, q, z, own, aligned(n + 1, sparse.BLOCK_SIZE))


@kernel
def solve(A, b, tolerance, limit, work, w):
    """Improve the guess w (n, 3) until it solves A w = b; rows of fixed vertices are left alone.

    Returns the iterations used, 0 for a guess that is good enough, and CONVERGED, INDEFINITE or LIMIT.
    """
    x, r, p, t, q, z, own, inverse = work
    whole = A.subdomains[0]
    bb = enter(A, whole, b, w, x, own)
    rr = ssor.residual(A, whole, x, own, r)  # 1: r = b − A x
    target = tolerance * tolerance * bb
    if is_solved(A, rr, bb, target, w):
        return 0, CONVERGED
    omega = relaxation(A)
    if not sparse.invert_diagonal(A, omega, inverse):
        return 0, INDEFINITE
    scale, kappa = 1.0 / omega, 2.0 / omega - 1.0  # D̂ = scale · D, K = kappa · D
    ssor.solve_lower(A, whole, inverse, r, r)  # r̂ = (D̂ + L)⁻¹ r
    rz = ssor.weigh(A, whole, scale, r, z)  # z = D̂ r̂
    ratio, beta = rr / rz, 0.0
    for iteration in range(1, limit + 1):  # 2: for j = 0, 1, … until convergence
        ssor.solve_upper(A, whole, inverse, kappa, beta, z, p, t, own)  # 8 of the last j: p = z + β p; t
        curvature = ssor.apply_lower(A, whole, inverse, p, t, own, q)  # q = Â p and pᵀ q
        if not curvature > 0.0:
            return iteration, INDEFINITE
        alpha = rz / curvature  # 3: α = (r, z) / (A p, p)
        rz_new = ssor.update(A, whole, alpha, scale, t, q, x, r, z)  # 4, 5, 6: x += α t, r̂ −= α q, z = D̂ r̂
        if rz_new * ratio <= CHECK_WITHIN * target:
            ssor.clear(A, whole, own)
            rr = ssor.squared_residual(A, whole, scale, r, own)
            if rr <= target:
                leave(A, x, w)
                return iteration, CONVERGED
            ratio = rr / rz_new
        beta, rz = rz_new / rz, rz_new  # 7: β = (r, z) / (r, z) before
    return limit, LIMIT


@kernel
def relaxation(A):
    """The relaxation factor ω: nearer 2 the smaller the mass is beside h² times the stiffness.

    The sum of a row's blocks is mostly mass: its part q of the diagonal falls with refinement. On cloths of 12² to 128²
    vertices the measured iterations are fewest near ω = 2/(1 + q^0.2), and few more around it.
    """
    low, high = splat(0.0), splat(0.0)
    for i in A.order:
        low = add(low, column(A.diagonal, i, 0))
        high = add(high, column(A.diagonal, i, 4))
    diagonal = lane0(low) + lane0(high) + lane2(high)
    low, high = splat(0.0), splat(0.0)
    for e in range(len(A.column)):
        low = add(low, column(A.upper, e, 0))
        high = add(high, column(A.upper, e, 4))
    q = 1.0 + 2.0 * (lane0(low) + lane0(high) + lane2(high)) / diagonal
    return 2.0 / (1.0 + min(max(q, 1e-5), 1.0) ** 0.2)



@kernel
def enter(A, subdomain, b, w, x, own):
    """x = w and own = b, (n, 3) each, at the rows of a subdomain; returns |b|² there."""
    bb = splat(0.0)
    for i in ssor.rows(A, subdomain)[0]:
        b_i = load3(b, i)
        bb = fma(b_i, b_i, bb)
        store4(b_i, own, i)
        store4(load3(w, i), x, i)
    return sum3(bb)



@kernel
def is_solved(A, rr, bb, target, w):
    """Whether nothing is left to do for a guess with |r|² = rr: it is within the target, or b = 0, and w becomes 0."""
    if rr <= target < np.inf:  # an infinite residual is no smaller than an infinite right-hand side
        return True
    if bb == 0.0:  # no residual but 0 is small beside it
        for i in A.order:
            store3(splat(0.0), w, i)
    return bb == 0.0



@kernel
def leave(A, x, w):
    """w (n, 3) = x."""
    for i in A.order:
        store3(load4(x, i), w, i)
