"""Targets: where one cloth should be, at the times at which it was observed (`motion.times`)."""

from __future__ import annotations

from collections.abc import Iterable
from typing import NamedTuple

import numpy as np

from clothfit.base.arrays import Array, Flags, Indices
from clothfit.engine.rollout import Rollout
from clothfit.kernels.kernel import kernel
from clothfit.motion.motion import Motion
from clothfit.motion.times import frame_places, interpolated


class Target(NamedTuple):
    """Where one cloth should be: F frames of n vertices."""

    step: Indices  # j (F,), the last step that is not after the frame; 0 is the initial state
    fraction: Array  # φ (F,), how far into the next step the frame is, 0 … 1
    positions: Array  # x*, (F, n, 3), m, not a copy where that is possible; anything where not observed
    observed: Flags  # (F, n), observed with a weight above 0
    weights: Array  # (F, n), how often each position counts, anything where not observed; (0, 0) where all count once
    radii: Array = np.zeros(0)  # of its shadow (RAYS,), m, or of `positions` where empty

    @property
    def places(self) -> Array:
        """Times of the frames (F,), in steps."""
        return self.step + self.fraction

    @property
    def last_step(self) -> int:
        """Number of steps that must be simulated."""
        return int((self.step + (self.fraction > 0)).max(initial=0))

    @property
    def seen(self) -> Flags:
        """Which vertices (n,) are observed at some time after the initial state."""
        return np.asarray(self.observed[self.places > 0].any(axis=0))


def target(motion: Motion, cloth: int, delta: float, last_step: float | None = None) -> Target:
    """The part of a motion that is one cloth's, up to step `last_step`. Raises InvalidMotion as `frame_places` does."""
    step, fraction = frame_places(motion, delta)
    kept = slice(None if last_step is None else int(np.searchsorted(step + fraction, last_step, side="right")))
    observed = np.ascontiguousarray(motion.seen(cloth)[kept])
    weights = motion.weights_of(cloth)
    if weights is not None:
        observed = np.ascontiguousarray(observed & (weights[kept] > 0))
    positions = np.ascontiguousarray(motion.of(cloth)[kept])  # in one memory order, so that kernels compile once
    counted = np.zeros((0, 0)) if weights is None else np.ascontiguousarray(weights[kept])
    return Target(step[kept], fraction[kept], positions, observed, counted, motion.radii)


def without_start(goal: Target, vertices: Indices) -> Target:
    """The target without where it shows some vertices in the initial state, which a fit may move."""
    observed = goal.observed.copy()
    observed[np.ix_(goal.places <= 0, vertices)] = False
    return goal._replace(observed=observed)


class Frames:
    """Which frames of a target belong to a chunk of the motion: to the one after whose steps they are first known."""

    def __init__(self, goal: Target) -> None:
        self.goal, self.needed = goal, goal.step + (goal.fraction > 0)  # steps after which each frame is known

    def of(self, chunk: Rollout) -> slice:
        """Those that are known after a chunk, and not before."""
        ends = np.searchsorted(self.needed, [chunk.first, chunk.first + chunk.steps], side="right")
        return slice(int(ends[0]) if chunk.first else 0, int(ends[1]))

    def around(self, chunk: Rollout) -> tuple[slice, bool]:
        """Those that depend on the states after the steps of a chunk, and whether on the state after those as well."""
        last = chunk.first + chunk.steps
        begin = int(np.searchsorted(self.needed, chunk.first, side="right"))
        end = int(np.searchsorted(self.goal.step, last, side="right"))
        return slice(begin, end), end > begin and int(self.needed[end - 1]) > last

    def cut(self, frames: slice, chunk: Rollout) -> Target:
        """The target of some frames alone, its steps counted from the beginning of a chunk."""
        goal = self.goal
        weights = goal.weights[frames] if len(goal.weights) else goal.weights
        shifted = goal.step[frames] - np.int32(chunk.first)
        return Target(shifted, goal.fraction[frames], goal.positions[frames], goal.observed[frames], weights)


def first_step(targets: Iterable[tuple[Target, Flags]]) -> int:
    """The first step after the start at which, or before which, any target shows some of what is observed (F, …); 0
    where none does.
    """
    shown = [goal.places[observed.any(axis=1) & (goal.places > 0)] for goal, observed in targets]
    return int(np.ceil(min((places[0] for places in shown if places.size), default=0)))


def sample(goal: Target, x: Array) -> Array:
    """The states (F, n, 3) of a motion x (T + 1, n, 3), T at least `goal.last_step`, at the times of the frames."""
    return interpolated(x, goal.step, goal.fraction)


@kernel
def accumulate(x, goal, derivative, total):
    """`total` + G of a motion x (T + 1, n, 3), G = Σ w |s − x*|², m²; adds ∂G/∂x to `derivative` unless that is empty.
    """
    weighted = len(goal.weights) > 0
    for frame in range(len(goal.step)):
        t, fraction = goal.step[frame], goal.fraction[frame]
        for i in range(x.shape[1]):
            if goal.observed[frame, i]:
                weight = goal.weights[frame, i] if weighted else 1.0
                for c in range(3):
                    state = x[t, i, c]
                    if fraction > 0.0:
                        state = (1.0 - fraction) * state + fraction * x[t + 1, i, c]
                    gap = state - goal.positions[frame, i, c]
                    total += weight * gap * gap
                    if len(derivative) > 0:
                        by_state = 2.0 * weight * gap
                        derivative[t, i, c] += (1.0 - fraction) * by_state
                        if fraction > 0.0:
                            derivative[t + 1, i, c] += fraction * by_state
    return total
