"""Conjugate gradients against a dense solve, and how they say they ended."""

import numpy as np
import pytest
from helpers import matrices, physics
from helpers.physics import dense_matrix, times
from helpers.ring import ALL, FREE, N, dense_solution, matrix, right_side
from helpers.scenes import cloth, needs_compiler

import clothfit
from clothfit.engine.solve import cg, sparse
from clothfit.engine.solve import two_threads as team


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


@pytest.mark.parametrize("value", [np.nan, np.inf, -np.inf, 1e200])  # the last has an infinite square
def test_numbers_that_are_not_finite_do_not_pass_as_converged(value):
    b = right_side()
    b[1, 1] = value
    assert solve(matrix(), b, np.zeros((N, 3)))[1] != cg.CONVERGED


SIDE = 7
HELD = matrices.free_but(SIDE * SIDE, 0, 6, 20)


@pytest.fixture
def large(monkeypatch):
    """As if some vertices were many: a matrix whose rows are in three shares."""
    monkeypatch.setattr(sparse, "LARGE", 10)
    A = matrices.matrix(matrices.scrambled(matrices.joined(SIDE), SIDE * SIDE), HELD)
    assert (np.diff(A.shares, axis=1) > 0).all()
    return A


def helped(A, b, w, tolerance=1e-14, limit=300):
    """The same as `solve`, with the second thread where there are two processors."""
    work = cg.workspace(A)
    with cg.helped(A, work):
        return cg.solve(A, b, tolerance, limit, work, w)


@pytest.mark.parametrize("guess", [0.0, 1.0])
def test_three_shares_of_rows_give_the_dense_solution(large, guess):
    b, w = matrices.right_side(HELD), guess * matrices.right_side(HELD, 9)
    iterations, ended = solve(large, b, w)
    assert (iterations > 0, ended) == (True, cg.CONVERGED)
    np.testing.assert_allclose(w, matrices.dense_solution(large, b), atol=1e-12)  # condition number below 100
    assert np.abs(w[~HELD]).max() == 0.0


def test_three_shares_of_rows_need_the_iterations_of_one(large):
    b, tolerance = matrices.right_side(HELD), 1e-10
    whole = np.array([[0, len(large.order)]] + [[len(large.order)] * 2] * 2, np.int32)
    in_three, in_one = np.zeros_like(b), np.zeros_like(b)
    counts = [solve(large, b, in_three, tolerance)[0], solve(large._replace(shares=whole), b, in_one, tolerance)[0]]
    assert counts[0] == counts[1]  # the same sums in another order, and the residual falls fast
    np.testing.assert_allclose(in_three, in_one, atol=1e-12)


@pytest.mark.parametrize("tolerance", [1e-2, 1e-5, 1e-10])
def test_three_shares_stop_at_the_first_residual_within_the_tolerance(large, tolerance):
    b, w = matrices.right_side(HELD), np.zeros_like(large.diagonal[:-1, :3])
    iterations, ended = solve(large, b, w, tolerance)
    assert ended == cg.CONVERGED
    rest = (b - times(large, w)) * HELD[:, None]
    assert np.linalg.norm(rest) <= tolerance * np.linalg.norm(b) * (1 + 1e-6)  # rounding
    assert solve(large, b, np.zeros_like(b), tolerance, iterations - 1) == (iterations - 1, cg.LIMIT)


def test_without_a_right_side_a_guess_becomes_zero(large):
    for A, free in ((matrix(), FREE), (large, HELD)):
        w = matrices.right_side(free)
        assert solve(A, np.zeros_like(w), w) == (0, cg.CONVERGED)
        assert np.abs(w).max() == 0.0


def test_negative_curvature_is_noticed_in_three_shares(large):
    large.upper[:] *= 4.0  # the diagonal blocks stay positive definite
    assert np.linalg.eigvalsh(matrices.in_order(large)).min() < 0
    iterations, ended = solve(large, matrices.right_side(HELD), np.zeros((SIDE * SIDE, 3)))
    assert (iterations > 0, ended) == (True, cg.INDEFINITE)


@needs_compiler
def test_a_second_thread_changes_no_bit_of_a_solution(large, monkeypatch):
    b, found = matrices.right_side(HELD), []
    for processors in [1, *[2] * 5]:
        monkeypatch.setattr(team, "processors", lambda count=processors: count)
        w = np.zeros_like(b)
        found.append((helped(large, b, w), w.tobytes()))
    assert found[0][0][1] == cg.CONVERGED
    assert found[1:] == found[:1] * 5


@needs_compiler
def test_a_second_thread_changes_no_bit_of_a_motion_or_a_gradient(monkeypatch):
    n = 45 * 45
    one = cloth(45, 45, 0.02, vertMass=[0.001] * n, optimizationSettings="LL")
    scene = physics.scene({**one, "springStiffness": [50.0] * len(one["springStiffness"])})
    target = clothfit.Motion(clothfit.simulate(scene, 4).positions + 0.01, np.arange(4) * scene.delta, (n,))
    found = []
    for processors in (1, 2, 2):
        monkeypatch.setattr(team, "processors", lambda count=processors: count)
        positions = clothfit.simulate(scene, 4).positions
        cost, gradient = clothfit.cost_and_gradient(scene, target)
        found.append((positions.tobytes(), cost, gradient.tobytes()))
    assert np.isfinite(gradient).all()
    assert found[1:] == found[:1] * 2
