"""Conjugate gradients against a dense solve, and how they say they ended."""

import numpy as np
import pytest
from helpers.physics import dense_matrix, times
from helpers.ring import ALL, FREE, N, dense_solution, matrix, right_side

from clothfit.engine.solve import cg, sparse

pytestmark = pytest.mark.slow  # compiles a fit


def solve(A, b, w, tolerance=1e-14, limit=200):
    return cg.solve(A, b, tolerance, limit, cg.workspace(N), w)


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


@pytest.mark.parametrize("value", [np.nan, np.inf, -np.inf, 1e200])  # the last has an infinite square
def test_numbers_that_are_not_finite_do_not_pass_as_converged(value):
    b = right_side()
    b[1, 1] = value
    assert solve(matrix(), b, np.zeros((N, 3)))[1] != cg.CONVERGED


def test_without_a_right_side_a_guess_becomes_zero():
    w = right_side()
    assert solve(matrix(), np.zeros_like(w), w) == (0, cg.CONVERGED)
    assert np.abs(w).max() == 0.0
