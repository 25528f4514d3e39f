"""The linear solve of a step: conjugate gradients, and a direct factorisation where they cannot be trusted.

Conjugate gradients need a positive definite matrix; strongly compressed springs make it indefinite, and very stiff
scenes need more iterations than a factorisation costs. The system is the same either way, so the motion stays the one
that the scene means; every such solve is counted.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numba import objmode

from clothfit import cg, sparse
from clothfit.arrays import Array, Indices
from clothfit.kernel import kernel
from clothfit.vectors import copy

SYMMETRIC: dict[str, Any] = {
    "permc_spec": "MMD_AT_PLUS_A", "diag_pivot_thresh": 1e-3, "options": {"SymmetricMode": True},
}  # fmt: skip
"""Of SuperLU: pivots near the diagonal keep the factors sparse and take half the time of the best ones."""

SOLVED = 1e-10
"""A residual, relative, with which such pivots were good enough; else the factorisation is done with the best ones."""


@kernel
def solve(A, b, tolerance, work, w):
    """Solve A w = b, w (n, 3) holding a first guess; returns the CG iterations and the direct solves (0 or 1) used."""
    limit = 300 + len(b) // 4  # about the price of a factorisation, from 500 to 10,000 vertices
    iterations, ended = cg.solve(A, b, tolerance, limit, work, w)
    if ended == cg.CONVERGED:
        return iterations, 0
    order, row, column, shares, diagonal, upper = A
    with objmode(solution="float64[:, ::1]"):
        solution = factorise_and_solve(order, row, column, shares, diagonal, upper, b)
    copy(solution, w)
    return iterations, 1


def factorise_and_solve(
    order: Indices, row: Indices, column: Indices, shares: Indices, diagonal: Array, upper: Array, b: Array
) -> Array:
    """Solve A w = b by a sparse LU factorisation of the free rows; NaN where A is singular or not finite."""
    from scipy.sparse.linalg import splu

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
        if np.linalg.norm(A @ found - known) <= SOLVED * np.linalg.norm(known):
            break
    solution[free] = found.reshape(-1, 3)
    return solution
