"""The linear solve of a step: conjugate gradients, and a direct factorisation where they cannot be trusted.

Cloths are solved by `cg`, large ones by `cg_multigrid`. Very stiff scenes need more iterations than a factorisation
costs, and a matrix that is not positive definite is beyond conjugate gradients: the caller chooses whether it is then
refused or solved as well, by `minres` where a cloth is large, as the factors of its matrix take gigabytes, else
directly. Every direct solve is counted.
"""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any, NamedTuple

import numpy as np

from clothfit.base.arrays import Array, Indices
from clothfit.engine.solve import cg, cg_multigrid, minres, sparse, two_threads
from clothfit.engine.solve.sparse import BlockMatrix
from clothfit.kernels.kernel import kernel, objmode, record
from clothfit.kernels.vectors import copy

SYMMETRIC: dict[str, Any] = {
    "permc_spec": "MMD_AT_PLUS_A", "diag_pivot_thresh": 1e-3, "options": {"SymmetricMode": True},
}  # fmt: skip
"""Of SuperLU: pivots near the diagonal keep the factors sparse and take half the time of the best ones."""

SOLVED = 1e-10
"""A residual, relative, with which such pivots were good enough; else the factorisation is done with the best ones."""

USABLE = 1e-10
"""The largest backward error of a solution; one with a larger error does not even solve a system near this one."""


@record
class Workspace(NamedTuple):
    """Memory of the solver."""

    cg: cg.Workspace
    large: cg_multigrid.Large  # of large cloths, else empty


def workspace(A: BlockMatrix) -> Workspace:
    """Memory for systems with the matrix A, by its pattern."""
    return Workspace(cg.workspace(len(A.diagonal) - 1), cg_multigrid.large(A))


@contextmanager
def served(A: BlockMatrix, work: Workspace) -> Iterator[None]:
    """Within the block a second thread, where there is one, serves solves with this matrix and workspace."""
    large = work.large
    if not len(large.second.far):
        yield
    else:
        with two_threads.serving(large.second.worker, lambda: cg_multigrid.serve(A, work.cg, *large)):
            yield


@kernel(apart=(0, 0, True))
def solve(A, b, tolerance, work, w, anyhow):
    """Solve A w = b, w (n, 3) holding a first guess, unless A is seen not to be positive definite, or `anyhow`.

    Returns the CG iterations and the direct solves (0 or 1) used, and whether w is the solution.
    """
    limit = 300 + len(b) // 4  # about the price of a factorisation, from 500 to 10,000 vertices
    second, hierarchy = work.large
    large = len(second.far) > 0
    if large:
        iterations, ended = cg_multigrid.solve(A, b, tolerance, limit, work.cg, second, hierarchy, w)
    else:
        iterations, ended = cg.solve(A, b, tolerance, limit, work.cg, w)
    if large and ended == cg.INDEFINITE and anyhow:
        more, ended = minres.solve(A, b, tolerance, work.cg, second.far, hierarchy, w)
        iterations += more
    if ended == cg.CONVERGED:
        return iterations, 0, True
    work.cg.p[:] = 0.0  # the next solve multiplies them by 0, and they may have grown beyond all numbers
    work.cg.q[:] = 0.0
    if ended == cg.INDEFINITE and not anyhow:
        return iterations, 0, False
    solve_directly(A, b, w)
    return iterations, 1, True


@kernel
def solve_directly(A, b, w):
    """Solve A w = b by a factorisation."""
    order, row, column, subdomains, diagonal, upper, _ = A
    with objmode(solution="float64[:, ::1]"):
        solution = factorise_and_solve(order, row, column, subdomains, diagonal, upper, b)
    copy(solution, w)


def factorise_and_solve(
    order: Indices, row: Indices, column: Indices, subdomains: Indices, diagonal: Array, upper: Array, b: Array
) -> Array:
    """Solve A w = b by a sparse LU factorisation of the free rows; NaN where A is singular or not finite, or where the
    result is no solution.
    """
    from scipy.sparse.linalg import norm, splu

    free = np.sort(order)
    solution = np.zeros(b.shape)
    if not (np.isfinite(diagonal[order]).all() and np.isfinite(upper[: len(column)]).all()):
        return np.full(b.shape, np.nan)  # the factorisation divides by infinity and gives finite numbers
    A = sparse.to_scipy(order, row, column, subdomains, diagonal, upper)
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
