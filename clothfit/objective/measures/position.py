"""Positions: each observed vertex should be where the target has it. d = s − s*, m; a group is a vertex in a frame."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from clothfit.base.arrays import Array
from clothfit.engine.system import System
from clothfit.objective.measures.measure import coordinates, matrix
from clothfit.objective.target import Target

if TYPE_CHECKING:
    from scipy.sparse import csr_array


class Position:
    """Differences of the positions; R observed positions, c = 3."""

    linear = True
    reach = 1

    def __init__(self, goal: Target, system: System, name: str) -> None:
        self.observed, self.seen, self._target = goal.observed, goal.seen, goal.positions
        self.groups = int(goal.observed.sum())
        self.weights = goal.weights[goal.observed] if len(goal.weights) else None

    def residual(self, s: Array) -> Array:
        """s − s* (R, 3), m."""
        return np.asarray(s[self.observed] - self._target[self.observed])

    def pullback(self, s: Array, r: Array) -> Array:
        """Jᵀ r (F, n, 3)."""
        out = np.zeros_like(s)
        out[self.observed] = r
        return out

    def jacobian(self, s: Array) -> csr_array:
        """J (3 R, 3 F n)."""
        frame, vertex = np.nonzero(self.observed)
        columns = coordinates(frame, vertex, s.shape[1])
        return matrix(np.arange(columns.size).reshape(columns.shape), columns, np.ones(1), (columns.size, s.size))
