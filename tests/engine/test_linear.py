"""The linear solve against dense algebra: conjugate gradients, how they say they ended, and what follows where they are
not enough.
"""

import numpy as np
import pytest
from helpers import matrices
from helpers.matrices import dense_solution, free_but, joined, scrambled
from helpers.physics import dense_matrix, times

from clothfit.engine.solve import cg, linear, sparse, ssor

pytestmark = pytest.mark.slow  # compiles a fit

N = 6
FREE = free_but(N, 2)
ALL = np.repeat(FREE, 3)
ENDS = np.array([[0, 1], [1, 2], [2, 3], [3, 4], [4, 5], [5, 0], [0, 3], [1, 4]], np.int32)
"""A ring of six vertices, one of them fixed, with two springs across."""

CLOSE = 1e-10
"""Of solutions to a tolerance of 1e-12, of a condition number below 100."""


def matrix(pull=1.0):
    """Of springs of strength `pull` and a mass on each vertex of the ring."""
    return matrices.matrix(ENDS, FREE, pull)


def right_side(seed=4):
    return matrices.right_side(FREE, seed)


def by_cg(A, b, w, tolerance=1e-14, limit=200):
    return cg.solve(A, b, tolerance, limit, cg.workspace(len(b)), w)


def solve(A, b, tolerance=1e-12):
    """w, and how many direct solves."""
    w = np.zeros((N, 3))
    return w, linear.solve(A, b, tolerance, linear.workspace(A), w, True)[1]


# --- conjugate gradients


@pytest.mark.parametrize("guess", [0.0, 1.0])
def test_the_solution_is_that_of_a_dense_solver(guess):
    A, b = matrix(), right_side()
    w = guess * right_side(seed=9)
    iterations, ended = by_cg(A, b, w)
    assert ended == cg.CONVERGED
    assert 0 < iterations <= 2 * 3 * N  # 15 unknowns: exact arithmetic needs 15
    np.testing.assert_allclose(w, dense_solution(A, b), atol=1e-12)  # condition number below 100
    assert np.abs(w[2]).max() == 0.0
    before = w.copy()
    assert by_cg(A, b, w, 1e-10) == (0, cg.CONVERGED)  # a good guess is left alone
    np.testing.assert_array_equal(w, before)


@pytest.mark.parametrize("tolerance", [1e-2, 1e-5, 1e-10])
def test_it_stops_at_the_first_residual_within_the_tolerance(tolerance):
    A, b, w = matrix(), right_side(), np.zeros((N, 3))
    iterations, ended = by_cg(A, b, w, tolerance)
    assert ended == cg.CONVERGED
    assert np.linalg.norm((b - times(A, w)) * FREE[:, None]) <= tolerance * np.linalg.norm(b) * (1 + 1e-6)  # rounding
    assert by_cg(A, b, np.zeros((N, 3)), tolerance, iterations - 1) == (iterations - 1, cg.LIMIT)


def residuals(A, b, omega, count):
    """The norms of the residuals of conjugate gradients with symmetric successive over-relaxation, dense."""
    whole, (D, lower, upper) = matrices.in_order(A), matrices.parts(A, omega)
    r, w, norms = b.copy(), np.zeros(len(b)), []
    z = p = np.linalg.solve(upper, D @ np.linalg.solve(lower, r))
    for _ in range(count):
        step = (r @ z) / (p @ whole @ p)
        w, after = w + step * p, r - step * (whole @ p)
        again = np.linalg.solve(upper, D @ np.linalg.solve(lower, after))
        p, r, z = again + (after @ again) / (r @ z) * p, after, again
        norms.append(np.linalg.norm(b - whole @ w))
    return np.array(norms)


def test_the_iterations_are_those_of_the_preconditioned_method():
    free = free_but(36, 3, 17)
    A, b = matrices.matrix(scrambled(joined(6), 36), free), matrices.right_side(free)
    own = b[A.order].reshape(-1)
    norms = residuals(A, own, ssor.omega(A), 30)
    for tolerance in (1e-2, 1e-4, 1e-6, 1e-8, 1e-10):
        w = 7.0 * ~free[:, None] * np.ones(3)
        iterations, ended = by_cg(A, b, w, tolerance)
        expected = 1 + int(np.argmax(norms <= tolerance * np.linalg.norm(own)))
        assert (iterations, ended) == (expected, cg.CONVERGED)
        left = own - matrices.in_order(A) @ w[A.order].reshape(-1)
        assert np.linalg.norm(left) == pytest.approx(norms[iterations - 1], rel=1e-3)  # rounding of that many steps
        assert (w[~free] == 7.0).all()  # no pass touches a fixed vertex


def test_without_a_right_side_a_guess_becomes_zero():
    w = right_side()
    assert by_cg(matrix(), np.zeros_like(w), w) == (0, cg.CONVERGED)
    assert np.abs(w).max() == 0.0


def test_a_block_that_is_not_positive_definite_is_noticed_at_once_and_negative_curvature_later():
    A = matrix()
    A.diagonal[4, sparse.YY] = -1.0
    assert by_cg(A, right_side(), np.zeros((N, 3))) == (0, cg.INDEFINITE)
    A = matrix()
    A.upper[:] *= 4.0  # the diagonal blocks stay positive definite
    assert np.linalg.eigvalsh(dense_matrix(A)[np.ix_(ALL, ALL)]).min() < 0
    iterations, ended = by_cg(A, right_side(), np.zeros((N, 3)))
    assert ended == cg.INDEFINITE
    assert iterations > 0


@pytest.mark.parametrize("value", [np.nan, np.inf, -np.inf, 1e200])  # the last has an infinite square
def test_numbers_that_are_not_finite_do_not_pass_as_converged(value):
    b = right_side()
    b[1, 1] = value
    assert by_cg(matrix(), b, np.zeros((N, 3)))[1] != cg.CONVERGED


def relaxation(mass, pull=1.0):
    """ω of a grid of free vertices that all have this mass."""
    return ssor.omega(matrices.matrix(joined(6), np.ones(36, bool), pull, mass))


def test_the_relaxation_factor_by_its_formula_and_at_its_extremes():
    A = matrices.matrix(joined(6), np.ones(36, bool))
    q = 3.0 * 36 / np.trace(matrices.in_order(A))  # the masses beside the diagonal: springs add up to 0 over a row
    assert ssor.omega(A) == pytest.approx(2.0 / (1.0 + q**0.2), rel=1e-12)  # sums of some hundred numbers
    assert relaxation(1.0, pull=0.0) == 1.0  # nothing to relax
    assert relaxation(0.0) == 2.0 / (1.0 + 1e-5**0.2)  # no mass: not 2, where nothing would converge
    assert relaxation(100.0, pull=-1.0) == 1.0  # an indefinite matrix has none, and conjugate gradients notice


# --- with what follows them


@pytest.mark.parametrize(("scale", "solves"), [(1.0, 0), (4.0, 1), (-30.0, 1)])
def test_a_factorisation_is_for_indefinite_systems_alone(scale, solves):
    A, b = matrix(), right_side()
    A.upper[:] *= scale
    assert (np.linalg.eigvalsh(dense_matrix(A)[np.ix_(ALL, ALL)]).min() < 0) == bool(solves)
    w, direct = solve(A, b)
    assert direct == solves
    # two factorisations, condition number below 1000
    np.testing.assert_allclose(w, dense_solution(A, b), atol=1e-11 if solves else CLOSE)
    assert np.abs(w[2]).max() == 0.0


def test_an_ill_conditioned_system_is_solved_when_the_iterations_run_out_or_before():
    A, b = matrix(pull=1e9), right_side()
    w, _ = solve(A, b, 1e-6)
    residual = b.reshape(-1) - dense_matrix(A) @ w.reshape(-1)
    # 1e-6 of |b|, or of a direct solver 1e-16 · 1e9 · |w| with |w| below |b|
    assert np.linalg.norm(residual[ALL]) < 2e-6 * np.linalg.norm(b)


def test_after_a_system_that_is_refused_or_beyond_all_bounds_the_next_one_is_solved():
    hard, A, b, w = matrix(), matrix(), right_side(), np.zeros((N, 3))
    hard.upper[:] *= -30.0
    work = linear.workspace(A)
    assert linear.solve(hard, b, 1e-12, work, w, False)[1:] == (0, False)
    assert linear.solve(A, b, 1e-12, work, w, False)[1:] == (0, True)
    np.testing.assert_allclose(w, dense_solution(A, b), atol=CLOSE)
    linear.solve(A, np.full_like(b, 1e308), 1e-12, work, w, False)
    w[:] = 0.0
    assert linear.solve(A, b, 1e-12, work, w, False)[1:] == (0, True)
    np.testing.assert_allclose(w, dense_solution(A, b), atol=CLOSE)


def test_what_a_factorisation_gives_is_no_solution_unless_it_solves_the_system(monkeypatch):
    import scipy.sparse.linalg

    class Broken:
        def __init__(self, A, **_):
            pass

        def solve(self, known):
            return 1.01 * known

    monkeypatch.setattr(scipy.sparse.linalg, "splu", Broken)
    assert np.isnan(linear.factorise_and_solve(*matrix(), right_side())).all()


@pytest.mark.parametrize("value", [0.0, np.nan, np.inf])
def test_a_singular_matrix_and_one_that_is_not_finite_give_no_numbers(value):
    A, b = matrix(), right_side()
    if value == 0.0:
        A.diagonal[:] = A.upper[:] = 0.0
    A.diagonal[0, 0] = value
    w, direct = solve(A, b)
    assert direct == 1
    assert not np.isfinite(w[FREE]).any() if value == 0.0 else not np.isfinite(w[FREE]).all()


def test_a_cloth_without_free_vertices_is_solved():
    w = np.zeros((N, 3))
    A = sparse.zeros(sparse.pattern(ENDS, np.zeros(N, bool))[0], N)
    assert linear.solve(A, np.zeros((N, 3)), 1e-12, linear.workspace(A), w, True) == (0, 0, True)
    assert np.abs(w).max() == 0.0
