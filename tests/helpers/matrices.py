"""Cloths that are square grids, and matrices of them, for tests of what large cloths need."""

from typing import Any

import numpy as np

from clothfit.base.arrays import Array, Flags, Indices
from clothfit.engine.solve import sparse
from clothfit.meshes import mesh
from helpers.physics import dense_matrix, stored


def joined(side: int) -> Indices:
    """The springs (S, 2) of a grid of side² vertices, row by row: along edges, and across them."""
    made = mesh.springs(mesh.plane(side - 2, 1.0), 1.0)
    return np.asarray(made.ends, np.int32)


def scrambled(ends: Indices, n: int, seed: int = 8) -> Indices:
    """The same springs where the n vertices are numbered at random."""
    return np.random.default_rng(seed).permutation(n).astype(np.int32)[ends]


def free_but(n: int, *fixed: int) -> Flags:
    """Which of n vertices are free."""
    return ~np.isin(np.arange(n), fixed)


def matrix(
    ends: Indices, free: Flags, pull: float = 1.0, mass: float = 1.0, seed: int = 3, even: bool = False
) -> sparse.BlockMatrix:
    """A mass on each vertex and springs of strength `pull`, along random axes, or along all three where `even`.

    Its smallest eigenvalue is the mass, or more, when pull ≥ 0.
    """
    d = np.random.default_rng(seed).normal(size=(len(ends), 3))
    blocks = stored(pull * (np.tile(np.eye(3), (len(ends), 1, 1)) if even else d[:, :, None] * d[:, None, :]))
    pattern, slot = sparse.pattern(ends, free)
    A = sparse.zeros(pattern, len(free))
    A.diagonal[:] = stored(mass * np.eye(3))
    np.add.at(A.diagonal, ends[:, 0], blocks)
    np.add.at(A.diagonal, ends[:, 1], blocks)
    np.subtract.at(A.upper, slot, blocks)
    return A


def right_side(free: Flags, seed: int = 4) -> Array:
    """Random b (n, 3), 0 at fixed vertices."""
    return np.random.default_rng(seed).normal(size=(len(free), 3)) * free[:, None]


def dense_solution(A: sparse.BlockMatrix, b: Array) -> Array:
    """w (n, 3) with A w = b, 0 at fixed vertices."""
    unknown = (3 * A.order[:, None] + np.arange(3)).reshape(-1)
    w = np.zeros(b.size)
    w[unknown] = np.linalg.solve(dense_matrix(A)[np.ix_(unknown, unknown)], b.reshape(-1)[unknown])
    return w.reshape(b.shape)


def in_order(A: sparse.BlockMatrix) -> Array:
    """The dense matrix (3m, 3m) of the free vertices, in the order of sweep."""
    unknown = (3 * A.order[:, None] + np.arange(3)).reshape(-1)
    return np.asarray(dense_matrix(A)[np.ix_(unknown, unknown)])


def lanes_of(vector: Array, fill: float = 0.0) -> Array:
    """A vector (n, 3) as the solvers keep it, (n, 4)."""
    return np.ascontiguousarray(np.column_stack([vector, np.full(len(vector), fill)]))


def parts(A: sparse.BlockMatrix, omega: float) -> tuple[Array, Array, Array]:
    """D, D̂ + L and D̂ + Lᵀ of `in_order`, with D̂ = D/ω, dense."""
    whole = in_order(A)
    block = np.arange(len(whole)) // 3
    D: Any = np.where(block[:, None] == block, whole, 0.0)
    lower = np.where(block[:, None] > block, whole, 0.0) + D / omega
    return D, lower, lower.T
