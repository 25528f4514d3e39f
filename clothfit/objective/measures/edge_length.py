"""Lengths of springs: each should be as long as in the target, wherever the cloth is and however it is rotated.

d = |s_a − s_b| − |s*_a − s*_b|, m, for each spring both of whose ends are observed; a group is a spring in a frame.
With e = s_a − s_b the derivative is e/|e| at a and −e/|e| at b; 0 where the length is 0.
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


class EdgeLength:
    """Differences of lengths; R springs in frames, c = 1."""

    linear = False
    reach = 2

    def __init__(self, goal: Target, system: System, name: str) -> None:
        ends = np.asarray(system.springs.ends)
        self.frame, spring = np.nonzero(goal.observed[:, ends].all(axis=2))
        self.groups = len(self.frame)
        self.a, self.b = ends[spring].T
        self.goal = self._lengths(goal.positions)
        self.seen = marked(ends[spring[goal.places[self.frame] > 0]], goal.observed.shape[1])
        first, second = (self.frame, self.a), (self.frame, self.b)
        self.weights = both(goal.weights[first], goal.weights[second]) if len(goal.weights) else None

    def _edges(self, s: Array) -> Array:
        return np.asarray(s[self.frame, self.a] - s[self.frame, self.b])

    def _lengths(self, s: Array) -> Array:
        return np.asarray(np.linalg.norm(self._edges(s), axis=1, keepdims=True))

    def _directions(self, s: Array) -> Array:
        edges = self._edges(s)
        lengths = np.linalg.norm(edges, axis=1, keepdims=True)
        return edges / np.where(lengths > 0, lengths, 1.0)

    def residual(self, s: Array) -> Array:
        """Difference of the lengths (R, 1), m."""
        return self._lengths(s) - self.goal

    def pullback(self, s: Array, r: Array) -> Array:
        """Jᵀ r (F, n, 3)."""
        out, pull = np.zeros_like(s), r * self._directions(s)
        np.add.at(out, (self.frame, self.a), pull)
        np.add.at(out, (self.frame, self.b), -pull)
        return out

    def jacobian(self, s: Array) -> csr_array:
        """J (R, 3 F n)."""
        d = self._directions(s)
        columns = np.stack([coordinates(self.frame, end, s.shape[1]) for end in (self.a, self.b)])
        return matrix(np.arange(len(d))[:, None], columns, np.stack([d, -d]), (len(d), s.size))
