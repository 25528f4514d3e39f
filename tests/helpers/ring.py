"""A ring of six vertices, one of them fixed, with two springs across: a linear system small enough to solve densely."""

import numpy as np

from clothfit.engine.solve import sparse
from helpers.physics import dense_matrix, stored

N = 6
FREE = np.array([True, True, False, True, True, True])
ALL = np.repeat(FREE, 3)
ENDS = np.array([[0, 1], [1, 2], [2, 3], [3, 4], [4, 5], [5, 0], [0, 3], [1, 4]], np.int32)


def matrix(pull=1.0, seed=3):
    """A mass on each vertex and springs of strength `pull` along random axes; positive definite when pull > 0."""
    rng = np.random.default_rng(seed)
    pattern, slot = sparse.pattern(ENDS, FREE)
    A = sparse.zeros(pattern, N)
    A.diagonal[:] = stored(np.eye(3))
    for (a, b), place in zip(ENDS, slot, strict=True):
        d = rng.normal(size=3)
        block = stored(pull * np.outer(d, d))
        A.diagonal[a] += block
        A.diagonal[b] += block
        A.upper[place] -= block
    return A


def right_side(seed=4):
    return np.random.default_rng(seed).normal(size=(N, 3)) * FREE[:, None]


def dense_solution(A, b):
    w = np.zeros(3 * N)
    w[ALL] = np.linalg.solve(dense_matrix(A)[np.ix_(ALL, ALL)], b.reshape(-1)[ALL])
    return w.reshape(N, 3)
