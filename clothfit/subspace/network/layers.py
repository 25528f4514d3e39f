"""A network while it is trained: recorded motions as coordinates and inputs, and windows of them; the linear part that
they give it; a step with all that its transpose needs, and that.

The linear part is that of least squares over all recorded steps, of u = [z₁, z₁ − z₂, w] and a constant, with a ridge:
what is left of a step after z₁ + (z₁ − z₂), z − 2 z₁ + z₂, is as small as it should be where hardly anything moves.

    u = [z₁, z₁ − z₂, w],  z = clip(u L + l + s ⊙ Φ((u − μ) ⊙ F)),  Φ layers h ↦ a(h W + b).

z are coordinates relative to their size, s the size of what the linear part leaves or the recipe's least, F the scales
of u, and a is ELU. Where z is clipped, the gradient passes if a step along it leads back.

The error of windows that a network plays by itself, and its gradient through all their steps.
"""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from clothfit.base.arrays import Array, Flags, Indices
from clothfit.subspace.network.signals import Signals
from clothfit.subspace.network.weights import Network


@dataclass(frozen=True, eq=False)
class Motions:
    """Motions of equal length. Frame 0 is the one before the start, with the velocities at the start."""

    z: Array  # (E, T, r)
    w: Array  # (E, T − 2, m), what acts on the step from frame t + 1 to t + 2
    good: Flags  # (E, T)

    def scaled(self, size: float, kind: Any) -> Motions:
        """With coordinates relative to a size, in numbers of a kind."""
        return replace(self, z=(self.z / size).astype(kind), w=self.w.astype(kind))

    def of(self, episodes: Sequence[int]) -> Motions:
        """Some of them."""
        own = list(episodes)
        return Motions(self.z[own], self.w[own], self.good[own])

    def joined(self, other: Motions) -> Motions:
        """With more motions of the same length."""
        pairs = ((self.z, other.z), (self.w, other.w), (self.good, other.good))
        return Motions(*(np.concatenate(pair) for pair in pairs))  # type: ignore[arg-type]

    def steps(self) -> tuple[Array, Array, Array, Array]:
        """Of all good steps the coordinates before (N, r), the ways there (N, r), inputs (N, m), and after (N, r)."""
        kept = self.good[:, :-2] & self.good[:, 1:-1] & self.good[:, 2:]
        before, now, after = self.z[:, :-2][kept], self.z[:, 1:-1][kept], self.z[:, 2:][kept]
        return now, now - before, self.w[kept], after

    def starts(self, length: int) -> tuple[Indices, int]:
        """Episodes and first frames (N, 2) of all windows with two frames and then `length` more, all of them good;
        where there is none, of the longest that there are; and their length.
        """
        bad = np.cumsum(~self.good, axis=1)
        length = min(length, bad.shape[1] - 2)
        while length > 0:
            end = length + 2
            among: Indices = bad[:, end - 1 :] - np.pad(bad, ((0, 0), (1, 0)))[:, : bad.shape[1] - end + 1]
            if (among == 0).any():
                return np.argwhere(among == 0).astype(np.int32), length
            length -= 1
        return np.zeros((0, 2), np.int32), 0

    def windows(self, starts: Indices, length: int) -> tuple[Array, Array]:
        """Frames (B, length + 2, r), and inputs (B, length, m)."""
        frames = starts[:, 1:] + np.arange(length + 2)
        return self.z[starts[:, :1], frames], self.w[starts[:, :1], frames[:, :-2]]


RIDGE = 1e-10
"""Of the squares of each column of u."""

LEAST = 1e-2
"""Of the largest scale is each: what hardly moves is not blown up."""


@dataclass(frozen=True, eq=False)
class Linear:
    """z̄ = u L + l, and the scales of what the layers take and give."""

    matrix: Array  # L, (2 r + m, r)
    offset: Array  # l, (r,)
    mean: Array  # μ, (2 r + m,)
    lift: Array  # F, (2 r + m,)
    left: Array  # s, (r,), the RMS of what it leaves out


def dense(motions: Motions) -> Linear:
    """That of all coordinates and inputs."""
    now, way, w, after = motions.steps()
    r = now.shape[1]
    u = np.concatenate([now, way, w], axis=1)
    columns = np.concatenate([u, np.ones((len(u), 1))], axis=1)
    gram = columns.T @ columns
    gram[np.diag_indices(len(gram) - 1)] *= 1.0 + RIDGE * 1e2
    gram[np.diag_indices(len(gram))] += RIDGE * np.append(np.diag(gram)[:-1], 0.0) + 1e-30
    found = np.linalg.lstsq(gram, columns.T @ (after - now - way), rcond=1e-13)[0]
    matrix = found[:-1].copy()
    matrix[:r] += np.eye(r)
    matrix[r : 2 * r] += np.eye(r)
    left = after - (u @ matrix + found[-1])
    deviations = [floored(part.std(axis=0)) for part in (now, way)]
    reach = np.maximum(w.std(axis=0), 1e-12)
    mean = np.concatenate([now.mean(axis=0), np.zeros(r), w.mean(axis=0)])
    return Linear(matrix, found[-1], mean, 1.0 / np.concatenate([*deviations, reach]), rms(left))


def rms(x: Array) -> Array:
    """Of each column."""
    return np.asarray(np.sqrt((x**2).mean(axis=0)))


def floored(scale: Array) -> Array:
    """Scales, none of them far below the largest."""
    return np.maximum(scale, max(LEAST * float(scale.max(initial=0.0)), 1e-12))


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
