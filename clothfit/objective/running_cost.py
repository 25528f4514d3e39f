"""The cost of a motion that passes by part by part, and its derivative on the way back.

The parts come in order, each with the state before it and those after its steps (`rollout.Rollout`). A frame belongs to
the part after whose steps it can first be told; on the way back each state receives what the frames around it say,
in the same order as at once, so that the parts change no bit of the result.

Squared distances add up as the motion passes, and nothing is kept. What looks at several frames together keeps the
states at the times of the frames (F, n, 3).
"""

from __future__ import annotations

from functools import cached_property
from typing import Protocol

import numpy as np

from clothfit.base.arrays import Array
from clothfit.engine.rollout import Rollout
from clothfit.motion.times import interpolation
from clothfit.objective.comparison import NOTHING, Comparison
from clothfit.objective.target import Target, accumulate, sample

COPIES = 6
"""Arrays (F, n, 3) that an objective works with beside the target, where it is not a sum of squared distances."""


class Tally(Protocol):
    """What is told of a motion in passing."""

    @property
    def value(self) -> float:
        """G, once the whole motion has passed."""

    def see(self, part: Rollout) -> None:
        """Look at the next part of a motion."""

    def derivative(self, part: Rollout) -> Array:
        """∂G/∂x (at least T + 1, n, 3) at the states of a part, from the last part to the first; the first entry, of
        the state before the part, is not whole.
        """


def tally(comparison: Comparison) -> Tally:
    """What tells the cost of a comparison."""
    if comparison.distances is None:
        return Measured(comparison)
    return Distances(comparison.goal, comparison.distances)


class Frames:
    """Which frames of a target belong to a part."""

    def __init__(self, goal: Target) -> None:
        self.goal, self.needed = goal, goal.step + (goal.fraction > 0)  # steps after which each frame can be told

    def of(self, part: Rollout) -> slice:
        """Those that can be told from a part, and not before."""
        ends = np.searchsorted(self.needed, [part.first, part.first + part.steps], side="right")
        return slice(int(ends[0]) if part.first else 0, int(ends[1]))

    def around(self, part: Rollout) -> tuple[slice, bool]:
        """Those that depend on the states after the steps of a part, and whether on the state after those as well."""
        last = part.first + part.steps
        begin = int(np.searchsorted(self.needed, part.first, side="right"))
        end = int(np.searchsorted(self.goal.step, last, side="right"))
        return slice(begin, end), end > begin and int(self.needed[end - 1]) > last

    def cut(self, frames: slice, part: Rollout) -> Target:
        """The target of some frames alone, its steps counted from the beginning of a part."""
        goal = self.goal
        weights = goal.weights[frames] if len(goal.weights) else goal.weights
        shifted = goal.step[frames] - np.int32(part.first)
        return Target(shifted, goal.fraction[frames], goal.positions[frames], goal.observed[frames], weights)


class Distances:
    """`scale` times the sum of squared distances, m²."""

    def __init__(self, goal: Target, scale: float = 1.0) -> None:
        self.frames, self.scale, self.total = Frames(goal), scale, 0.0
        self.after = np.zeros((1, *goal.positions.shape[1:]))  # the state after the part that comes next, going back

    @property
    def value(self) -> float:
        """G of what has passed."""
        return self.scale * self.total

    def see(self, part: Rollout) -> None:
        """Add the next part of a motion."""
        goal = self.frames.cut(self.frames.of(part), part)
        self.total = float(accumulate(part.x, goal, NOTHING, self.total))

    def derivative(self, part: Rollout) -> Array:
        """∂G/∂x, see `Tally`."""
        frames, beyond = self.frames.around(part)
        x = np.concatenate([part.x, self.after]) if beyond else part.x
        found = np.zeros_like(x)
        accumulate(x, self.frames.cut(frames, part), found, 0.0)
        self.after[0] = part.x[1]
        return found if self.scale == 1.0 else self.scale * found


class Measured:
    """Any comparison: it keeps the states at the times of the frames."""

    def __init__(self, comparison: Comparison) -> None:
        self.comparison, self.frames = comparison, Frames(comparison.goal)
        self.states = np.empty_like(comparison.goal.positions)

    @property
    def value(self) -> float:
        """G, once the whole motion has passed."""
        return self.comparison.cost_of(self.states)

    def see(self, part: Rollout) -> None:
        """Take the states of the next part of a motion."""
        frames = self.frames.of(part)
        self.states[frames] = sample(self.frames.cut(frames, part), part.x)

    @cached_property
    def by_frame(self) -> Array:
        """∂G/∂s (F, n, 3)."""
        return self.comparison.derivative_of(self.states)

    def derivative(self, part: Rollout) -> Array:
        """∂G/∂x, see `Tally`."""
        frames, beyond = self.frames.around(part)
        goal = self.frames.cut(frames, part)
        states = len(part.x) + beyond
        back = interpolation(goal.step, goal.fraction, states).T
        by_frame = self.by_frame[frames]
        found: Array = back @ by_frame.reshape(len(by_frame), part.x[0].size)
        return np.ascontiguousarray(found).reshape(states, *part.x.shape[1:])
