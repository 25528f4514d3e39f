"""The lanes of kernels that are not compiled: NumPy arrays of four numbers."""

from __future__ import annotations

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


def spread0(v):
    return np.full(4, v[0])


def spread1(v):
    return np.full(4, v[1])


def spread2(v):
    return np.full(4, v[2])


def lane0(v):
    return v[0]


def lane1(v):
    return v[1]


def lane2(v):
    return v[2]


def add(a, b):
    return a + b


def sub(a, b):
    return a - b


def mul(a, b):
    return a * b


def div(a, b):
    return a / b


def root(a):
    return np.sqrt(a)


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


def turn(v):
    return v[[1, 2, 0, 3]]


def xyzz(v):
    return v[[0, 1, 2, 2]]


def xxxy(v):
    return v[[0, 0, 0, 1]]


def zyyz(v):
    return v[[2, 1, 1, 2]]


def zxyy(v):
    return v[[2, 0, 1, 1]]


def index(a, i):
    return int(a[i])


def prefetch(a, i):
    pass


def read_shared(a, i):
    return a[i]


def write_shared(a, i, value):
    a[i] = value


def exchange(a, i, expected, value):
    same = a[i] == expected
    if same:
        a[i] = value
    return same


def pause(long):
    time.sleep(0)  # lets the interpreter run another thread
