"""Residuals of squared distances, and their derivative, told while a motion passes: nothing of them is kept whole.

A frame at place (j + φ) has the residuals r = sqrt(w a) ((1 − φ) x_j + φ x_{j+1} − x*) for each free vertex that it
shows (`cost`). They are known when the motion has passed, and used once.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from clothfit.base.arrays import Array, Flags
from clothfit.engine.rollout import Rollout
from clothfit.objective.measures.measure import matrix
from clothfit.objective.running_cost import Frames
from clothfit.objective.target import Target, sample

if TYPE_CHECKING:
    from scipy.sparse import csr_array


class Passing:
    """The residuals of `scale` times the squared distances that a parameter can change."""

    def __init__(self, goal: Target, free: Flags, scale: float) -> None:
        """`free` (n,): which vertices can move."""
        self.goal, self.frames, self.scale, self.steps = goal, Frames(goal), scale, goal.last_step
        self.free, self.place = free, np.cumsum(free) - 1
        self.gaps: dict[int, Array] = {}  # s − x* (n, 3) of the frames that passed and were not asked for

    @property
    def movable(self) -> Flags:
        """Which positions (F, n) a parameter can change: of free vertices, after the start."""
        return np.asarray(self.goal.observed & self.free & (self.frames.needed > 0)[:, None])

    def see(self, part: Rollout) -> None:
        """Look at the next part of a motion."""
        frames = self.frames.of(part)
        goal = self.frames.cut(frames, part)
        self.gaps.update(enumerate(sample(goal, part.x) - goal.positions, start=frames.start))

    def rows(self, first: int, end: int) -> tuple[csr_array, Array]:
        """∂r/∂x (R, (end − first + 1) · 3 f) by the free coordinates after steps `first` to `end`, and r (R,), of the
        frames that can be told after the steps between; once.
        """
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
