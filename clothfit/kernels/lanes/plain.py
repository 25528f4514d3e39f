"""The lanes of kernels that are not compiled: NumPy arrays of four numbers."""

from __future__ import annotations

import operator
import time

import numpy as np


def load(a, i, j):
    return a[i : i + 2].reshape(-1)[j : j + 4].astype(float)  # a row's last load may reach into the next row


def store(v, a, i, j):
    a[i, j : j + 4] = v


column, store_column = load, store


def load4(a, i):
    return load(a, i, 0)


def store4(v, a, i):
    store(v, a, i, 0)


def load3(a, i):
    return np.array([a[i, 0], a[i, 1], a[i, 2], 0.0])


def store3(v, a, i):
    a[i, :3] = v[:3]


def splat(x):
    return np.full(4, float(x))


def pack(x, y, z, w):
    return np.array([x, y, z, w], float)


def reordered(lanes):
    """A function of the named lanes of its argument."""
    return lambda v: v[lanes]


spread0, spread1, spread2 = (reordered([lane] * 4) for lane in range(3))
turn, xyzz, xxxy = reordered([1, 2, 0, 3]), reordered([0, 1, 2, 2]), reordered([0, 0, 0, 1])
zyyz, zxyy = reordered([2, 1, 1, 2]), reordered([2, 0, 1, 1])
lane0, lane1, lane2 = (operator.itemgetter(lane) for lane in range(3))
add, sub, mul, div, root = operator.add, operator.sub, operator.mul, operator.truediv, np.sqrt


def where_less(a, b, p, q):
    return np.where(a < b, p, q)


def fma(a, b, c):
    return a * b + c


def sum3(v):
    return (v[0] + v[1]) + v[2]


def sum4(v):
    return ((v[0] + v[1]) + v[2]) + v[3]


def clear3(v):
    return np.array([v[0], v[1], v[2], 0.0])


def index(a, i):
    return int(a[i])


def prefetch(a, i):
    pass


read_shared, write_shared = operator.getitem, operator.setitem


def exchange(a, i, expected, value):
    same = a[i] == expected
    if same:
        a[i] = value
    return same


def pause(long):
    time.sleep(0)  # lets the interpreter run another thread
