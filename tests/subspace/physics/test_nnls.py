"""Few non-negative weights."""

import numpy as np
import pytest
from scipy.optimize import nnls

from clothfit.subspace.physics.cubature import weights_for

rng = np.random.default_rng(1)
WIDE = rng.standard_normal((40, 300))


def sparse_weights(G, g, error, most):
    """The weights for one error, and the relative residual."""
    return weights_for(G, g, [error], most)[0]


def test_weights_that_are_there_are_found():
    truth = np.zeros(300)
    truth[[3, 50, 211]] = 1.0, 4.0, 0.5
    w, left = sparse_weights(WIDE, WIDE @ truth, 1e-10, 40)
    np.testing.assert_allclose(w, truth, atol=1e-9)
    assert left < 1e-10


@pytest.mark.parametrize("error", [0.3, 0.1, 0.01])
def test_a_smaller_error_takes_more_weights_and_all_are_positive(error):
    g = WIDE.sum(axis=1)
    w, left = sparse_weights(WIDE, g, error, 300)
    assert (w >= 0).all()
    assert left <= error
    assert left == pytest.approx(np.linalg.norm(WIDE @ w - g) / np.linalg.norm(g), rel=1e-9)
    coarser, _ = sparse_weights(WIDE, g, 2 * error, 300)
    assert np.count_nonzero(coarser) <= np.count_nonzero(w) <= 40


def test_where_the_equations_have_no_solution_it_ends_near_the_best():
    G = np.abs(rng.standard_normal((30, 8)))
    g = rng.standard_normal(30)
    _w, left = sparse_weights(G, g, 1e-12, 8)
    best = nnls(G, g)[1] / np.linalg.norm(g)
    assert best <= left + 1e-12 <= 1.2 * best  # a greedy path, stopped when it no longer gains


def test_nothing_to_sum_up_needs_no_weights():
    w, left = sparse_weights(np.zeros((5, 4)), np.zeros(5), 0.01, 4)
    assert (w == 0).all()
    assert left == 1.0


def test_coarser_weights_lie_on_the_way_to_finer_ones():
    rng = np.random.default_rng(7)
    G = rng.standard_normal((60, 200))
    g = G @ rng.uniform(0.5, 1.5, 200)
    errors = [0.5, 0.2, 0.05]
    for error, (w, rest) in zip(errors, weights_for(G, g, errors, 60), strict=True):
        alone, left = sparse_weights(G, g, error, 60)
        np.testing.assert_array_equal(w, alone)
        assert rest == left <= error
    assert [rest for _, rest in weights_for(np.zeros((3, 4)), np.zeros(3), errors, 3)] == [1.0] * 3
