"""The linear solve where conjugate gradients are enough, and where they are not."""

import numpy as np
import pytest
from helpers.physics import dense_matrix
from helpers.ring import ALL, ENDS, FREE, N, dense_solution, matrix, right_side

from clothfit.engine.solve import linear, sparse


def solve(A, b, tolerance=1e-12):
    w = np.zeros((N, 3))
    return w, linear.solve(A, b, tolerance, linear.workspace(A), w, True)[:2]


def test_a_positive_definite_system_needs_no_factorisation():
    A, b = matrix(), right_side()
    w, (iterations, direct) = solve(A, b)
    assert (iterations > 0, direct) == (True, 0)
    np.testing.assert_allclose(w, dense_solution(A, b), atol=1e-10)  # tolerance 1e-12, condition number below 100


@pytest.mark.parametrize("scale", [4.0, -30.0])
def test_an_indefinite_system_is_solved_all_the_same(scale):
    A, b = matrix(), right_side()
    A.upper[:] *= scale
    assert np.linalg.eigvalsh(dense_matrix(A)[np.ix_(ALL, ALL)]).min() < 0
    w, (_, direct) = solve(A, b)
    assert direct == 1
    np.testing.assert_allclose(w, dense_solution(A, b), atol=1e-11)  # two factorisations, condition number below 1000
    assert np.abs(w[2]).max() == 0.0


def test_an_ill_conditioned_system_is_solved_when_the_iterations_run_out_or_before():
    A, b = matrix(pull=1e9), right_side()
    w, _ = solve(A, b, 1e-6)
    residual = b.reshape(-1) - dense_matrix(A) @ w.reshape(-1)
    # 1e-6 of |b|, or of a direct solver 1e-16 · 1e9 · |w| with |w| below |b|
    assert np.linalg.norm(residual[ALL]) < 2e-6 * np.linalg.norm(b)


def test_an_indefinite_system_is_refused_unless_it_is_to_be_solved_anyhow():
    A, b, w = matrix(), right_side(), np.zeros((N, 3))
    work = linear.workspace(A)
    A.upper[:] *= -30.0
    assert linear.solve(A, b, 1e-12, work, w, False)[1:] == (0, False)
    again = matrix()
    assert linear.solve(again, b, 1e-12, work, w, False)[1:] == (0, True)
    np.testing.assert_allclose(w, dense_solution(again, b), atol=1e-10)  # tolerance 1e-12, condition number below 100


def test_numbers_beyond_all_bounds_do_not_spoil_the_next_solve():
    A, b, w = matrix(), right_side(), np.zeros((N, 3))
    work = linear.workspace(A)
    linear.solve(A, np.full_like(b, 1e308), 1e-12, work, w, False)
    w[:] = 0.0
    assert linear.solve(A, b, 1e-12, work, w, False)[1:] == (0, True)
    np.testing.assert_allclose(w, dense_solution(A, b), atol=1e-10)


def test_what_a_factorisation_gives_is_no_solution_unless_it_solves_the_system(monkeypatch):
    import scipy.sparse.linalg

    class Broken:
        def __init__(self, A, **_):
            pass

        def solve(self, known):
            return 1.01 * known

    monkeypatch.setattr(scipy.sparse.linalg, "splu", Broken)
    A, b = matrix(), right_side()
    assert np.isnan(linear.factorise_and_solve(*A, b)).all()


def test_a_singular_system_gives_no_numbers():
    A, b = matrix(), right_side()
    A.diagonal[:] = 0.0
    A.upper[:] = 0.0
    w, (_, direct) = solve(A, b)
    assert direct == 1
    assert np.isnan(w[FREE]).all()


@pytest.mark.parametrize("value", [np.nan, np.inf])
def test_a_matrix_that_is_not_finite_gives_no_numbers(value):
    A, b = matrix(), right_side()
    A.diagonal[0, 0] = value
    w, (_, direct) = solve(A, b)
    assert direct == 1
    assert not np.isfinite(w[FREE]).all()


def test_a_cloth_without_free_vertices_is_solved():
    w = np.zeros((N, 3))
    A = sparse.zeros(sparse.pattern(ENDS, np.zeros(N, bool))[0], N)
    assert linear.solve(A, np.zeros((N, 3)), 1e-12, linear.workspace(A), w, True) == (0, 0, True)
    assert np.abs(w).max() == 0.0
