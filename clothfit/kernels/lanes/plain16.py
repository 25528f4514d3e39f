"""Sixteen numbers of single precision that are not compiled: NumPy arrays."""

from __future__ import annotations

import numpy as np


def load16(a, i, j):
    return a[i, j : j + 16].copy()


def store16(v, a, i, j):
    a[i, j : j + 16] = v


def spread16(a, i, j):
    return np.full(16, a[i, j], np.float32)


def splat16(x):
    return np.full(16, x, np.float32)


def add16(a, b):
    return a + b


def fma16(a, b, c):
    return (a.astype(float) * b + c).astype(np.float32)  # the product is exact, but the sum is rounded twice


def sum16(v):
    part = v
    for half in (8, 4, 2, 1):
        part = part[:half] + part[half:]
    return part[0]
