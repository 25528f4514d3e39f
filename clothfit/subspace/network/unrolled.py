"""The error of windows that a network plays by itself, and its gradient through all their steps."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from clothfit.base.arrays import Array
from clothfit.subspace.network.layers import Trained

TINY = 1e-12
"""Below the squares of norms, whose derivative has no value at 0."""


@dataclass(frozen=True)
class Loss:
    """Mean errors of coordinates and, `velocity` times, of the ways from frame to frame."""

    absolute: bool  # mean absolute error of all components; else the mean norm of a frame's error
    velocity: float

    def of(self, made: Array, given: Array, first: Array, last: Array) -> tuple[float, Array]:
        """For frames (B, S, r) and those that should be, after `first` and `last` (B, r), which are the same for the
        made and the given ones: the error, and its derivative by the made ones.
        """
        away = made - given
        ways = away - np.concatenate([(first - last)[:, None], away[:, :-1]], axis=1)
        error, grad = self.mean(away)
        more, by_way = self.mean(ways)
        grad += self.velocity * by_way
        grad[:, :-1] -= self.velocity * by_way[:, 1:]
        return error + self.velocity * more, grad

    def mean(self, away: Array) -> tuple[float, Array]:
        """The mean error, and its derivative."""
        if self.absolute:
            return float(np.abs(away).mean()), np.sign(away) / away.size
        norm = np.sqrt((away * away).sum(axis=2, keepdims=True) + TINY)
        return float(norm.mean()), away / (norm * norm.size)


def gradient(own: Trained, loss: Loss, z: Array, w: Array, begin: Array) -> tuple[float, list[Array]]:
    """The error of windows z (B, S + 2, r) under inputs w (B, S, m), which begin at (B, 2, r) in place of their first
    two frames, and its gradient by all values.
    """
    z2, z1 = begin[:, 0], begin[:, 1]
    kept, made = [], []
    for k in range(w.shape[1]):
        after, more = own.step(z1, z2, w[:, k])
        kept.append(more)
        made.append(after)
        z2, z1 = z1, after
    error, by = loss.of(np.stack(made, axis=1), z[:, 2:], begin[:, 1], z[:, 1])
    grad = [np.zeros_like(each) for each in own.values]
    ahead, beyond = np.zeros_like(z1), np.zeros_like(z1)
    for k in range(w.shape[1] - 1, -1, -1):
        by_z1, by_z2 = own.pull(kept[k], by[:, k] + ahead, grad)
        ahead, beyond = beyond + by_z1, by_z2
    return error, grad


def played(own: Trained, z: Array, w: Array) -> Array:
    """Whole motions (E, T, r) of the network, from the first two frames of given ones."""
    made = [z[:, 0], z[:, 1]]
    for k in range(w.shape[1]):
        made.append(own.step(made[-1], made[-2], w[:, k])[0])
    return np.stack(made, axis=1)
