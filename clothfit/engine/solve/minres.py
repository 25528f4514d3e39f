"""Minimal residuals for symmetric matrices that are not positive definite, preconditioned by `multigrid`.

In a strongly compressed cloth a few eigenvalues of A are negative. Conjugate gradients divide by curvatures, which may
then vanish; here the residual, in the norm of M⁻¹, is the least over the same Krylov space whatever the signs. Lanczos'
recurrence, v being its vectors and α and β the entries of the tridiagonal matrix,

    β⁺ r⁺ = A v − (α/β) r − (β/β⁻) r⁻,    v = M⁻¹ r / β,    β = √(r·M⁻¹ r)

is turned into an upper triangle of three diagonals by one reflection (c, s) in each step. M must be positive definite,
for which it suffices that the diagonal blocks of its levels are.

What is minimised is not |b − A w|, so that is computed when its prediction is small enough. Near a singular matrix w is
so long that A w cannot be computed to the tolerance; then it is enough that what is missing is rounding.

Reference: C. C. Paige, M. A. Saunders, Solution of sparse indefinite systems of linear equations, SIAM Journal on
Numerical Analysis 12, 1975.
"""

from __future__ import annotations

from math import sqrt

import numpy as np

from clothfit.engine.solve import cg, multigrid, ssor
from clothfit.engine.solve.cg import CHECK_WITHIN, CONVERGED, INDEFINITE, LIMIT
from clothfit.engine.solve.cg_multigrid import follow
from clothfit.engine.solve.sparse import times
from clothfit.kernels.kernel import kernel
from clothfit.kernels.lanes.operations import fma, load3, load4, mul, splat, store4, sub, sum3

MOST_ITERATIONS = 500
"""Iterations: some hundred take as long as a factorisation of a cloth of 256² vertices, in a fifth of its memory."""

ROUNDING = 1e-14
"""What sums of some dozen products lose, relative to the largest, |D w|."""


@kernel(apart=(0, 0))
def solve(A, b, tolerance, work, spare, hierarchy, w):
    """Improve the guess w (n, 3) until |b − A w| ≤ tolerance · |b|, or rounding; returns what `cg.solve` does:
    INDEFINITE where the preconditioner is not positive definite. `spare` (n, 4) is memory.
    """
    x, r_before, r, product, v, w_old, w_new = work.x, work.r, work.q, work.t, work.p, work.z, work.own
    fine, whole = hierarchy.levels[0], np.array([0, len(A.order)])
    bb = cg.enter(A, whole, b, w, x, w_new)
    rr = ssor.residual(A, whole, x, w_new, r)
    target = tolerance * tolerance * bb
    if cg.is_solved(A, rr, bb, target, w):
        return 0, CONVERGED
    if not multigrid.prepare(A, hierarchy, True):
        return 0, INDEFINITE
    for vector in (r_before, v, w_old, w_new):
        clear(A, vector)
    size = sqrt(rr)
    square = multigrid.precondition(A, hierarchy, r, size)
    if not square > 0.0:
        return 0, INDEFINITE
    beta, beta_before = sqrt(square), 1.0
    rest, ratio, within = beta, rr / square, CHECK_WITHIN  # of the residual in the norm of M⁻¹
    c, s, above, beyond = -1.0, 0.0, 0.0, 0.0
    for iteration in range(1, MOST_ITERATIONS + 1):
        follow(A, size / beta, fine.z, 0.0, v, product, spare)
        alpha = subtract(A, beta / beta_before if iteration > 1 else 0.0, r_before, product, v)
        rr = subtract(A, alpha / beta, r, product, product)
        r_before, r, product = r, product, r_before
        size = sqrt(rr)
        square = multigrid.precondition(A, hierarchy, r, size) if rr > 0.0 else 0.0
        if not square >= 0.0:
            return iteration, INDEFINITE
        beta_before, beta = beta, sqrt(square)
        far, near = beyond, c * above + s * alpha  # the column of the triangle, and what the reflection leaves of it
        corner, beyond, above = s * above - c * alpha, s * beta, -c * beta
        length = sqrt(corner * corner + beta * beta)
        if not length > 0.0:
            return iteration, INDEFINITE
        c, s = corner / length, beta / length
        move(A, (1.0 / length, -far / length, -near / length), v, w_old, w_new, c * rest, x)
        w_old, w_new = w_new, w_old
        rest *= s
        if rest * rest * ratio <= within * target or beta == 0.0:
            rr, rounding = missing(A, b, x, fine.z, product, spare)
            if rr <= max(target, rounding):
                cg.leave(A, x, w)
                return iteration, CONVERGED
            if beta == 0.0:
                return iteration, INDEFINITE
            ratio, within = rr / (rest * rest), 1.0
    return MOST_ITERATIONS, LIMIT


@kernel
def clear(A, vector):
    """vector = 0."""
    for i in A.order:
        store4(splat(0.0), vector, i)


@kernel
def subtract(A, factor, r, out, other):
    """out −= factor · r; returns out·other, which may be out itself."""
    back, total = splat(-factor), splat(0.0)
    for i in A.order:
        out_i = fma(back, load4(r, i), load4(out, i))
        store4(out_i, out, i)
        total = fma(out_i, load4(other, i), total)
    return sum3(total)


@kernel
def move(A, factors, v, w_old, w_new, phi, x):
    """w_old = f₀ v + f₁ w_old + f₂ w_new, the next direction, and x += φ times that."""
    f0, f1, f2, along = splat(factors[0]), splat(factors[1]), splat(factors[2]), splat(phi)
    for i in A.order:
        d = fma(f0, load4(v, i), fma(f1, load4(w_old, i), mul(f2, load4(w_new, i))))
        store4(d, w_old, i)
        store4(fma(along, d, load4(x, i)), x, i)


@kernel
def missing(A, b, x, z, out, spare):
    """|b − A x|², and what of it rounding may be; z is any vector of numbers, `out` becomes A x,
    `spare` is memory.
    """
    follow(A, 0.0, z, 1.0, x, out, spare)
    total, zero, largest = splat(0.0), splat(0.0), splat(0.0)
    for i in A.order:
        r_i = sub(load3(b, i), load4(out, i))
        total = fma(r_i, r_i, total)
        d_i = times(A.diagonal, i, load4(x, i), zero)
        largest = fma(d_i, d_i, largest)
    return sum3(total), ROUNDING * ROUNDING * sum3(largest)
