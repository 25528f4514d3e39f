"""Four, eight or sixteen numbers of single precision that are not compiled: NumPy arrays."""

from __future__ import annotations

import numpy as np

from clothfit.kernels.lanes.plain import add, mul, sub


def load4f(a, i, j):
    return taken(a, i, j, 4)


column4f = load4f


def load8f(a, i, j):
    return taken(a, i, j, 8)


def load16(a, i, j):
    return taken(a, i, j, 16)


def taken(a, i, j, width):
    return a[i : i + 2].reshape(-1)[j : j + width].copy()  # a row's last load may reach into the next row


def store4f(v, a, i, j):
    a[i, j : j + 4] = v


def store8f(v, a, i, j):
    a[i, j : j + 8] = v


def store16(v, a, i, j):
    a[i, j : j + 16] = v


def spread4f(a, i, j):
    return splat4f(a[i, j])


def spread16(a, i, j):
    return splat16(a[i, j])


def splat4f(x):
    return np.full(4, x, np.float32)


def splat8f(x):
    return np.full(8, x, np.float32)


def splat16(x):
    return np.full(16, x, np.float32)


add4f, sub4f, mul4f = add, sub, mul
add16 = add


def fma4f(a, b, c):
    return (a.astype(float) * b + c).astype(np.float32)  # the product is exact, but the sum is rounded twice


fma8f = fma16 = fma4f


def less4f(a, b, c):
    return fma4f(-a, b, c)


def lane0f(v):
    return splat4f(v[0])


def lane1f(v):
    return splat4f(v[1])


def lane2f(v):
    return splat4f(v[2])


def clear4f(v):
    return np.array([v[0], v[1], v[2], 0.0], np.float32)


def sum16(v):
    part = v
    for half in (8, 4, 2, 1):
        part = part[:half] + part[half:]
    return part[0]
