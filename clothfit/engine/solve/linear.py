"""The linear solve of a step: conjugate gradients, and a direct factorisation where they cannot be trusted.

Very stiff scenes need more iterations than a factorisation costs, and a matrix that is not positive definite is beyond
conjugate gradients: that is said, or it is solved directly as well. Every direct solve is counted.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numba import objmode

from clothfit.base.arrays import Array, Indices
from clothfit.engine.solve import cg, sparse
from clothfit.kernels.kernel import kernel
from clothfit.kernels.vectors import copy

SYMMETRIC: dict[str, Any] = {
    "permc_spec": "MMD_AT_PLUS_A", "diag_pivot_thresh": 1e-3, "options": {"SymmetricMode": True},
}  # fmt: skip
"""Of SuperLU: pivots near the diagonal keep the factors sparse and take half the time of the best ones."""

SOLVED = 1e-10
"""A residual, relative, with which such pivots were good enough; else the factorisation is done with the best ones."""

USABLE = 1e-10
"""The largest backward error of a solution; one that is not even that of a system near this one is none."""


@kernel
def solve(A, b, tolerance, work, w, anyhow):
    """Solve A w = b, w (n, 3) holding a first guess, unless A is seen not to be positive definite, or `anyhow`.

    Returns the CG iterations and the direct solves (0 or 1) used, and whether w is the solution.
    """
    limit = 300 + len(b) // 4  # about the price of a factorisation, from 500 to 10,000 vertices
    iterations, ended = cg.solve(A, b, tolerance, limit, work, w)
    if ended == cg.CONVERGED:
        return iterations, 0, True
    work.p[:] = 0.0  # the next solve multiplies them by 0, and they may have grown beyond all numbers
    work.q[:] = 0.0
    if ended == cg.INDEFINITE and not anyhow:
        return iterations, 0, False
    solve_directly(A, b, w)
    return iterations, 1, True


@kernel
def solve_directly(A, b, w):
    """Solve A w = b by a factorisation."""
    order, row, column, shares, diagonal, upper = A
    with objmode(solution="float64[:, ::1]"):
        solution = factorise_and_solve(order, row, column, shares, diagonal, upper, b)
    copy(solution, w)


def factorise_and_solve(
    order: Indices, row: Indices, column: Indices, shares: Indices, diagonal: Array, upper: Array, b: Array
) -> Array:
    """Solve A w = b by a sparse LU factorisation of the free rows; NaN where A is singular or not finite, or what comes
    of it is no solution.
    """
    from scipy.sparse.linalg import norm, splu

    free = np.sort(order)
    solution = np.zeros(b.shape)
    if not (np.isfinite(diagonal[order]).all() and np.isfinite(upper[:-1]).all()):
        return np.full(b.shape, np.nan)  # the factorisation divides by infinity and gives finite numbers
    A = sparse.to_scipy(order, row, column, shares, diagonal, upper)
    known = b[free].reshape(-1)
    for options in (SYMMETRIC, {}):
        try:
            found = splu(A, **options).solve(known)
        except RuntimeError:  # exactly singular
            found = np.full(len(known), np.nan)
        missing = np.linalg.norm(A @ found - known)
        if missing <= SOLVED * np.linalg.norm(known):
            break
    if not missing <= USABLE * (norm(A) * np.linalg.norm(found) + np.linalg.norm(known)):
        return np.full(b.shape, np.nan)
    solution[free] = found.reshape(-1, 3)
    return solution
