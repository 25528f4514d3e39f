"""Motions of a network, and the memory that its steps need.

The steps of a network, compiled, in single precision, without any library. The arrays are those of `roll.Room`.
"""

from __future__ import annotations

from math import exp

import numpy as np

from clothfit.base import interrupts
from clothfit.base.arrays import Array
from clothfit.engine.system import System
from clothfit.kernels.kernel import kernel
from clothfit.subspace import carrier
from clothfit.subspace.network.weights import ACTIVATIONS, Network, Single

CHUNK = 512
"""Frames between two looks at requests to end."""


class Stepper:
    """A network that plays one cloth, as `physics.reduced.Reduced` does."""

    def __init__(self, own: Network, system: System, basis: Array, steps: int, said: dict[str, None]) -> None:
        """For motions of at most so many steps. What is clamped of the inputs goes to `said`. Raises InvalidInput where
        the scene has other inputs than the network.
        """
        self.system, self.basis, self.r = system, basis, own.r
        self.own, self.said, self.room = own, said, Room(own)
        self.w = within(own.signals.of(system, steps), own.input_range, said)

    @property
    def before(self) -> Single:
        """The coordinates (r,) a step before the start."""
        before = -self.system.h * carrier.start_velocity(self.system, self.basis)
        return before.astype(np.float32)

    def roll(self, steps: int) -> Array:
        """The coordinates (steps + 1, r) of a motion from the start."""
        q = np.empty((steps + 1, self.r), np.float32)
        q[0], before = 0.0, self.before
        for first in range(0, steps, CHUNK):
            part = q[first : first + CHUNK + 1]
            self.room.roll(part, before, self.w[first : first + len(part) - 1])
            before = part[-2]
            interrupts.check()
        return q.astype(float)


def within(w: Array, limits: Single, said: dict[str, None]) -> Single:
    """The inputs (steps, m) within their range."""
    low, high = limits
    w = w.astype(np.float32)
    slack = 1e-4 * (high - low) + 1e-6
    if ((w < low - slack) | (w > high + slack)).any():
        said["the inputs leave the range that the network was trained in; they are clamped"] = None
    return np.ascontiguousarray(np.clip(w, low, high))


class Room:
    """A network with memory for its steps: its layers below each other in one array."""

    def __init__(self, own: Network) -> None:
        sizes = [len(own.weights[0]), *(each.shape[1] for each in own.weights)]
        self.sizes = np.array(sizes)
        self.weights = np.concatenate([own.linear.ravel(), *(each.ravel() for each in own.weights)])
        self.biases = np.concatenate([own.offset, *own.biases])
        self.range = np.ascontiguousarray(own.range)
        self.smooth = own.activation == ACTIVATIONS[1]
        self.a, self.b = (np.empty(max(sizes), np.float32) for _ in range(2))

    def roll(self, q: Single, before: Single, w: Single) -> None:
        """Fill q (steps + 1, r) after its first row, for inputs w (steps, m)."""
        roll(self.sizes, self.weights, self.biases, self.range, self.smooth, w, before, q, self.a, self.b)


@kernel
def roll(sizes, weights, biases, limits, smooth, w, before, q, a, b):
    """Fill q (steps + 1, r) after its first row, for inputs w (steps, m); a and b have room for a layer."""
    r = q.shape[1]
    for t in range(len(q) - 1):
        for i in range(r):
            last = before[i] if t == 0 else q[t - 1, i]
            a[i] = q[t, i]
            a[r + i] = q[t, i] - last
        for i in range(w.shape[1]):
            a[2 * r + i] = w[t, i]
        advance(sizes, weights, biases, limits, smooth, q[t + 1], a, b)


@kernel
def advance(sizes, weights, biases, limits, smooth, out, a, b):
    """out (r,) of what is in a, which is overwritten."""
    r = len(out)
    out[:] = biases[:r]
    add_product(a, weights, 0, sizes[0], r, out)
    at, bias = sizes[0] * r, r
    for k in range(len(sizes) - 1):
        rows, columns = sizes[k], sizes[k + 1]
        b[:columns] = biases[bias : bias + columns]
        add_product(a, weights, at, rows, columns, b)
        at, bias = at + rows * columns, bias + columns
        if k < len(sizes) - 2:
            activate(b, columns, smooth)
        a, b = b, a
    for i in range(r):
        out[i] = min(max(out[i] + a[i], limits[0, i]), limits[1, i])


@kernel
def activate(b, count, smooth):
    """ELU where `smooth`, else ReLU, of the first numbers of b."""
    for i in range(count):
        if b[i] < 0.0:
            b[i] = exp(b[i]) - np.float32(1.0) if smooth else np.float32(0.0)


@kernel
def add_product(x, weights, at, rows, columns, out):
    """out (columns,) += x (rows,) times the matrix (rows, columns) that begins at `at`, four rows at a time: the inner
    loop has no sum over what it runs through, so that it is computed in lanes.
    """
    whole = rows - rows % 4
    for i in range(0, whole, 4):
        x0, x1, x2, x3 = x[i], x[i + 1], x[i + 2], x[i + 3]
        w0 = weights[at + i * columns : at + (i + 1) * columns]
        w1 = weights[at + (i + 1) * columns : at + (i + 2) * columns]
        w2 = weights[at + (i + 2) * columns : at + (i + 3) * columns]
        w3 = weights[at + (i + 3) * columns : at + (i + 4) * columns]
        for j in range(columns):
            out[j] += x0 * w0[j] + x1 * w1[j] + x2 * w2[j] + x3 * w3[j]
    for i in range(whole, rows):
        last = weights[at + i * columns : at + (i + 1) * columns]
        for j in range(columns):
            out[j] += x[i] * last[j]
