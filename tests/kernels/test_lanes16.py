"""Sixteen numbers of single precision at once: each function is what its name says, compiled and with NumPy."""

from functools import cache

import numba
import numpy as np
import pytest

from clothfit.kernels.kernel import interpreted
from clothfit.kernels.lanes import compiled16, plain16

needs_compiler = pytest.mark.skipif(interpreted(), reason="nothing is compiled here")
KINDS = [pytest.param(plain16, id="plain"), pytest.param(compiled16, id="compiled", marks=needs_compiler)]
both = pytest.mark.parametrize("lanes", KINDS)


@cache
def every(lanes):
    """A function that writes what `lanes` makes of three rows of a (3, 20) into the rows of out (6, 18)."""

    def run(a, x, out):
        u, v, w = lanes.load16(a, 0, 0), lanes.load16(a, 1, 3), lanes.load16(a, 2, 4)
        lanes.store16(v, out, 0, 1)
        lanes.store16(lanes.add16(u, v), out, 1, 1)
        lanes.store16(lanes.fma16(u, v, w), out, 2, 1)
        lanes.store16(lanes.spread16(a, 1, 2), out, 3, 1)
        lanes.store16(lanes.splat16(x), out, 4, 1)
        out[5, 0] = lanes.sum16(u)

    return numba.njit(run) if lanes is compiled16 else run


@both
def test_operations(lanes):
    a = np.random.default_rng(2).standard_normal((3, 20)).astype(np.float32)
    out = np.full((6, 18), 7.0, np.float32)
    every(lanes)(a, 0.1, out)
    u, v, w = a[0, :16], a[1, 3:19], a[2, 4:]
    exact = u.astype(float) * v + w
    expected = np.stack([v, u + v, exact, np.full(16, a[1, 2]), np.full(16, np.float32(0.1))]).astype(np.float32)
    np.testing.assert_allclose(out[:5, 1:17], expected, rtol=0, atol=6e-8 * np.abs(exact).max())  # half a unit
    assert (out[:5, [0, 17]] == 7.0).all()
    assert out[5, 0] == pytest.approx(
        float(u.astype(float).sum()), abs=float(4 * 6e-8 * np.abs(u).sum())
    )  # four sums of halves
