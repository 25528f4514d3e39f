"""The sums over points and the dense system of a step, against NumPy."""

import numpy as np
import pytest

from clothfit.subspace.physics.dense import (
    PANEL,
    ROOM,
    add_matrix,
    add_vectors,
    factorise,
    products,
    solve,
)

POINTS = 45
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
    room = np.zeros((2, ROOM, width), np.float32)
    work = work_of(room, width)
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


def work_of(room, width):
    from collections import namedtuple

    Work = namedtuple("Work", "left right C g")
    return Work(room[0], room[1], np.zeros((width, width), np.float32), np.zeros((1, width), np.float32))


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
