"""A network while it is trained: a step with all that its transpose needs, and that.

    u = [z₁, z₁ − z₂, w],  z = clip(u L + l + s ⊙ Φ((u − μ) ⊙ F)),  Φ layers h ↦ a(h W + b).

z are coordinates relative to their size, s the size of what the linear part leaves or the recipe's least, F the scales
of u, and a is ELU. Where z is clipped, the gradient passes if a step along it leads back.

The error of windows that a network plays by itself, and its gradient through all their steps.
"""

from __future__ import annotations

import itertools
from dataclasses import dataclass
from typing import Any

import numpy as np

from clothfit.base.arrays import Array
from clothfit.subspace.network.signals import Signals
from clothfit.subspace.network.weights import Network
from clothfit.subspace.network.windows import Linear

TINY = 1e-12
"""Below the size of what any linear part leaves, and below the squares of norms, which have no derivative at 0."""


@dataclass(frozen=True)
class Recipe:
    """How a network is made and trained (docs/subspace.md). Sizes of coordinates are relative to their standard
    deviations in the data.
    """

    hidden: tuple[float, ...] = (2.0,) * 3  # widths of the layers between, relative to r
    windows: tuple[int, int] = (4, 48)  # frames fed with their own predictions, at the start and from GROWN on
    least: float = 2e-3  # size of what the layers give, where the linear part leaves less: else they learn too slowly
    batch: int = 64
    rate: float = 1e-3  # of the steps of the optimiser, at first; it falls as half a cosine
    noise: float = 0.005  # on both frames that a window begins with
    shake: float = 0.1  # of the second one beside that, relative to it
    velocity: float = 0.25  # weight of errors of velocities, relative to those of coordinates of the same relative size
    clip: float = 1.0  # of the gradient's norm
    margin: float = 0.1  # by which coordinates may leave the range of the data
    rests: bool = True  # learn also from motions that come to rest, which physics on the basis plays (`learn`)


OWN = Recipe()


class Trained:
    """The values, and their fixed surroundings."""

    def __init__(self, prior: Linear, recipe: Recipe, limits: Array, rng: np.random.Generator, kind: Any) -> None:
        """`limits` (2, r) of the coordinates; weights as He et al. start them, those of the last layer so that it gives
        a tenth of what the linear part leaves.
        """
        self.r, self.kind = prior.offset.shape[0], kind
        sizes = [len(prior.lift), *(max(1, round(width * self.r)) for width in recipe.hidden), self.r]
        pairs = list(itertools.pairwise(sizes))
        self.weights = [(np.sqrt(2.0 / a) * rng.standard_normal((a, b))).astype(kind) for a, b in pairs]
        size = np.maximum(prior.left, max(recipe.least, TINY))
        self.weights[-1] *= kind(0.1 * np.linalg.norm(prior.left) / np.linalg.norm(size))
        self.biases = [np.zeros(b, kind) for b in sizes[1:]]
        self.linear, self.offset = prior.matrix.astype(kind), prior.offset.astype(kind)
        self.mean, self.lift = prior.mean.astype(kind), prior.lift.astype(kind)
        self.left, (self.low, self.high) = size.astype(kind), limits.astype(kind)

    @property
    def values(self) -> list[Array]:
        """All that is trained."""
        return [*self.weights, *self.biases, self.linear, self.offset]

    def step(self, z1: Array, z2: Array, w: Array) -> tuple[Array, Any]:
        """The next coordinates (B, r), and what `pull` needs."""
        u = np.concatenate([z1, z1 - z2, w], axis=1)
        h = (u - self.mean) * self.lift
        kept = [h]
        for weight, bias in zip(self.weights[:-1], self.biases[:-1], strict=True):
            h = h @ weight
            h += bias
            np.maximum(h, np.expm1(np.minimum(h, 0.0)), out=h)
            kept.append(h)
        z = h @ self.weights[-1] + self.biases[-1]
        z *= self.left
        z += u @ self.linear
        z += self.offset
        return np.clip(z, self.low, self.high), (u, kept, z < self.low, z > self.high)

    def pull(self, kept: Any, gz: Array, grad: list[Array]) -> tuple[Array, Array]:
        """Add the derivatives by all values to `grad`, for that by z, gz (B, r); returns those by z₁ and z₂."""
        u, layers, below, above = kept
        g = np.where((below & (gz > 0)) | (above & (gz < 0)), 0.0, gz).astype(self.kind)
        count, r = len(self.weights), self.r
        grad[2 * count] += u.T @ g
        grad[2 * count + 1] += g.sum(axis=0)
        gu = g @ self.linear.T
        gh = g * self.left
        for k in range(count - 1, -1, -1):
            h = layers[k]
            grad[k] += h.T @ gh
            grad[count + k] += gh.sum(axis=0)
            gh = gh @ self.weights[k].T
            if k:
                gh *= np.minimum(h, 0.0) + 1.0
        gu += gh * self.lift
        return gu[:, :r] + gu[:, r : 2 * r], -gu[:, r : 2 * r]

    def network(self, size: float, signals: Signals, input_range: Array) -> Network:
        """What is played, for coordinates of that size: all scales folded into the arrays."""
        m = self.linear.shape[0] - 2 * self.r
        scale = np.concatenate([np.full(2 * self.r, 1.0 / size), np.ones(m)])[:, None]
        first = self.lift.astype(float)[:, None] * self.weights[0]
        weights = [first * scale, *(each.astype(float) for each in self.weights[1:])]
        biases = [self.biases[0] - self.mean @ first, *(each.astype(float) for each in self.biases[1:])]
        out = size * self.left.astype(float)
        weights[-1], biases[-1] = weights[-1] * out, biases[-1] * out

        def single(array: Array) -> Any:
            return np.ascontiguousarray(array, np.float32)

        return Network(
            single(size * scale * self.linear), single(size * self.offset), tuple(map(single, weights)),
            tuple(map(single, biases)), single(size * np.stack([self.low, self.high])), single(input_range),
            "elu", signals,
        )  # fmt: skip


@dataclass(frozen=True)
class Loss:
    """Mean norms of the errors of frames and, `velocity` times, of the ways from frame to frame."""

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
