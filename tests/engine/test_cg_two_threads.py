"""Conjugate gradients in subdomains against a dense solve, and against one thread."""

import numpy as np
import pytest
from helpers import matrices, physics
from helpers.physics import times
from helpers.scenes import cloth, needs_compiler

import clothfit
from clothfit.engine.solve import cg, cg_two_threads, sparse, two_threads

pytestmark = pytest.mark.slow  # compiles a fit


def solve(A, b, w, tolerance=1e-14, limit=200):
    return cg_two_threads.solve(A, b, tolerance, limit, cg.workspace(len(b)), cg_two_threads.second(A), w)


SIDE = 7
HELD = matrices.free_but(SIDE * SIDE, 0, 6, 20)


@pytest.fixture
def large(monkeypatch):
    """As if some vertices were many: a matrix whose rows are in three subdomains."""
    monkeypatch.setattr(sparse, "TWO_THREADS_FROM", 10)
    A = matrices.matrix(matrices.scrambled(matrices.joined(SIDE), SIDE * SIDE), HELD)
    assert (np.diff(A.subdomains, axis=1) > 0).all()
    return A


def served(A, b, w, tolerance=1e-14, limit=300):
    """The same as `solve`, with the second thread where there are two processors."""
    work, second = cg.workspace(len(b)), cg_two_threads.second(A)
    with cg_two_threads.served(A, work, second):
        return cg_two_threads.solve(A, b, tolerance, limit, work, second, w)


@pytest.mark.parametrize("guess", [0.0, 1.0])
def test_three_subdomains_give_the_dense_solution(large, guess):
    b, w = matrices.right_side(HELD), guess * matrices.right_side(HELD, 9)
    iterations, ended = solve(large, b, w)
    assert (iterations > 0, ended) == (True, cg.CONVERGED)
    np.testing.assert_allclose(w, matrices.dense_solution(large, b), atol=1e-12)  # condition number below 100
    assert np.abs(w[~HELD]).max() == 0.0


def test_three_subdomains_need_the_iterations_of_one(large):
    b, tolerance = matrices.right_side(HELD), 1e-10
    whole = np.array([[0, len(large.order)]] + [[len(large.order)] * 2] * 2, np.int32)
    in_three, in_one = np.zeros_like(b), np.zeros_like(b)
    three = solve(large, b, in_three, tolerance)
    one = cg.solve(large._replace(subdomains=whole), b, tolerance, 200, cg.workspace(len(b)), in_one)
    assert three == one  # the same sums in another order, and the residual falls fast
    np.testing.assert_allclose(in_three, in_one, atol=1e-12)


@pytest.mark.parametrize("tolerance", [1e-2, 1e-5, 1e-10])
def test_three_subdomains_stop_at_the_first_residual_within_the_tolerance(large, tolerance):
    b, w = matrices.right_side(HELD), np.zeros_like(large.diagonal[:-1, :3])
    iterations, ended = solve(large, b, w, tolerance)
    assert ended == cg.CONVERGED
    rest = (b - times(large, w)) * HELD[:, None]
    assert np.linalg.norm(rest) <= tolerance * np.linalg.norm(b) * (1 + 1e-6)  # rounding
    assert solve(large, b, np.zeros_like(b), tolerance, iterations - 1) == (iterations - 1, cg.LIMIT)


def test_without_a_right_side_a_guess_becomes_zero(large):
    w = matrices.right_side(HELD)
    assert solve(large, np.zeros_like(w), w) == (0, cg.CONVERGED)
    assert np.abs(w).max() == 0.0


def test_negative_curvature_is_noticed_in_three_subdomains(large):
    large.upper[:] *= 4.0  # the diagonal blocks stay positive definite
    assert np.linalg.eigvalsh(matrices.in_order(large)).min() < 0
    iterations, ended = solve(large, matrices.right_side(HELD), np.zeros((SIDE * SIDE, 3)))
    assert (iterations > 0, ended) == (True, cg.INDEFINITE)


@needs_compiler
def test_a_second_thread_changes_no_bit_of_a_solution(large, monkeypatch):
    b, found = matrices.right_side(HELD), []
    for processors in [1, *[2] * 5]:
        monkeypatch.setattr(two_threads, "processors", lambda count=processors: count)
        w = np.zeros_like(b)
        found.append((served(large, b, w), w.tobytes()))
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
        monkeypatch.setattr(two_threads, "processors", lambda count=processors: count)
        positions = clothfit.simulate(scene, 4).positions
        cost, gradient = clothfit.cost_and_gradient(scene, target)
        found.append((positions.tobytes(), cost, gradient.tobytes()))
    assert np.isfinite(gradient).all()
    assert found[1:] == found[:1] * 2
