"""Conjugate gradients against a dense solve, and how they say they ended."""

import numpy as np
import pytest
from physics import dense_matrix, stored, times

from clothfit import cg, sparse

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


def solve(A, b, w, tolerance=1e-14, limit=200):
    return cg.solve(A, b, tolerance, limit, cg.workspace(A), w)


@pytest.mark.parametrize("guess", [0.0, 1.0])
def test_the_solution_is_that_of_a_dense_solver(guess):
    A, b = matrix(), right_side()
    w = guess * right_side(seed=9)
    iterations, ended = solve(A, b, w)
    assert ended == cg.CONVERGED
    assert 0 < iterations <= 2 * 3 * N  # 15 unknowns: exact arithmetic needs 15
    np.testing.assert_allclose(w, dense_solution(A, b), atol=1e-12)  # condition number below 100
    assert np.abs(w[2]).max() == 0.0


@pytest.mark.parametrize("tolerance", [1e-2, 1e-5, 1e-10])
def test_it_stops_at_the_first_residual_within_the_tolerance(tolerance):
    A, b, w = matrix(), right_side(), np.zeros((N, 3))
    iterations, ended = solve(A, b, w, tolerance)
    assert ended == cg.CONVERGED
    assert np.linalg.norm((b - times(A, w)) * FREE[:, None]) <= tolerance * np.linalg.norm(b) * (1 + 1e-6)  # rounding
    assert solve(A, b, np.zeros((N, 3)), tolerance, iterations - 1)[1] == cg.LIMIT


def test_a_good_guess_costs_no_iteration_and_is_left_alone():
    A, b = matrix(), right_side()
    w = dense_solution(A, b)
    before = w.copy()
    assert solve(A, b, w, 1e-10) == (0, cg.CONVERGED)
    assert w.tolist() == before.tolist()


def test_nothing_to_solve():
    w = np.zeros((N, 3))
    assert solve(matrix(), np.zeros((N, 3)), w) == (0, cg.CONVERGED)
    assert np.abs(w).max() == 0.0


def test_iterations_run_out():
    w = np.zeros((N, 3))
    assert solve(matrix(), right_side(), w, limit=2) == (2, cg.LIMIT)


def test_a_block_that_is_not_positive_definite_is_noticed_at_once():
    A = matrix()
    A.diagonal[4, sparse.YY] = -1.0
    assert solve(A, right_side(), np.zeros((N, 3))) == (0, cg.INDEFINITE)


def test_negative_curvature_is_noticed():
    A = matrix()
    A.upper[:] *= 4.0  # the diagonal blocks stay positive definite
    assert np.linalg.eigvalsh(dense_matrix(A)[np.ix_(ALL, ALL)]).min() < 0
    iterations, ended = solve(A, right_side(), np.zeros((N, 3)))
    assert ended == cg.INDEFINITE
    assert iterations > 0


def test_numbers_that_are_not_finite_do_not_pass_as_converged():
    b = right_side()
    b[1, 1] = np.nan
    assert solve(matrix(), b, np.zeros((N, 3)))[1] != cg.CONVERGED
