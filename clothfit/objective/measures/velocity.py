"""Velocities: from frame to frame, each vertex should move as the target does, wherever it is.

d = ((s_{f+1} − s_f) − (s*_{f+1} − s*_f)) / (t_{f+1} − t_f), m/s, where both frames are observed; a group is a vertex
between two successive frames. A constant offset of the whole target changes nothing.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from clothfit.base.arrays import Array
from clothfit.engine.system import System
from clothfit.objective.measures.measure import both, coordinates, marked, matrix
from clothfit.objective.target import Target

if TYPE_CHECKING:
    from scipy.sparse import csr_array


class Velocity:
    """Differences of mean velocities; R pairs of observed positions, c = 3."""

    linear = True
    reach = 2

    def __init__(self, goal: Target, system: System, name: str) -> None:
        gaps = system.h * np.diff(goal.places)  # 0 where two frames count as one step
        self.frame, self.vertex = np.nonzero(goal.observed[1:] & goal.observed[:-1] & (gaps > 0)[:, None])
        self.groups = len(self.frame)
        self.rate = 1.0 / gaps[self.frame][:, None]
        self.goal = self._velocity(goal.positions)
        self.seen = marked(self.vertex, goal.observed.shape[1])
        first, second = ((self.frame + k, self.vertex) for k in (0, 1))
        self.weights = both(goal.weights[first], goal.weights[second]) if len(goal.weights) else None

    def _velocity(self, s: Array) -> Array:
        return np.asarray(self.rate * (s[self.frame + 1, self.vertex] - s[self.frame, self.vertex]))

    def residual(self, s: Array) -> Array:
        """Difference of the velocities (R, 3), m/s."""
        return self._velocity(s) - self.goal

    def pullback(self, s: Array, r: Array) -> Array:
        """Jᵀ r (F, n, 3)."""
        out = np.zeros_like(s)
        out[self.frame + 1, self.vertex] += self.rate * r
        out[self.frame, self.vertex] -= self.rate * r
        return out

    def jacobian(self, s: Array) -> csr_array:
        """J (3 R, 3 F n)."""
        before, after = (coordinates(self.frame + k, self.vertex, s.shape[1]) for k in (0, 1))
        rows = np.arange(before.size).reshape(before.shape)
        rate = np.broadcast_to(self.rate, before.shape)
        return matrix(
            np.stack([rows, rows]), np.stack([before, after]), np.stack([-rate, rate]), (before.size, s.size)
        )
