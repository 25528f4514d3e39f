"""A network that steps the coordinates of a cloth, as plain arrays: what a player needs, and what MODEL holds.

With q₁, q₂ the coordinates (r,) of the last frame and of the one before, and w (m,) what acts on the step,

    u = [q₁, q₁ − q₂, w],   h₀ = u,   h_k = a(h_{k−1} W_k + b_k),   q = clip(u L + l + h_{K−1} W_K + b_K, low, high).

u L + l is the linear part (the prior of the paper, z̄), the rest the correction Φ. Scales of the data are folded into
the arrays. a is ReLU or ELU, a(s) = s for s > 0, else 0 or eˢ − 1. Inputs are clipped to their range first.

Its steps are compiled, in single precision, without any library.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from math import exp
from typing import IO, Any

import numpy as np
from numpy.typing import NDArray

from clothfit.base import interrupts, npz
from clothfit.base.arrays import Array
from clothfit.engine.system import System
from clothfit.kernels.kernel import kernel
from clothfit.kernels.vectors import copy_row
from clothfit.subspace import translation
from clothfit.subspace.network.signals import Signals

Single = NDArray[np.float32]

ACTIVATIONS = ("relu", "elu")


@dataclass(frozen=True, eq=False)
class Network:
    """The arrays, single precision but for the signals."""

    linear: Single  # L, (2 r + m, r)
    offset: Single  # l, (r,)
    weights: tuple[Single, ...]  # W_k, (inputs, outputs) each; K of them
    biases: tuple[Single, ...]  # b_k, (outputs,)
    range: Single  # (2, r), low and high
    input_range: Single  # (2, m), of w
    activation: str  # of ACTIVATIONS
    signals: Signals  # how w follows from the inputs of a scene

    @property
    def r(self) -> int:
        """Number of coordinates."""
        return len(self.offset)

    @property
    def m(self) -> int:
        """Number of inputs."""
        return int(self.input_range.shape[1])

    @property
    def nbytes(self) -> int:
        """Bytes of all that a step reads."""
        return sum(each.nbytes for each in (self.linear, self.offset, *self.weights, *self.biases))


PLAIN, OF_SIGNALS, OF_LAYERS = ("linear", "offset", "range", "input_range"), ("mean", "mix"), ("weight", "bias")
"""Names of arrays in the file, before the object's number: as they are, after `signal_`, and before that of a layer."""


def arrays(own: Network, c: int) -> dict[str, Any]:
    """The arrays of object c by their names in the file."""
    found: dict[str, Any] = {f"{name}{c}": getattr(own, name) for name in PLAIN}
    for k, pair in enumerate(zip(own.weights, own.biases, strict=True)):
        found |= {f"{name}{c}.{k}": array for name, array in zip(OF_LAYERS, pair, strict=True)}
    return found | {f"signal_{name}{c}": getattr(own.signals, name) for name in OF_SIGNALS}


def described(own: Network) -> dict[str, Any]:
    """What the head of the file says of it."""
    return {"layers": len(own.weights), "activation": own.activation, "signals": [list(e) for e in own.signals.parts]}


def read_network(file: IO[bytes], about: Mapping[str, Any], c: int) -> Network:
    """The network of object c in a file, whose head describes it. Raises KeyError, TypeError or one of npz.FAULTS."""
    plain, signals = [f"{name}{c}" for name in PLAIN], [f"signal_{name}{c}" for name in OF_SIGNALS]
    layers = [[f"{name}{c}.{k}" for k in range(int(about["layers"]))] for name in OF_LAYERS]
    found = npz.stored(file, [*plain, *signals, *layers[0], *layers[1]], "")

    def of(names: list[str], kind: Any = np.float32) -> Any:
        return tuple(np.ascontiguousarray(found[name].read(), kind) for name in names)

    linear, offset, reach, given = of(plain)
    parts = tuple((str(name), int(size)) for name, size in about["signals"])
    own = Signals(parts, *of(signals, float))
    return Network(linear, offset, of(layers[0]), of(layers[1]), reach, given, str(about["activation"]), own)


def fits(own: Network, r: int) -> bool:
    """Whether the shapes fit each other and r coordinates, and all is finite."""
    shaped = own.offset.shape == (r,) and own.range.shape == (2, r) and own.input_range.ndim == 2
    shaped = shaped and len(own.input_range) == 2 and own.linear.shape == (2 * r + own.m, r)
    shaped = shaped and own.activation in ACTIVATIONS and len(own.weights) > 0 and own.signals.fits(own.m)
    if not shaped:
        return False
    size = 2 * r + own.m
    for weight, bias in zip(own.weights, own.biases, strict=True):
        if weight.ndim != 2 or len(weight) != size or bias.shape != (weight.shape[1],):
            return False
        size = weight.shape[1]
    every: list[Array | Single] = [own.linear, own.offset, own.range, own.input_range, *own.weights, *own.biases]
    return size == r and all(bool(np.isfinite(each).all()) for each in every)


CHUNK = 512
"""Frames between two looks at requests to end."""


class Stepper:
    """A network that plays one cloth, as `physics.samples.Reduced` does."""

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
        before = -self.system.h * translation.start_velocity(self.system, self.basis)
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
        evaluate(sizes, weights, biases, limits, smooth, q[t + 1], a, b)


@kernel
def evaluate(sizes, weights, biases, limits, smooth, out, a, b):
    """out (r,) of what is in a, which is overwritten."""
    r = len(out)
    copy_row(biases, out)
    add_product(a, weights, 0, sizes[0], r, out)
    at, bias = sizes[0] * r, r
    for k in range(len(sizes) - 1):
        rows, columns = sizes[k], sizes[k + 1]
        copy_row(biases[bias:], b[:columns])
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
