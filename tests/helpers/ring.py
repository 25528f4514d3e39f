"""A ring of six vertices, one of them fixed, with two springs across: a linear system small enough to solve densely."""

import numpy as np

from helpers import matrices
from helpers.matrices import dense_solution as dense_solution

N = 6
FREE = matrices.free_but(N, 2)
ALL = np.repeat(FREE, 3)
ENDS = np.array([[0, 1], [1, 2], [2, 3], [3, 4], [4, 5], [5, 0], [0, 3], [1, 4]], np.int32)


def matrix(pull=1.0, seed=3):
    """A mass on each vertex and springs of strength `pull` along random axes; positive definite when pull > 0."""
    return matrices.matrix(ENDS, FREE, pull, seed=seed)


def right_side(seed=4):
    return matrices.right_side(FREE, seed)
