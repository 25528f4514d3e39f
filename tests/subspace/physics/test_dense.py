"""Against NumPy and SciPy: the sums over points, the dense system of a step, and few non-negative weights."""

from collections import namedtuple

import numpy as np
import pytest
from scipy.optimize import nnls

from clothfit.subspace.physics.cubature import weights_for
from clothfit.subspace.physics.dense import PANEL, ROOM, add_matrix, add_vectors, factorise, products, solve

POINTS = 45
Work = namedtuple("Work", "left right C g")
XX_TO_ZZ = [0, 1, 2, 4, 5, 8]
"""Of the nine entries of a block, those that are kept."""


def padded(rng, r):
    rows = np.zeros((3 * POINTS, 16 * -(-r // 16)), np.float32)
    rows[:, :r] = rng.standard_normal((3 * POINTS, r))
    return rows


def blocks(rng):
    """Blocks of rank 3, 1 and 0, some indefinite."""
    n = rng.standard_normal((POINTS, 3))
    full = rng.standard_normal((POINTS, 3, 3))
    made = full + full.transpose(0, 2, 1)
    made[::3] = -2.0 * n[::3, :, None] * n[::3, None, :]
    made[1::6] = 0.0
    made[4] = np.diag([0.0, 0.0, 3.0])
    return made


@pytest.mark.parametrize("r", [5, 16, 40])
def test_sums_over_points(r):
    rng = np.random.default_rng(r)
    rows, B, p = padded(rng, r), blocks(rng), rng.standard_normal((POINTS, 3))
    width = rows.shape[1]
    work = Work(*(np.zeros((rows, width), np.float32) for rows in (ROOM, ROOM, width, 1)))
    A, b = np.zeros((r, r)), np.zeros(r)
    kept = np.ascontiguousarray(B.reshape(-1, 9)[:, XX_TO_ZZ])
    add_matrix(rows, kept, work, A)
    add_vectors(rows, p, work.g, b)
    R = rows[:, :r].astype(float).reshape(POINTS, 3, r)
    whole = np.einsum("pir,pij,pjs->rs", R, B, R)
    np.testing.assert_allclose(A, np.tril(whole), atol=1e-5 * np.abs(whole).max())  # single precision, 135 rows
    np.testing.assert_allclose(b, p.ravel() @ R.reshape(-1, r), atol=1e-5 * POINTS)
    x, out = rng.standard_normal((3, width)).astype(np.float32), np.zeros((3, 3 * POINTS), np.float32)
    x[:, r:] = 0.0
    products(rows, x, out)
    np.testing.assert_allclose(out, x[:, :r] @ rows[:, :r].T, atol=1e-5 * r)


@pytest.mark.parametrize("r", [1, 3, 4, 17])
def test_a_factor_solves(r):
    rng = np.random.default_rng(r)
    half = rng.standard_normal((r, r))
    A, b = half @ half.T + np.eye(r), rng.standard_normal(r)
    L, x = np.tril(A), b.copy()
    assert factorise(L, np.zeros((PANEL, r)))
    np.testing.assert_allclose(np.tril(L), np.linalg.cholesky(A), atol=1e-13 * r)
    solve(L, x)
    np.testing.assert_allclose(A @ x, b, atol=1e-12 * r)
    A[r // 2, r // 2] = -1.0
    assert not factorise(np.tril(A), np.zeros((PANEL, r)))


rng = np.random.default_rng(1)
WIDE = rng.standard_normal((40, 300))


def one(G, g, error, most):
    """The weights for one error, and the relative residual."""
    return weights_for(G, g, [error], most)[0]


def test_weights_that_are_there_are_found():
    truth = np.zeros(300)
    truth[[3, 50, 211]] = 1.0, 4.0, 0.5
    w, left = one(WIDE, WIDE @ truth, 1e-10, 40)
    np.testing.assert_allclose(w, truth, atol=1e-9)
    assert left < 1e-10


@pytest.mark.parametrize("error", [0.3, 0.1, 0.01])
def test_a_smaller_error_takes_more_weights_and_all_are_positive(error):
    g = WIDE.sum(axis=1)
    w, left = one(WIDE, g, error, 300)
    assert (w >= 0).all()
    assert left <= error
    assert left == pytest.approx(np.linalg.norm(WIDE @ w - g) / np.linalg.norm(g), rel=1e-9)
    coarser, _ = one(WIDE, g, 2 * error, 300)
    assert np.count_nonzero(coarser) <= np.count_nonzero(w) <= 40


def test_where_the_equations_have_no_solution_it_ends_near_the_best():
    G = np.abs(rng.standard_normal((30, 8)))
    g = rng.standard_normal(30)
    _w, left = one(G, g, 1e-12, 8)
    best = nnls(G, g)[1] / np.linalg.norm(g)
    assert best <= left + 1e-12 <= 1.2 * best  # a greedy path, stopped when it no longer gains


def test_coarser_weights_lie_on_the_way_to_finer_ones():
    rng = np.random.default_rng(7)
    G = rng.standard_normal((60, 200))
    g = G @ rng.uniform(0.5, 1.5, 200)
    errors = [0.5, 0.2, 0.05]
    for error, (w, rest) in zip(errors, weights_for(G, g, errors, 60), strict=True):
        alone, left = one(G, g, error, 60)
        np.testing.assert_array_equal(w, alone)
        assert rest == left <= error
    for w, rest in weights_for(np.zeros((3, 4)), np.zeros(3), errors, 3):  # nothing to sum up needs no weights
        assert (rest, w.any()) == (1.0, False)
