"""The Cholesky factor in blocks: against dense algebra, on matrices of grids, of random graphs and of pieces apart."""

import numpy as np
import pytest
from scipy.sparse import block_diag, csr_array, random_array

from clothfit.derivative.block_cholesky import Cut, blocks_of, factorise, is_cheaper, solve

ROUNDING = 1e-12
"""Relative; the matrices' conditions are below 100."""


def grid(rows, columns):
    """A Laplacian of a grid with springs to the second neighbours, plus the identity."""
    n = rows * columns
    place = np.arange(n).reshape(rows, columns)
    A = np.eye(n)
    for step in ((0, 1), (1, 0), (1, 1), (0, 2), (2, 0)):
        a = place[: rows - step[0], : columns - step[1]].ravel()
        for i, j in zip(a, a + step[0] * columns + step[1], strict=True):
            A[[i, j], [i, j]] += 1.0
            A[[i, j], [j, i]] -= 1.0
    return csr_array(A)


def scattered(n, seed):
    """A diagonally dominant matrix of a random graph."""
    half = random_array((n, n), density=0.03, rng=np.random.default_rng(seed))
    both = csr_array(half + half.T)
    return csr_array(both + csr_array(np.diag(2.0 + np.asarray(both.sum(axis=1)).ravel())))


MATRICES = {
    "a long grid": grid(40, 5),
    "a square grid": grid(14, 14),
    "one unknown": csr_array([[4.0]]),
    "no coupling": csr_array(np.diag(np.arange(1.0, 70.0))),
    "a random graph": scattered(120, 1),
    "pieces apart": csr_array(block_diag([grid(6, 6).toarray(), grid(3, 20).toarray(), np.eye(5)])),
}


def factor_of(A):
    """The factor of a matrix in the blocks of its pattern."""
    return factorise(*Cut(A, blocks_of(A))(A.data))


@pytest.mark.parametrize("name", MATRICES)
def test_factor_and_solution_are_those_of_dense_algebra(name):
    A = MATRICES[name]
    blocks, right = blocks_of(A), np.random.default_rng(2).normal(size=(A.shape[0], 7))
    (diagonal, below), kept = factor_of(A), right.copy()
    L = np.zeros(A.shape)  # the lower triangle in the order of the blocks
    for k, (begin, end) in enumerate(zip(blocks.ends[:-1], blocks.ends[1:], strict=True)):
        L[begin:end, begin:end] = np.tril(diagonal[k])
        L[begin:end, blocks.ends[k - 1] if k else 0 : begin] = below[k]
    ordered = A.toarray()[np.ix_(blocks.order, blocks.order)]
    np.testing.assert_allclose(L @ L.T, ordered, rtol=0, atol=ROUNDING * np.abs(ordered).max())
    found = solve(diagonal, below, blocks, right)
    np.testing.assert_allclose(found, np.linalg.solve(A.toarray(), right), rtol=0, atol=ROUNDING * np.abs(found).max())
    np.testing.assert_array_equal(right, kept)


def test_a_matrix_that_is_not_positive_definite_has_no_factor():
    A = grid(5, 9).toarray()
    A[20, 20] = -1.0
    A = csr_array(A)
    assert factor_of(A) is None


def test_of_a_grid_blocks_take_fewer_operations_and_of_a_full_matrix_they_do_not():
    A = grid(20, 20)
    assert is_cheaper(blocks_of(A), 100)
    full = csr_array(np.ones((60, 60)) + 60 * np.eye(60))
    assert not is_cheaper(blocks_of(full), 1)
