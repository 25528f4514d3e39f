"""The cost of a motion that passes chunk by chunk, its derivative on the way back, and its residuals.

The chunks come in order, each with the state before it and those after its steps (`rollout.Rollout`). A frame belongs
to the chunk after whose steps it is first known. On the way back each state receives the derivatives of the frames
around it in the same order as it would at once, so that chunks change no bit of the result.

Squared distances are summed as the motion passes, and nothing is kept. Every other comparison, which may look at
several frames together, keeps the states at the times of the frames (F, n, 3). Both answer the same questions.

The residuals of a motion that parameters can change, and their derivative, a few steps at a time.

A frame at place (j + φ) has the residuals r = sqrt(w a) ((1 − φ) x_j + φ x_{j+1} − x*) of squared distances, for each
free vertex that it shows (`comparison`). They are formed while the motion passes once more, and used once; nothing is
kept whole. Those of other objectives are linearised with all their frames, as one sparse matrix.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import cached_property
from typing import TYPE_CHECKING, TypeAlias

import numpy as np
from numpy.typing import NDArray

from clothfit.base.arrays import Array, Flags, Indices
from clothfit.derivative.adjoint import Observer
from clothfit.engine.rollout import Rollout
from clothfit.motion.times import interpolation
from clothfit.objective.comparison import Comparison
from clothfit.objective.measures import matrix
from clothfit.objective.target import Frames, Target, accumulate, sample

if TYPE_CHECKING:
    from scipy.sparse import csr_array


def movable(goal: Target, free: Flags) -> Flags:
    """Which positions (F, n) of a target a parameter can change: of the vertices that are `free` (n,), after the start.
    """
    return np.asarray(goal.observed & free & (Frames(goal).needed > 0)[:, None])


class DistanceResiduals:
    """The residuals of `scale` times the squared distances, from the first chunk of a motion to the last."""

    def __init__(self, goal: Target, free: Flags, scale: float) -> None:
        """`free` (n,): which vertices can move."""
        self.goal, self.frames, self.scale, self.steps = goal, Frames(goal), scale, goal.last_step
        self.free, self.place = free, np.cumsum(free) - 1
        self.gaps: dict[int, Array] = {}  # s − x* (n, 3) of the frames that passed and are not in a row yet

    def update(self, chunk: Rollout) -> None:
        """Take the next chunk of the motion."""
        frames = self.frames.of(chunk)
        goal = self.frames.cut(frames, chunk)
        self.gaps.update(enumerate(sample(goal, chunk.x) - goal.positions, start=frames.start))

    def rows(self, sensitivity: Array, first: int, end: int) -> tuple[Array, Array]:
        """J (R, Q) and r (R,) of the residuals that are known after step `end` and not after `first`, once.

        `sensitivity` ((end − first + 1) · 3 f, Q) is the derivative of the free coordinates after steps `first` to
        `end` by Q parameters.
        """
        by_position, r = self.linearised(first, end)
        return by_position @ sensitivity, r

    def linearised(self, first: int, end: int) -> tuple[csr_array, Array]:
        """∂r/∂x (R, (end − first + 1) · 3 f) by the free coordinates after steps `first` to `end`, and r (R,)."""
        begin, stop = np.searchsorted(self.frames.needed, [first, end], side="right")
        shown = self.goal.observed[begin:stop] & self.free
        frame, vertex = np.nonzero(shown)
        gaps = [self.gaps.pop(i)[flags] for i, flags in zip(range(begin, stop), shown, strict=True)]
        weight = self.scale if not len(self.goal.weights) else self.scale * self.goal.weights[begin:stop][shown]
        root = np.sqrt(np.broadcast_to(weight, frame.shape))[:, None]
        count, fraction = int(self.free.sum()), self.goal.fraction[begin:stop][frame][:, None]
        step = self.goal.step[begin:stop][frame].astype(np.int64) - first
        column = 3 * (step * count + self.place[vertex])[:, None] + np.arange(3)
        row = np.arange(column.size).reshape(column.shape)
        shape = (column.size, (end - first + 1) * 3 * count)
        values, places = (1.0 - fraction) * root, [row, column]
        if fraction.any():
            later = fraction[:, 0] > 0
            values = np.concatenate([values, (fraction * root)[later]])
            places = [np.concatenate([row, row[later]]), np.concatenate([column, (column + 3 * count)[later]])]
        r = root * np.concatenate([np.zeros((0, 3)), *gaps])
        return matrix(places[0], places[1], values, shape), r.reshape(-1)


class MatrixResiduals:
    """Residuals r (N,) whose derivative ∂r/∂x (N, T · 3 f) by the free coordinates after every step is a matrix."""

    def __init__(self, by_position: csr_array, r: Array, wide: int) -> None:
        """`wide` is 3 f."""
        self.r, self.columns, self.wide = r, by_position.tocsc(), wide
        self.steps = by_position.shape[1] // max(wide, 1)
        self.last = last_step(by_position, wide)
        self.open, self.block = np.zeros(0, np.int64), np.zeros((0, 1))  # rows begun, and what they have so far

    def update(self, chunk: Rollout) -> None:
        """Nothing: the motion is known."""

    def rows(self, sensitivity: Array, first: int, end: int) -> tuple[Array, Array]:
        """See `DistanceResiduals`."""
        part = self.columns[:, first * self.wide : end * self.wide].tocsr()
        touched = np.union1d(self.open, np.flatnonzero(np.diff(part.indptr)))
        block = part[touched] @ sensitivity[self.wide :]
        block[np.searchsorted(touched, self.open)] += self.block
        done = self.last[touched] < end
        self.open, self.block = touched[~done], block[~done]
        return block if done.all() else block[done], self.r[touched[done]]


Residuals: TypeAlias = DistanceResiduals | MatrixResiduals


def last_step(by_position: csr_array, wide: int) -> Indices:
    """The last step (N,) that each residual depends on; −1 for none."""
    entries = by_position.tocoo()
    last = np.full(by_position.shape[0], -1, np.int32)
    np.maximum.at(last, entries.coords[0], (entries.coords[1] // max(wide, 1)).astype(np.int32))
    return last


def free_columns(free: Flags, steps: int) -> NDArray[np.intp]:
    """Places of the coordinates of the vertices that are `free` (n,), after every step, in x (T + 1, n, 3)."""
    flags = np.repeat(free, 3)
    every = np.arange(1, steps + 1)[:, None] * len(flags) + np.flatnonzero(flags)
    return every.reshape(-1)


NO_DERIVATIVE = np.empty((0, 0, 0))

STATE_COPIES = 6
"""Arrays (F, n, 3) that a cost works with beside the target, where it is not a sum of squared distances."""


def running_cost(comparison: Comparison) -> SquaredDistances | KeptStates:
    """The cost of a comparison, for one motion."""
    scale = comparison.distance_scale
    return KeptStates(comparison) if scale is None else SquaredDistances(comparison.goal, scale)


class SquaredDistances:
    """The cost of one motion of one cloth as `scale` times the sum of squared distances, m²."""

    bytes = residual_bytes = 0  # what it works with beside the target, and what its residuals keep

    def __init__(self, goal: Target, scale: float = 1.0) -> None:
        self.frames, self.scale, self.total = Frames(goal), scale, 0.0
        self.after = np.zeros((1, *goal.positions.shape[1:]))  # the state after the chunk that comes next, going back

    @property
    def value(self) -> float:
        """G of what has passed."""
        return self.scale * self.total

    def value_over(self, shorter: Comparison) -> float:
        """G over the first frames alone, once they have passed and no others; `shorter` compares these."""
        return self.value

    def update(self, chunk: Rollout) -> None:
        """Add the next chunk of a motion."""
        goal = self.frames.cut(self.frames.of(chunk), chunk)
        self.total = float(accumulate(chunk.x, goal, NO_DERIVATIVE, self.total))

    def derivative(self, chunk: Rollout) -> Array:
        """∂G/∂x (at least T + 1, n, 3) at the states of a chunk, from the last chunk to the first; the first entry, of
        the state before the chunk, is not complete.
        """
        frames, beyond = self.frames.around(chunk)
        x = np.concatenate([chunk.x, self.after]) if beyond else chunk.x
        found = np.zeros_like(x)
        accumulate(x, self.frames.cut(frames, chunk), found, 0.0)
        self.after[0] = chunk.x[1]
        return found if self.scale == 1.0 else self.scale * found

    def residuals(self, free: Flags) -> DistanceResiduals:
        """The residuals of the motion that has passed, as it passes again, where the vertices `free` (n,) can move."""
        return DistanceResiduals(self.frames.goal, free, self.scale)

    def squares(self, free: Flags, show: Callable[[Observer], object]) -> tuple[float, int]:
        """Sum of squares and number of these residuals, for the motion that `show` shows to an observer."""
        observed = movable(self.frames.goal, free)
        cost = SquaredDistances(self.frames.goal._replace(observed=observed), self.scale)
        show(cost.update)
        return cost.value, 3 * int(observed.sum())


class KeptStates:
    """The cost by any comparison: it keeps the states at the times of the frames."""

    def __init__(self, comparison: Comparison) -> None:
        self.comparison, self.frames = comparison, Frames(comparison.goal)
        self.states = np.empty_like(comparison.goal.positions)
        self.bytes = STATE_COPIES * self.states.nbytes

    @property
    def residual_bytes(self) -> int:
        """What its residuals keep; a cost of one's own is asked for them."""
        return self.comparison.jacobian_bytes

    @property
    def value(self) -> float:
        """G, once the whole motion has passed."""
        return self.comparison.cost_of(self.states)

    def value_over(self, shorter: Comparison) -> float:
        """See `SquaredDistances`."""
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
        """See `SquaredDistances`."""
        frames, beyond = self.frames.around(chunk)
        goal = self.frames.cut(frames, chunk)
        states = len(chunk.x) + beyond
        back = interpolation(goal.step, goal.fraction, states).T
        by_frame = self.by_frame[frames]
        found: Array = back @ by_frame.reshape(len(by_frame), chunk.x[0].size)
        return np.ascontiguousarray(found).reshape(states, *chunk.x.shape[1:])

    def residuals(self, free: Flags) -> MatrixResiduals:
        """See `SquaredDistances`."""
        columns = free_columns(free, self.comparison.last_step)
        by_position = self.comparison.jacobian_of(self.states)[:, columns]
        return MatrixResiduals(by_position, self.comparison.residual_of(self.states), 3 * int(free.sum()))

    def squares(self, free: Flags, show: Callable[[Observer], object]) -> tuple[float, int]:
        """See `SquaredDistances`."""
        show(self.update)
        residuals = self.residuals(free)
        changing = residuals.r[residuals.last >= 0]
        return float((changing**2).sum()), len(changing)
