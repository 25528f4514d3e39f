"""The Cholesky factor within an envelope: against dense algebra, on matrices of grids, of a random graph and of pieces
apart.
"""

import numpy as np
import pytest
from scipy.sparse import block_diag, csr_array, random_array

from clothfit.derivative.envelope_cholesky import PANEL, envelope, factorise, solve

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


@pytest.mark.parametrize("columns", [1, 7, 8])
@pytest.mark.parametrize("name", MATRICES)
def test_the_solution_is_that_of_dense_algebra(name, columns):
    A = MATRICES[name]
    own, right = envelope(A), np.random.default_rng(2).normal(size=(A.shape[0], columns))
    L, kept = factorise(own, A.data), right.copy()
    found = solve(own, L, right)
    np.testing.assert_allclose(found, np.linalg.solve(A.toarray(), right), rtol=0, atol=ROUNDING * np.abs(found).max())
    np.testing.assert_array_equal(right, kept)


@pytest.mark.parametrize("name", MATRICES)
def test_the_factor_is_that_of_dense_algebra(name):
    A = MATRICES[name]
    own = envelope(A)
    panels, expected = factorise(own, A.data), np.linalg.cholesky(A.toarray()[np.ix_(own.order, own.order)])
    for i, row in enumerate(expected):
        p, r = divmod(i, PANEL)
        begin = PANEL * own.first[p]
        assert not row[:begin].any()
        found = panels[own.start[p] : own.start[p] + i - begin + 1, r]
        np.testing.assert_allclose(found[:-1], row[begin:i], rtol=0, atol=ROUNDING * np.abs(row).max())
        np.testing.assert_allclose(1.0 / found[-1], row[i], rtol=ROUNDING)


def test_a_matrix_that_is_not_positive_definite_has_no_factor():
    A = grid(5, 9).toarray()
    A[20, 20] = -1.0
    A = csr_array(A)
    assert factorise(envelope(A), A.data) is None
