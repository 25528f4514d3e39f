"""Preconditioned conjugate gradients for the symmetric 3×3-block matrix of a cloth.

Solves A w = b from a given first guess until |b − A w| ≤ tolerance · |b|, with the inverses of the diagonal blocks as
preconditioner. It says how it ended: a negative curvature pᵀ A p proves that A is not positive definite (strongly
compressed springs do that), and then, or when the iterations run out, a direct solver takes over. Reference: Y. Saad,
Iterative Methods for Sparse Linear Systems, 2nd ed., SIAM 2003, algorithm 9.1 (its line numbers stand at the right).
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from clothfit import sparse
from clothfit.arrays import Array
from clothfit.kernel import kernel
from clothfit.vectors import dot

CONVERGED, INDEFINITE, LIMIT = 0, 1, 2
"""How a solve ended: within tolerance; A shown to be not positive definite; iterations used up."""


class Workspace(NamedTuple):
    """Memory of the solver, (n, 3) each but for the preconditioner."""

    r: Array  # residual
    p: Array  # search direction
    q: Array  # A p
    inverse: Array  # (n, 6), inverse diagonal blocks


def workspace(n: int) -> Workspace:
    """Memory for a system of n vertices."""
    return Workspace(np.zeros((n, 3)), np.zeros((n, 3)), np.zeros((n, 3)), np.zeros((n, 6)))


@kernel
def precondition(inverse, r, i):
    """z_i = (diagonal block)⁻¹ r_i."""
    return (
        inverse[i, 0] * r[i, 0] + inverse[i, 1] * r[i, 1] + inverse[i, 2] * r[i, 2],
        inverse[i, 1] * r[i, 0] + inverse[i, 3] * r[i, 1] + inverse[i, 4] * r[i, 2],
        inverse[i, 2] * r[i, 0] + inverse[i, 4] * r[i, 1] + inverse[i, 5] * r[i, 2],
    )


@kernel
def solve(A, free, b, tolerance, limit, work, w):
    """Improve the guess w (n, 3) until it solves A w = b; b and w are zero at fixed vertices.

    Returns the iterations used and CONVERGED, INDEFINITE or LIMIT. A guess that is good enough costs 0 iterations.
    """
    r, p, q, inverse = work
    n = len(b)
    target = tolerance * tolerance * dot(b, b)
    sparse.multiply(A, w, q)
    rr = 0.0
    for i in range(n):
        for c in range(3):
            r[i, c] = b[i, c] - q[i, c] if free[i] else 0.0  # 1
            rr += r[i, c] * r[i, c]
    if rr <= target:
        return 0, CONVERGED
    if not sparse.invert_diagonal(A, free, inverse):
        return 0, INDEFINITE
    rz = 0.0
    for i in range(n):
        p[i, 0], p[i, 1], p[i, 2] = precondition(inverse, r, i)  # 1
        rz += r[i, 0] * p[i, 0] + r[i, 1] * p[i, 1] + r[i, 2] * p[i, 2]
    for iteration in range(1, limit + 1):  # 2
        sparse.multiply(A, p, q)
        curvature = dot(p, q)
        if not curvature > 0.0:
            return iteration, INDEFINITE
        alpha = rz / curvature  # 3
        rr, rz_new = 0.0, 0.0
        for i in range(n):
            for c in range(3):
                w[i, c] += alpha * p[i, c]  # 4
                r[i, c] -= alpha * q[i, c]  # 5
                rr += r[i, c] * r[i, c]
            z0, z1, z2 = precondition(inverse, r, i)  # 6
            rz_new += r[i, 0] * z0 + r[i, 1] * z1 + r[i, 2] * z2
        if rr <= target:
            return iteration, CONVERGED
        beta = rz_new / rz  # 7
        rz = rz_new
        for i in range(n):
            z0, z1, z2 = precondition(inverse, r, i)
            p[i, 0] = z0 + beta * p[i, 0]  # 8
            p[i, 1] = z1 + beta * p[i, 1]
            p[i, 2] = z2 + beta * p[i, 2]
    return limit, LIMIT
