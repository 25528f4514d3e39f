"""Is what is left at a result noise? Tests of residuals, for fits and for optimisers that ask on their way.

Noise of a capture is new in each frame; what a wrong model leaves changes slowly. With e_t the residuals of one cloth
in frame t, those before it of the same vertices e_t⁻, and c_t = e_t·e_t⁻ / (|e_t| |e_t⁻|),

    z = Σ_t c_t / sqrt(Σ_t c_t²)

is nearly standard normal where the signs of the frames are independent, whatever the noise is like within a frame and
however it grows: turning the signs of frames changes no c_t² (E. S. Edgington, Randomization Tests, 1995). The values
that were fitted only lower it. Of a few frames, z cannot be large; there, and where the frames are so far apart that
the motion itself forgets from one to the next, the same test is done in space, with a sum for each pair of vertices
that a spring joins in place of each frame.

A bias far below the noise adds up over the frames. With the weights W of pairs of frames that a mean over time has, or
the slowest cosines, T = Σ_{s≠t} W_st e_s·e_t is 0 on average over the signs of the frames, with the variance
2 Σ_{s≠t} W_st² (e_s·e_t)². Beside the diagonal E = Σ_t W_tt |e_t|², E + T is then nearly E/ν times a χ² of
ν = 2 E² / variance degrees of freedom (F. E. Satterthwaite, 1946): exactly so for normal noise, whether all vertices
share it or none. `RARE` is how often noise fails each of the two.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from clothfit.base.arrays import Array, Flags, Indices
from clothfit.engine.rollout import Rollout
from clothfit.engine.system import mobile
from clothfit.objective.comparison import Loss
from clothfit.objective.measures import Cloud
from clothfit.objective.objective import Objective
from clothfit.objective.run import Run
from clothfit.objective.running_cost import movable
from clothfit.objective.target import Frames, sample

SIGNIFICANT = 3.3
"""z from which on residuals are no noise: one fit in 2000 by chance."""

FEWEST_PAIRS = 14
"""Pairs of frames below which the signs alone cannot show that residuals are no noise."""

FORGOTTEN = 0.5
"""Correlation of a motion's changes from frame to frame, below which its frames are too far apart for a test in time.
"""

RARE = 0.005
"""Probability of a bias in noise by chance from which on it counts: with two tests one fit in 100."""

BLOCKS = 64
"""Sums over successive frames, at most, that a bias is looked for in; of more frames each has several."""

SLOWEST = 4
"""Cosines beside the mean, of half a period to two over the motion."""

NEAR_ZERO = 1e-2
"""Residuals of a frame, relative to those of all, below which they count as if they were so large: they are rounding.
"""


class Sums(NamedTuple):
    """Of one test: its products with their sizes, and what they come to."""

    products: Array  # (K,), of a frame or a pair of vertices with the one before or beside it
    sizes: Array  # (K,), the largest that they could be

    def correlation(self) -> float:
        """Pooled correlation, −1 … 1; 0 where nothing is known."""
        total = float(self.sizes.sum())
        return float(self.products.sum()) / total if total > 0 else 0.0

    def z(self) -> float:
        """How many standard deviations the sum of c (K,) is above that of independent signs; products that are small
        beside the others count less.
        """
        floor = NEAR_ZERO**2 * float(self.sizes.mean()) if len(self.sizes) else 0.0
        known = self.sizes > 0
        c = self.products[known] / np.maximum(self.sizes[known], floor)
        squares = float((c * c).sum())
        return float(c.sum()) / np.sqrt(squares) if squares > 0 else 0.0


@dataclass(frozen=True)
class ResidualTest:
    """What residuals look like."""

    in_time: float  # correlation of a residual with the one before it
    in_space: float  # correlation of the residuals of neighbours
    z_time: float  # standard deviations above that of noise
    z_space: float
    space_counts: bool  # whether frames are too few or too far apart for the test in time
    bias: float = 0.0  # share of the squares that a mean over time, or slow changes, have beside the noise
    by_chance: float = 1.0  # probability of so large a bias in noise, the smaller one of both tests

    @property
    def is_noise(self) -> bool:
        """Whether nothing speaks against noise."""
        return self.z_time < SIGNIFICANT and not (self.space_counts and self.z_space >= SIGNIFICANT)

    @property
    def is_unbiased(self) -> bool:
        """Whether nothing speaks against noise, nor does anything add up over the frames."""
        return self.is_noise and self.by_chance >= RARE

    @property
    def unexplained(self) -> float:
        """Share of the squares that is no noise, a bias included, 0 … 1."""
        return max(self.structured, float(np.clip(self.bias, 0.0, 1.0)) if self.by_chance < RARE else 0.0)

    @property
    def structured(self) -> float:
        """Share of the squares that is no noise, 0 … 1."""
        parts = [self.in_time, self.in_space if self.space_counts else 0.0]
        return float(np.clip(max(parts), 0.0, 1.0))


class Series:
    """The residuals of one cloth, frame by frame; only the last ones are kept."""

    def __init__(self, count: int, pairs: Indices, lag: int = 1) -> None:
        """`count` residuals in a frame, of which `pairs` (E, 2) are neighbours; each is compared with the one `lag`
        frames before.
        """
        self.pairs = pairs
        self.past: list[tuple[Array, Flags]] = [(np.zeros((count, 1)), np.zeros(count, bool))] * lag
        self.along: list[tuple[float, float]] = []  # product and size of each frame
        self.across_pairs = np.zeros(len(pairs))
        self.first, self.second = np.zeros(len(pairs)), np.zeros(len(pairs))

    def add(self, values: Array, seen: Flags) -> None:
        """Take the residuals (count, c) of the next frame, of which some are `seen` (count,)."""
        before, known = self.past[0]
        both = seen & known
        if both.any():
            e, b = values[both], np.broadcast_to(before, values.shape)[both]
            self.along.append((float((e * b).sum()), float(np.sqrt((e * e).sum() * (b * b).sum()))))
        a, b = self.pairs.T
        there = (seen[a] & seen[b])[:, None]
        left, right = np.where(there, values[a], 0.0), np.where(there, values[b], 0.0)
        self.across_pairs += (left * right).sum(axis=1)
        self.first += (left * left).sum(axis=1)
        self.second += (right * right).sum(axis=1)
        last, known = self.past[-1]  # the residuals that were last seen
        latest = np.where(seen[:, None], values, np.broadcast_to(last, values.shape)), seen | known
        self.past = [*self.past[1:], latest]

    def in_time(self) -> Sums:
        """The sums of successive frames."""
        pairs = np.array(self.along).reshape(-1, 2)
        return Sums(pairs[:, 0], pairs[:, 1])

    def in_space(self) -> Sums:
        """The sums of neighbours."""
        return Sums(self.across_pairs, np.sqrt(self.first * self.second))


class Bias:
    """The residuals of one cloth, summed over blocks of successive frames."""

    def __init__(self, count: int, frames: int) -> None:
        """Of `count` vertices in so many frames."""
        self.length, self.squares = max(-(-frames // BLOCKS), 1), 0.0
        self.sums = np.zeros((-(-frames // self.length), 3 * count))

    def add(self, frame: int, values: Array) -> None:
        """Take the residuals (count, 3) of a frame, 0 where nothing is seen."""
        self.sums[frame // self.length] += values.ravel()
        self.squares += float((values * values).sum())

    def parts(self) -> Array:
        """E, T, m², and the variance of T, of the mean and of the slowest cosines, (2, 3)."""
        count = len(self.sums)
        if not count:
            return np.zeros((2, 3))
        G = self.sums @ self.sums.T / self.length
        waves = np.cos(np.pi * np.arange(SLOWEST + 1)[:, None] * (np.arange(count) + 0.5) / count)
        waves *= np.sqrt(np.where(np.arange(SLOWEST + 1) > 0, 2.0, 1.0) / count)[:, None]
        found = []
        for basis in (waves[:1], waves[1:count]):
            product = (basis.T @ basis) * G
            apart = product - np.diag(np.diag(product))
            found.append((np.trace(product), apart.sum(), 2.0 * (apart * apart).sum()))
        return np.array(found)


def biased(found: Iterable[Bias]) -> tuple[float, float]:
    """The share of the squares of residuals that is a bias, and the probability of such a one in noise."""
    from scipy.special import gammaincc  # of χ²

    given = list(found)
    E, T, variance = sum((each.parts() for each in given), np.zeros((2, 3))).T
    squares = sum(each.squares for each in given)
    known = (variance > 0) & (E > 0)
    if not known.any() or not squares > 0:
        return 0.0, 1.0
    half = (E[known] ** 2) / variance[known]
    chance = gammaincc(half, np.maximum(half * (1.0 + T[known] / E[known]), 0.0))
    return float(np.maximum(T, 0.0).sum()) / squares, float(chance.min())


class Watch:
    """An observer of one run, which takes what is left of each frame."""

    def __init__(self, run: Run, loss: Loss, velocities: bool = False, edges: bool = False) -> None:
        """`velocities`, `edges`: whether these are compared, velocities or lengths of springs, not positions."""
        self.goal, self.loss, self.velocities, self.edges = run.comparison.goal, loss, velocities, edges
        self.frames, self.free, self.ends = Frames(self.goal), mobile(run.system), np.asarray(run.system.springs.ends)
        self.visible, none = movable(self.goal, self.free), np.zeros((0, 2), np.int32)
        shows = None if velocities or edges else run.comparison.surface
        self.cloud = shows if isinstance(shows, Cloud) else None
        self.surface = None if isinstance(shows, Cloud) else shows
        if self.surface:
            moves = self.surface.weights @ self.free.astype(float) != 0.0
            self.visible, self.ends = self.surface.seen & moves & (self.goal.places > 0)[:, None], none
        count = len(self.ends) if edges else self.visible.shape[1]
        self.residuals = Series(count, none if edges else self.ends, lag=2 if velocities else 1)
        self.motion = Series(len(self.free), none)
        self.bias = Bias(count, 0 if velocities or edges else len(self.goal.step))
        self.before: Array | None = None  # (n, 3) gaps and states of the frame before
        self.state: Array | None = None

    def update(self, chunk: Rollout) -> None:
        """Take the next chunk of a motion."""
        frames = self.frames.of(chunk)
        goal = self.frames.cut(frames, chunk)
        for i, (s, target) in enumerate(zip(sample(goal, chunk.x), goal.positions, strict=True), start=frames.start):
            self._take(s, target, self.visible[i], i)

    def _take(self, s: Array, target: Array, seen: Flags, frame: int) -> None:
        if self.cloud:
            s, before = s.copy(), self.state
            gap, seen = self.cloud.by_vertex(s, frame)
            seen = seen & self.free & (self.goal.places[frame] > 0)
            self._add(frame, np.where(seen[:, None], gap, 0.0), seen)
            if before is not None:
                self.motion.add(s - before, self.free)
            self.state = s
            return
        own, target = (s, target) if self.surface is None else (self.surface.weights @ s, self.surface.points[frame])
        gap = np.where(seen[:, None], own - np.where(seen[:, None], target, 0.0), 0.0)
        if self.edges:
            both = np.asarray(seen[self.ends].all(axis=1))
            lengths = [np.linalg.norm(x[self.ends[:, 0]] - x[self.ends[:, 1]], axis=1) for x in (s, s - gap)]
            self.residuals.add((lengths[0] - lengths[1])[:, None], both)
        elif not self.velocities:
            factor = np.sqrt(self.loss.derivative((gap * gap).sum(axis=1)))
            if len(weights := self.goal.weights):
                factor = factor * np.sqrt(np.where(seen, weights[frame], 0.0))
            self._add(frame, factor[:, None] * gap, seen)
        elif self.before is not None:
            self.residuals.add(gap - self.before, seen)
        if self.state is not None:
            self.motion.add(s - self.state, self.free)
        self.before, self.state = gap, s.copy()

    def _add(self, frame: int, residuals: Array, seen: Flags) -> None:
        self.residuals.add(residuals, seen)
        self.bias.add(frame, residuals)


def combined(series: Iterable[tuple[Series, Series]], sums: Iterable[Bias] = ()) -> ResidualTest:
    """The test of the residuals of one or more cloths, each with the changes of its motion from frame to frame, and of
    their sums over frames.
    """
    given = list(series)
    time, space = together(own.in_time() for own, _ in given), together(own.in_space() for own, _ in given)
    motion = together(changes.in_time() for _, changes in given)
    few = max((len(own.along) for own, _ in given), default=0) < FEWEST_PAIRS
    coarse = few or motion.correlation() < FORGOTTEN
    return ResidualTest(time.correlation(), space.correlation(), time.z(), space.z(), coarse, *biased(sums))


def together(sums: Iterable[Sums]) -> Sums:
    """The sums of several cloths as one."""
    parts = [*sums]
    return Sums(*(np.concatenate([np.zeros(0), *(part[k] for part in parts)]) for k in (0, 1)))


def residual_test(objective: Objective, p: Array) -> ResidualTest | None:
    """Whether the residuals at p (P,) are noise, in the time of a simulation; None where only spectra are compared.

    Positions are tested where they are compared; else velocities, else lengths. Raises Diverged.
    """
    compared = objective.weights
    if not {"position", "velocity", "edge-length"} & set(compared):
        return None
    velocities = "position" not in compared and "velocity" in compared
    edges = "position" not in compared and not velocities
    found, sums = [], []
    for run in objective.runs:
        watch = Watch(run, objective.loss, velocities, edges)
        objective.simulate(run, p, watch.update)
        found.append((watch.residuals, watch.motion))
        sums.append(watch.bias)
    return combined(found, sums)
