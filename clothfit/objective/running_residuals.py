"""The residuals of a motion that parameters can change, and their derivative, a few steps at a time.

A frame at place (j + φ) has the residuals r = sqrt(w a) ((1 − φ) x_j + φ x_{j+1} − x*) of squared distances, for each
free vertex that it shows (`comparison`). They are formed while the motion passes once more, and used once; nothing is
kept whole. Those of other objectives are linearised with all their frames, as one sparse matrix.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Protocol

import numpy as np
from numpy.typing import NDArray

from clothfit.base.arrays import Array, Flags, Indices
from clothfit.engine.rollout import Rollout
from clothfit.objective.measures.measure import matrix
from clothfit.objective.target import Frames, Target, sample

if TYPE_CHECKING:
    from scipy.sparse import csr_array


class Residuals(Protocol):
    """The residuals of a motion of T steps, from its first chunk to the last."""

    steps: int  # T

    def update(self, chunk: Rollout) -> None:
        """Take the next chunk of the motion."""

    def rows(self, sensitivity: Array, first: int, end: int) -> tuple[Array, Array]:
        """J (R, Q) and r (R,) of the residuals that are known after step `end` and not after `first`, once.

        `sensitivity` ((end − first + 1) · 3 f, Q) is the derivative of the free coordinates after steps `first` to
        `end` by Q parameters.
        """


def movable(goal: Target, free: Flags) -> Flags:
    """Which positions (F, n) of a target a parameter can change: of the vertices that are `free` (n,), after the start.
    """
    return np.asarray(goal.observed & free & (Frames(goal).needed > 0)[:, None])


class DistanceResiduals:
    """The residuals of `scale` times the squared distances."""

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
        """See `Residuals`."""
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
        """See `Residuals`."""
        part = self.columns[:, first * self.wide : end * self.wide].tocsr()
        touched = np.union1d(self.open, np.flatnonzero(np.diff(part.indptr)))
        block = part[touched] @ sensitivity[self.wide :]
        block[np.searchsorted(touched, self.open)] += self.block
        done = self.last[touched] < end
        self.open, self.block = touched[~done], block[~done]
        return block if done.all() else block[done], self.r[touched[done]]


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
