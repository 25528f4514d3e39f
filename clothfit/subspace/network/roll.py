"""Motions of a network, and the memory that its steps need."""

from __future__ import annotations

import numpy as np

from clothfit.base import interrupts
from clothfit.base.arrays import Array
from clothfit.engine.system import System
from clothfit.subspace import carrier
from clothfit.subspace.network.step import roll
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
