"""Block conjugate gradients: exact in as many directions as there are unknowns, and never further from the solution."""

import numpy as np
import pytest

from clothfit.optimise.matrix_free import BlockGradients


def problem(size, count, seed=0, spread=1e4):
    """S with eigenvalues over `spread`, right sides, and the solutions."""
    rng = np.random.default_rng(seed)
    V = np.linalg.qr(rng.normal(size=(size, size)))[0]
    S = V * np.geomspace(1.0, spread, size) @ V.T
    B = rng.normal(size=(size, count))
    return S, B, np.linalg.solve(S, B)


def begun(S, B, X=None, diagonal=None):
    X = np.zeros_like(B) if X is None else X
    return BlockGradients(lambda z: S @ z, B, X, S @ X, np.diag(S) if diagonal is None else diagonal)


@pytest.mark.parametrize("seed", range(3))
@pytest.mark.parametrize("count", [1, 3, 8])
def test_as_many_directions_as_unknowns_solve_the_equations(count, seed):
    S, B, exact = problem(24, count, seed)
    own = begun(S, B, np.random.default_rng(9).normal(size=B.shape))
    while own.rank < 24 and own.round():
        pass
    assert own.rank <= 24
    np.testing.assert_allclose(own.X, exact, atol=1e-9 * np.abs(exact).max())  # rounding times a condition of 1e4


def test_each_round_is_nearer_in_the_norm_of_the_matrix():
    S, B, exact = problem(60, 4)
    own, errors = begun(S, B), []
    for _ in range(10):
        own.round()
        away = own.X - exact
        errors.append(np.einsum("qk,qp,pk->k", away, S, away))
    assert (np.diff(errors, axis=0) < 0).all()


def test_no_right_side_is_further_from_its_solution_than_alone():
    S, B, exact = problem(200, 8, spread=1e3)
    own, alone = begun(S, B), begun(S, B[:, :1])
    for _ in range(12):
        own.round()
        alone.round()
    (error, more) = (away @ S @ away for away in (each.X[:, 0] - exact[:, 0] for each in (own, alone)))
    assert error < more  # the least over a space that holds the other's


def test_right_sides_that_depend_on_each_other_add_no_directions():
    S, B, exact = problem(30, 2)
    own = begun(S, np.stack([B[:, 0], 2.0 * B[:, 0], 0.0 * B[:, 0], B[:, 1]], axis=1))
    assert own.round()
    assert own.rank == 2
    while own.rank < 30 and own.round():
        pass
    np.testing.assert_allclose(own.X[:, 1], 2.0 * exact[:, 0], atol=1e-9 * np.abs(exact).max())
    np.testing.assert_allclose(own.X[:, 2], 0.0, atol=1e-12)
