"""Conjugate gradients with the symmetric successive over-relaxation (SSOR) preconditioner, for the matrix of a cloth.

Solves A w = b from a given first guess until |b − A w| ≤ tolerance · |b|. With A = L + D + Lᵀ, D its diagonal blocks,
and D̂ = D/ω, the preconditioner is (D̂ + L) D̂⁻¹ (D̂ + Lᵀ). It needs half the iterations of D alone, or a third, and
Eisenstat's trick makes one of them as cheap: in x̂ = (D̂ + Lᵀ) x and r̂ = (D̂ + L)⁻¹ r the matrix is

    Â = (D̂ + L)⁻¹ A (D̂ + Lᵀ)⁻¹,    Â p = t + (D̂ + L)⁻¹ (p − K t),    t = (D̂ + Lᵀ)⁻¹ p,    K = 2 D̂ − D,

two triangular solves that together read A once, and the preconditioner is D̂. The direction in w itself is t. The
residual r is not at hand: its norm is foretold from r̂ᵀ D̂ r̂, and when that says it is small enough, computed.

How it ended is said: a negative curvature proves that A is not positive definite (strongly compressed springs do
that), and then, or when the iterations run out, a direct solver takes over. References: Y. Saad, Iterative Methods for
Sparse Linear Systems, 2nd ed., SIAM 2003, algorithm 9.1 and section 9.2.2; O. Axelsson, Iterative Solution Methods,
Cambridge 1994, section 7.4, on ω.
"""

from __future__ import annotations

from typing import NamedTuple

from clothfit import sparse
from clothfit.arrays import Array, aligned
from clothfit.kernel import kernel
from clothfit.lanes import (
    add,
    clear3,
    fma,
    lane0,
    lane2,
    load,
    load3,
    mul,
    splat,
    spread0,
    spread1,
    spread2,
    store,
    store3,
    sub,
    sum3,
)  # fmt: skip
from clothfit.sparse import times, times_spread

CONVERGED, INDEFINITE, LIMIT = 0, 1, 2
"""How a solve ended: within tolerance; A shown to be not positive definite; iterations used up."""

NEAR = 4.0
"""The residual is computed when its foretold square is within this factor of the target's."""


class Workspace(NamedTuple):
    """Memory of the solver, (n, 4) each but for the inverses; lane 3 is 0."""

    r: Array  # r̂
    p: Array  # search direction
    t: Array  # (D̂ + Lᵀ)⁻¹ p, the direction in w
    q: Array  # Â p
    z: Array  # D̂ r̂
    u: Array  # right-hand side of the solve with D̂ + L
    inverse: Array  # (n + 1, 8), D̂⁻¹


def workspace(n: int) -> Workspace:
    """Memory for a system of n vertices."""
    r, p, t, q, z, u = (aligned(n, 4) for _ in range(6))
    return Workspace(r, p, t, q, z, u, aligned(n + 1, sparse.BLOCK))


@kernel
def solve(A, b, tolerance, limit, work, w):
    """Improve the guess w (n, 3) until it solves A w = b; rows of fixed vertices are left alone.

    Returns the iterations used and CONVERGED, INDEFINITE or LIMIT. A guess that is good enough costs 0 iterations.
    """
    r, p, t, q, z, u, inverse = work
    rr, bb = residual(A, b, w, r)
    target = tolerance * tolerance * bb
    if rr <= target:
        return 0, CONVERGED
    relaxation = omega(A)
    if not sparse.invert_diagonal(A, relaxation, inverse):
        return 0, INDEFINITE
    solve_lower(A, inverse, r)
    rz = weigh(A, 1.0 / relaxation, r, z)
    ratio = rr / rz
    beta = 0.0
    for iteration in range(1, limit + 1):
        solve_upper(A, inverse, 2.0 / relaxation - 1.0, z, beta, p, t, u)
        curvature = apply_lower(A, inverse, p, t, u, q)
        if not curvature > 0.0:
            return iteration, INDEFINITE
        rz_new = advance(A, rz / curvature, 1.0 / relaxation, t, q, w, r, z)
        if rz_new * ratio <= NEAR * target:
            rr = squared_residual(A, 1.0 / relaxation, r, u)
            if rr <= target:
                return iteration, CONVERGED
            ratio = rr / rz_new
        beta = rz_new / rz
        rz = rz_new
    return limit, LIMIT


@kernel
def omega(A):
    """The relaxation factor ω: nearer 2 the smaller the mass is beside h² times the stiffness.

    The sum of a row's blocks is mostly mass: q, its share in the diagonal, falls with refinement. By measurement on
    cloths of 12² to 128² vertices the fewest iterations are needed near 2/(1 + q^0.2), and few more around it.
    """
    low, high = splat(0.0), splat(0.0)
    for r in range(len(A.order)):
        i = A.order[r]
        low = add(low, load(A.diagonal, i, 0))
        high = add(high, load(A.diagonal, i, 4))
    diagonal = lane0(low) + lane0(high) + lane2(high)
    low, high = splat(0.0), splat(0.0)
    for e in range(len(A.column)):
        low = add(low, load(A.upper, e, 0))
        high = add(high, load(A.upper, e, 4))
    share = 1.0 + 2.0 * (lane0(low) + lane0(high) + lane2(high)) / diagonal
    return 2.0 / (1.0 + min(max(share, 1e-5), 1.0) ** 0.2)


@kernel
def residual(A, b, w, r):
    """r = b − A w of the free vertices; returns |r|² and |b|²."""
    for k in range(len(A.order)):
        i = A.order[k]
        store(load3(b, i), r, i, 0)
    rr, bb = splat(0.0), splat(0.0)
    zero = splat(0.0)
    for k in range(len(A.order)):
        i = A.order[k]
        w_i = sub(zero, load3(w, i))
        w0, w1, w2 = spread0(w_i), spread1(w_i), spread2(w_i)
        total = times_spread(A.diagonal, i, w0, w1, w2, load(r, i, 0))
        for e in range(A.row[k], A.row[k + 1]):
            j = A.column[e]
            total = sub(total, times(A.upper, e, load3(w, j), zero))
            store(times_spread(A.upper, e, w0, w1, w2, load(r, j, 0)), r, j, 0)
        total = clear3(total)
        store(total, r, i, 0)
        rr = fma(total, total, rr)
        b_i = load3(b, i)
        bb = fma(b_i, b_i, bb)
    return sum3(rr), sum3(bb)


@kernel
def solve_lower(A, inverse, r):
    """r ← (D̂ + L)⁻¹ r."""
    zero = splat(0.0)
    for k in range(len(A.order)):
        i = A.order[k]
        y = clear3(times(inverse, i, load(r, i, 0), zero))
        store(y, r, i, 0)
        push(A, k, sub(zero, y), r)


@kernel
def push(A, k, y, out):
    """out_j += B y for all blocks B of row k."""
    y0, y1, y2 = spread0(y), spread1(y), spread2(y)
    for e in range(A.row[k], A.row[k + 1]):
        j = A.column[e]
        store(times_spread(A.upper, e, y0, y1, y2, load(out, j, 0)), out, j, 0)


@kernel
def weigh(A, scale, r, z):
    """z = scale · D r; returns r·z."""
    total, factor = splat(0.0), splat(scale)
    for k in range(len(A.order)):
        i = A.order[k]
        r_i = load(r, i, 0)
        z_i = clear3(times(A.diagonal, i, mul(factor, r_i), splat(0.0)))
        store(z_i, z, i, 0)
        total = fma(r_i, z_i, total)
    return sum3(total)


@kernel
def solve_upper(A, inverse, kappa, z, beta, p, t, u):
    """p = z + β p, t = (D̂ + Lᵀ)⁻¹ p and u = p − K t, with K = κ D."""
    zero, growth, minus_kappa = splat(0.0), splat(beta), splat(-kappa)
    for k in range(len(A.order) - 1, -1, -1):
        i = A.order[k]
        p_i = fma(growth, load(p, i, 0), load(z, i, 0))
        store(p_i, p, i, 0)
        total = zero
        for e in range(A.row[k + 1] - 1, A.row[k] - 1, -1):  # the nearest vertex, whose t is the newest, last
            total = times(A.upper, e, load(t, A.column[e], 0), total)
        t_i = clear3(times(inverse, i, sub(p_i, total), zero))
        store(t_i, t, i, 0)
        store(times(A.diagonal, i, mul(minus_kappa, t_i), p_i), u, i, 0)


@kernel
def apply_lower(A, inverse, p, t, u, q):
    """q = t + (D̂ + L)⁻¹ u, u being used up; returns p·q."""
    zero, total = splat(0.0), splat(0.0)
    for k in range(len(A.order)):
        i = A.order[k]
        y = clear3(times(inverse, i, load(u, i, 0), zero))
        q_i = add(load(t, i, 0), y)
        store(q_i, q, i, 0)
        total = fma(load(p, i, 0), q_i, total)
        push(A, k, sub(zero, y), u)
    return sum3(total)


@kernel
def advance(A, alpha, scale, t, q, w, r, z):
    """w += α t, r −= α q, z = scale · D r; returns r·z."""
    total, step, back, factor = splat(0.0), splat(alpha), splat(-alpha), splat(scale)
    for k in range(len(A.order)):
        i = A.order[k]
        store3(fma(step, load(t, i, 0), load3(w, i)), w, i)
        r_i = fma(back, load(q, i, 0), load(r, i, 0))
        store(r_i, r, i, 0)
        z_i = clear3(times(A.diagonal, i, mul(factor, r_i), splat(0.0)))
        store(z_i, z, i, 0)
        total = fma(r_i, z_i, total)
    return sum3(total)


@kernel
def squared_residual(A, scale, r, u):
    """|(D̂ + L) r|², the residual of A w = b itself; u is scratch."""
    total, factor, zero = splat(0.0), splat(scale), splat(0.0)
    for k in range(len(A.order)):
        store(zero, u, A.order[k], 0)
    for k in range(len(A.order)):
        i = A.order[k]
        r_i = load(r, i, 0)
        own = times(A.diagonal, i, mul(factor, r_i), load(u, i, 0))
        total = fma(own, own, total)
        push(A, k, r_i, u)
    return sum3(total)
