"""Four, eight or sixteen numbers of single precision that are not compiled: NumPy arrays."""

from __future__ import annotations

import numpy as np

from clothfit.kernels.lanes.plain import add, mul, sub


def loads(width):
    """A function that reads a[i, j …]; a row's last load may reach into the next row."""
    return lambda a, i, j: a[i : i + 2].reshape(-1)[j : j + width].copy()


def stores(width):
    """A function that writes a[i, j …]."""

    def store(v, a, i, j):
        a[i, j : j + width] = v

    return store


def splats(width):
    """A function that fills all lanes with a number."""
    return lambda x: np.full(width, x, np.float32)


def spreads(width):
    """A function that fills all lanes with a[i, j]."""
    return lambda a, i, j: np.full(width, a[i, j], np.float32)


load4f, load8f, load16 = map(loads, (4, 8, 16))
store4f, store8f, store16 = map(stores, (4, 8, 16))
splat4f, splat8f, splat16 = map(splats, (4, 8, 16))
column4f, spread4f, spread16 = load4f, spreads(4), spreads(16)
add4f, sub4f, mul4f, add16 = add, sub, mul, add


def fma4f(a, b, c):
    return (a.astype(float) * b + c).astype(np.float32)  # the product is exact, but the sum is rounded twice


fma8f = fma16 = fma4f


def less4f(a, b, c):
    return fma4f(-a, b, c)


lane0f, lane1f, lane2f = (lambda v, lane=lane: np.full(4, v[lane], np.float32) for lane in range(3))


def clear4f(v):
    return np.array([v[0], v[1], v[2], 0.0], np.float32)


def sum16(v):
    for half in (8, 4, 2, 1):
        v = v[:half] + v[half:]
    return v[0]
