"""Covariances where the model differs: from residuals as they are, correlated over many frames and many vertices.

With r + J d near the result, H = JᵀJ and the scores g_b = Σ Jᵀr of B blocks of successive frames,

    C = K S K,    S = 2 B / (B − 1) Σ_b (g_b − ḡ)(g_b − ḡ)ᵀ + σ² A,    K = (H + A)⁻¹

twice the sandwich of White and of Newey and West with blocks in place of single residuals (A. C. Cameron, D. L. Miller,
A practitioner's guide to cluster-robust inference, J. Human Resources 50, 2015); A is the prior's matrix, 0 without
one. A wrong model has no true value, so an interval is for the value that other frames of the same length would give:
that explains the 2. Few blocks are little to go by: Student's t has B − 1 degrees of freedom.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from clothfit.base.arrays import Array, Indices
from clothfit.optimise.normal_equations import Scores

BLOCKS, SHORTEST_BLOCK = 4, 4
"""Blocks of each motion, and steps of one at least; with more, shorter ones, their scores are not independent."""

FEWEST_BLOCKS = 3
"""Blocks of all motions together below which nothing is said."""

OTHER_FRAMES = 2.0
"""Factor of the variance: other frames would give another value, as uncertain as this one."""

MOST_VALUES = 24
"""Values up to which so few blocks say something of each."""

CHAOS = 1e4
"""Growth of a sensitivity, from a quarter of a motion to its largest, above which no more is seen of it than that. A
motion that accelerates evenly has 16.
"""


class Blocks(NamedTuple):
    """The scores of blocks of frames."""

    scores: Array  # (B, Q), less their mean

    @property
    def freedom(self) -> int:
        """Degrees of freedom."""
        return len(self.scores) - 1

    def covariance(self) -> Array:
        """2 B / (B − 1) Σ_b (g_b − ḡ)(g_b − ḡ)ᵀ (Q, Q)."""
        factor = OTHER_FRAMES * len(self.scores) / max(self.freedom, 1)
        return np.asarray(factor * (self.scores.T @ self.scores))


class Kept:
    """The scores of all runs of a model."""

    def __init__(self, count: int) -> None:
        """`count`: of coordinates, Q."""
        self.count = count
        self.runs: list[tuple[Indices, Scores]] = []

    def keep(self, own: Indices) -> Scores:
        """What takes the scores of the next run, which depends on the coordinates `own`."""
        self.runs.append((own, Scores(by_step=self.count <= MOST_VALUES)))
        return self.runs[-1][1]

    @property
    def growth(self) -> float:
        """How much the sensitivity of a run grows at most, from a quarter of its steps to where it is largest."""
        sizes = [np.array(scores.sizes) for _, scores in self.runs]
        early = [(float(each[len(each) // 4]), float(each.max())) for each in sizes if len(each)]
        return max((largest / first for first, largest in early if first > 0), default=1.0)

    def blocks(self, scale: Array) -> Blocks | None:
        """The blocks of all runs in z, with ∂y/∂z = `scale` (Q,); None where there are too few, or too many values."""
        found = []
        for own, scores in self.runs if self.count <= MOST_VALUES else ():
            parts = np.array(scores.parts).reshape(-1, len(own))
            count = min(BLOCKS, len(parts) // SHORTEST_BLOCK)
            for part in np.array_split(parts, count) if count else ():
                whole = np.zeros(self.count)
                whole[own] = part.sum(axis=0)
                found.append(whole * scale)
        if len(found) < FEWEST_BLOCKS:
            return None
        each = np.array(found)
        return Blocks(each - each.mean(axis=0))
