"""Several numbers of single precision at once: each function is what its name says."""

import numba
import numpy as np
import pytest

from clothfit.kernels.lanes import compiled as lanes


@numba.njit
def every(a, x, out):
    """Write what the operations make of three rows of a (3, 20) into the rows of out (6, 18)."""
    u, v, w = lanes.load16(a, 0, 0), lanes.load16(a, 1, 3), lanes.load16(a, 2, 4)
    lanes.store16(v, out, 0, 1)
    lanes.store16(lanes.add16(u, v), out, 1, 1)
    lanes.store16(lanes.fma16(u, v, w), out, 2, 1)
    lanes.store16(lanes.spread16(a, 1, 2), out, 3, 1)
    lanes.store16(lanes.splat16(x), out, 4, 1)
    out[5, 0] = lanes.sum16(u)


def test_operations():
    a = np.random.default_rng(2).standard_normal((3, 20)).astype(np.float32)
    out = np.full((6, 18), 7.0, np.float32)
    every(a, 0.1, out)
    u, v, w = a[0, :16], a[1, 3:19], a[2, 4:]
    exact = u.astype(float) * v + w
    expected = np.stack([v, u + v, exact, np.full(16, a[1, 2]), np.full(16, np.float32(0.1))]).astype(np.float32)
    np.testing.assert_allclose(out[:5, 1:17], expected, rtol=0, atol=6e-8 * np.abs(exact).max())  # half a unit
    assert (out[:5, [0, 17]] == 7.0).all()
    assert out[5, 0] == pytest.approx(
        float(u.astype(float).sum()), abs=float(4 * 6e-8 * np.abs(u).sum())
    )  # four sums of halves


@numba.njit
def few(a, b, x, out):
    """Write what the operations make of rows of four and of eight numbers into the rows of out (14, 4)."""
    u, v, w = lanes.load4f(a, 0, 0), lanes.load4f(a, 1, 0), lanes.load4f(a, 2, 0)
    lanes.store4f(v, out, 0, 0)
    lanes.store4f(lanes.add4f(u, v), out, 1, 0)
    lanes.store4f(lanes.sub4f(u, v), out, 2, 0)
    lanes.store4f(lanes.mul4f(u, v), out, 3, 0)
    lanes.store4f(lanes.fma4f(u, v, w), out, 4, 0)
    lanes.store4f(lanes.less4f(u, v, w), out, 5, 0)
    lanes.store4f(lanes.spread4f(a, 1, 2), out, 6, 0)
    lanes.store4f(lanes.splat4f(x), out, 7, 0)
    lanes.store4f(lanes.lane0f(u), out, 8, 0)
    lanes.store4f(lanes.lane1f(u), out, 9, 0)
    lanes.store4f(lanes.lane2f(u), out, 10, 0)
    lanes.store4f(lanes.clear4f(u), out, 11, 0)
    lanes.store4f(lanes.column4f(b, 0, 5), out, 12, 0)
    lanes.store8f(lanes.fma8f(lanes.load8f(b, 0, 0), lanes.splat8f(x), lanes.load8f(b, 1, 0)), b, 2, 0)


def test_operations_on_rows_of_four_and_of_eight():
    rng = np.random.default_rng(3)
    a, b = rng.standard_normal((3, 4)).astype(np.float32), rng.standard_normal((4, 8)).astype(np.float32)
    out, rows, kept = np.full((14, 4), 7.0, np.float32), b.astype(float), b[[0, 1, 3]].copy()
    few(a, b, 0.1, out)
    u, v, w = a.astype(float)
    same = [[a[1, 2]] * 4, [np.float32(0.1)] * 4, *([u[lane]] * 4 for lane in range(3)), [*u[:3], 0.0]]
    expected = np.array([v, u + v, u - v, u * v, u * v + w, w - u * v, *same, [*kept[0, 5:], kept[1, 0]], [7.0] * 4])
    half = 6e-8 * np.abs(expected).max()  # half a unit
    np.testing.assert_allclose(out[:13], expected[:13], rtol=0, atol=half)
    assert (out[13] == 7.0).all()
    np.testing.assert_allclose(b[2], rows[0] * np.float32(0.1) + rows[1], rtol=0, atol=half)
    assert (b[[0, 1, 3]] == kept).all()


def test_rows_of_double_precision_and_indices():
    def run(a, b, i, out):
        lanes.store4(lanes.load4(a, lanes.index(i, 1)), out, 0)
        lanes.store_column(lanes.column(b, 1, 2), b, 0, 3)

    a, b, out = np.arange(12.0).reshape(3, 4), np.arange(24.0).reshape(3, 8), np.zeros((1, 4))
    numba.njit(run)(a, b, np.array([0, 2], np.int32), out)
    assert out.tolist() == [[8.0, 9.0, 10.0, 11.0]]
    assert b[0].tolist() == [0.0, 1.0, 2.0, 10.0, 11.0, 12.0, 13.0, 7.0]
