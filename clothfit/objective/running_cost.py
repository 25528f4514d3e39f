"""The cost of a motion that passes chunk by chunk, its derivative on the way back, and its residuals.

The chunks come in order, each with the state before it and those after its steps (`rollout.Rollout`). A frame belongs
to the chunk after whose steps it is first known. On the way back each state receives the derivatives of the frames
around it in the same order as it would at once, so that chunks change no bit of the result.

Squared distances are summed as the motion passes, and nothing is kept. Every other comparison, which may look at
several frames together, keeps the states at the times of the frames (F, n, 3). Both answer the same questions.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import cached_property
from typing import Protocol

import numpy as np

from clothfit.base.arrays import Array, Flags
from clothfit.derivative.adjoint import Observer
from clothfit.engine.rollout import Rollout
from clothfit.motion.times import interpolation
from clothfit.objective.comparison import Comparison
from clothfit.objective.running_residuals import DistanceResiduals, MatrixResiduals, Residuals, free_columns, movable
from clothfit.objective.target import Frames, Target, accumulate, sample

NO_DERIVATIVE = np.empty((0, 0, 0))

STATE_COPIES = 6
"""Arrays (F, n, 3) that a cost works with beside the target, where it is not a sum of squared distances."""


class RunningCost(Protocol):
    """The cost of one motion of one cloth."""

    bytes: int  # what it works with beside the target
    residual_bytes: int  # what its residuals keep

    @property
    def value(self) -> float:
        """G, once the whole motion has passed."""

    def value_over(self, shorter: Comparison) -> float:
        """G over the first frames alone, once they have passed and no others; `shorter` compares these."""

    def update(self, chunk: Rollout) -> None:
        """Take the next chunk of the motion."""

    def derivative(self, chunk: Rollout) -> Array:
        """∂G/∂x (at least T + 1, n, 3) at the states of a chunk, from the last chunk to the first; the first entry, of
        the state before the chunk, is not complete.
        """

    def residuals(self, free: Flags) -> Residuals:
        """The residuals of the motion that has passed, as it passes again, where the vertices `free` (n,) can move."""

    def squares(self, free: Flags, show: Callable[[Observer], object]) -> tuple[float, int]:
        """Sum of squares and number of these residuals, for the motion that `show` shows to an observer."""


def running_cost(comparison: Comparison) -> RunningCost:
    """The cost of a comparison, for one motion."""
    scale = comparison.distance_scale
    return KeptStates(comparison) if scale is None else SquaredDistances(comparison.goal, scale)


class SquaredDistances:
    """`scale` times the sum of squared distances, m²."""

    bytes = residual_bytes = 0

    def __init__(self, goal: Target, scale: float = 1.0) -> None:
        self.frames, self.scale, self.total = Frames(goal), scale, 0.0
        self.after = np.zeros((1, *goal.positions.shape[1:]))  # the state after the chunk that comes next, going back

    @property
    def value(self) -> float:
        """G of what has passed."""
        return self.scale * self.total

    def value_over(self, shorter: Comparison) -> float:
        """See `RunningCost`."""
        return self.value

    def update(self, chunk: Rollout) -> None:
        """Add the next chunk of a motion."""
        goal = self.frames.cut(self.frames.of(chunk), chunk)
        self.total = float(accumulate(chunk.x, goal, NO_DERIVATIVE, self.total))

    def derivative(self, chunk: Rollout) -> Array:
        """See `RunningCost`."""
        frames, beyond = self.frames.around(chunk)
        x = np.concatenate([chunk.x, self.after]) if beyond else chunk.x
        found = np.zeros_like(x)
        accumulate(x, self.frames.cut(frames, chunk), found, 0.0)
        self.after[0] = chunk.x[1]
        return found if self.scale == 1.0 else self.scale * found

    def residuals(self, free: Flags) -> Residuals:
        """See `RunningCost`."""
        return DistanceResiduals(self.frames.goal, free, self.scale)

    def squares(self, free: Flags, show: Callable[[Observer], object]) -> tuple[float, int]:
        """See `RunningCost`."""
        observed = movable(self.frames.goal, free)
        cost = SquaredDistances(self.frames.goal._replace(observed=observed), self.scale)
        show(cost.update)
        return cost.value, 3 * int(observed.sum())


class KeptStates:
    """Any comparison: it keeps the states at the times of the frames."""

    def __init__(self, comparison: Comparison) -> None:
        self.comparison, self.frames = comparison, Frames(comparison.goal)
        self.states = np.empty_like(comparison.goal.positions)
        self.bytes, self.residual_bytes = STATE_COPIES * self.states.nbytes, comparison.jacobian_bytes

    @property
    def value(self) -> float:
        """G, once the whole motion has passed."""
        return self.comparison.cost_of(self.states)

    def value_over(self, shorter: Comparison) -> float:
        """See `RunningCost`."""
        return shorter.cost_of(self.states[: len(shorter.goal.step)])

    def update(self, chunk: Rollout) -> None:
        """Take the states of the next chunk of a motion."""
        frames = self.frames.of(chunk)
        self.states[frames] = sample(self.frames.cut(frames, chunk), chunk.x)

    @cached_property
    def by_frame(self) -> Array:
        """∂G/∂s (F, n, 3)."""
        return self.comparison.derivative_of(self.states)

    def derivative(self, chunk: Rollout) -> Array:
        """See `RunningCost`."""
        frames, beyond = self.frames.around(chunk)
        goal = self.frames.cut(frames, chunk)
        states = len(chunk.x) + beyond
        back = interpolation(goal.step, goal.fraction, states).T
        by_frame = self.by_frame[frames]
        found: Array = back @ by_frame.reshape(len(by_frame), chunk.x[0].size)
        return np.ascontiguousarray(found).reshape(states, *chunk.x.shape[1:])

    def residuals(self, free: Flags) -> MatrixResiduals:
        """See `RunningCost`."""
        columns = free_columns(free, self.comparison.last_step)
        by_position = self.comparison.jacobian_of(self.states)[:, columns]
        return MatrixResiduals(by_position, self.comparison.residual_of(self.states), 3 * int(free.sum()))

    def squares(self, free: Flags, show: Callable[[Observer], object]) -> tuple[float, int]:
        """See `RunningCost`."""
        show(self.update)
        residuals = self.residuals(free)
        changing = residuals.r[residuals.last >= 0]
        return float((changing**2).sum()), len(changing)
