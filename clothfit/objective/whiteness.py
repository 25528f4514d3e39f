"""Is what is left at a result noise? Tests of residuals, for fits and for optimisers that ask on their way.

Noise of a capture is new in each frame; what a wrong model leaves changes slowly. With e_t the residuals of one cloth
in frame t, those before it of the same vertices e_t⁻, and c_t = e_t·e_t⁻ / (|e_t| |e_t⁻|),

    z = Σ_t c_t / sqrt(Σ_t c_t²)

is nearly standard normal where the signs of the frames are independent, whatever the noise is like within a frame and
however it grows: turning the signs of frames changes no c_t² (E. S. Edgington, Randomization Tests, 1995). The values
that were fitted only lower it. Of a few frames, z cannot be large; there, and where the frames are so far apart that
the motion itself forgets from one to the next, the same test is done in space, with a sum for each pair of vertices
that a spring joins in place of each frame.
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

    @property
    def is_noise(self) -> bool:
        """Whether nothing speaks against noise."""
        return self.z_time < SIGNIFICANT and not (self.space_counts and self.z_space >= SIGNIFICANT)

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
        self.beside = np.zeros(len(pairs))
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
        self.beside += (left * right).sum(axis=1)
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
        return Sums(self.beside, np.sqrt(self.first * self.second))


class Watch:
    """An observer of one run, which takes what is left of each frame."""

    def __init__(self, run: Run, loss: Loss, velocities: bool = False, edges: bool = False) -> None:
        """`velocities`, `edges`: whether these are compared, velocities or lengths of springs, not positions."""
        self.goal, self.loss, self.velocities, self.edges = run.comparison.goal, loss, velocities, edges
        self.frames, self.free, self.ends = Frames(self.goal), mobile(run.system), np.asarray(run.system.springs.ends)
        self.shown, none = movable(self.goal, self.free), np.zeros((0, 2), np.int32)
        count = len(self.ends) if edges else len(self.free)
        self.residuals = Series(count, none if edges else self.ends, lag=2 if velocities else 1)
        self.motion = Series(len(self.free), none)
        self.before: Array | None = None  # (n, 3) gaps and states of the frame before
        self.state: Array | None = None

    def update(self, chunk: Rollout) -> None:
        """Take the next chunk of a motion."""
        frames = self.frames.of(chunk)
        goal = self.frames.cut(frames, chunk)
        for i, (s, target) in enumerate(zip(sample(goal, chunk.x), goal.positions, strict=True), start=frames.start):
            self._take(s, target, self.shown[i], i)

    def _take(self, s: Array, target: Array, seen: Flags, frame: int) -> None:
        gap = np.where(seen[:, None], s - np.where(seen[:, None], target, 0.0), 0.0)
        if self.edges:
            both = np.asarray(seen[self.ends].all(axis=1))
            lengths = [np.linalg.norm(x[self.ends[:, 0]] - x[self.ends[:, 1]], axis=1) for x in (s, s - gap)]
            self.residuals.add((lengths[0] - lengths[1])[:, None], both)
        elif not self.velocities:
            factor = np.sqrt(self.loss.derivative((gap * gap).sum(axis=1)))
            if len(weights := self.goal.weights):
                factor = factor * np.sqrt(np.where(seen, weights[frame], 0.0))
            self.residuals.add(factor[:, None] * gap, seen)
        elif self.before is not None:
            self.residuals.add(gap - self.before, seen)
        if self.state is not None:
            self.motion.add(s - self.state, self.free)
        self.before, self.state = gap, s.copy()


def combined(series: Iterable[tuple[Series, Series]]) -> ResidualTest:
    """The test of the residuals of one or more cloths, each with the changes of its motion from frame to frame."""
    given = list(series)
    time, space = together(own.in_time() for own, _ in given), together(own.in_space() for own, _ in given)
    motion = together(changes.in_time() for _, changes in given)
    few = max((len(own.along) for own, _ in given), default=0) < FEWEST_PAIRS
    coarse = few or motion.correlation() < FORGOTTEN
    return ResidualTest(time.correlation(), space.correlation(), time.z(), space.z(), coarse)


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
    found = []
    for run in objective.runs:
        watch = Watch(run, objective.loss, velocities, edges)
        objective.simulate(run, p, watch.update)
        found.append((watch.residuals, watch.motion))
    return combined(found)
