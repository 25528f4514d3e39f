"""Covariances where the model differs: from residuals as they are, correlated over many frames and many vertices.

A wrong model has no true value, so an interval is for the value that other frames would give. How far that may be is
seen from what the fit would be without each of B blocks of successive frames. With r + J d near the result, and of each
block H_b = JᵀJ and the score g_b = Jᵀr less the mean of all, leaving it out changes the values by

    d_b = (H + A − H_b)⁻¹ g_b,    C = 2 (B − 1) / B Σ_b d_b d_bᵀ + σ² K A K,    K = (H + A)⁻¹

the delete-a-block jackknife (CR3 of A. C. Cameron, D. L. Miller, A practitioner's guide to cluster-robust inference,
J. Human Resources 50, 2015); the 2, as other frames give another value, as uncertain as this one. A is the prior's
matrix, 0 without one. In place of K g_b, as in a sandwich of White, d_b does not forget that a block which says most of
a value has drawn it to itself. What a wrong model leaves in one part of a motion says little of another: the blocks are
as few and as long as can be, and Student's t has B − 1 degrees of freedom.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from clothfit.base.arrays import Array, Indices
from clothfit.optimise.normal_equations import Scores

BLOCKS, SHORTEST_BLOCK = 3, 4
"""Blocks of all motions together, at least, below which nothing is said; and frames of one."""

OTHER_FRAMES = 2.0
"""Factor of the variance: other frames would give another value, as uncertain as this one."""

MOST_VALUES = 24
"""Values up to which so few blocks say something of each."""

CHAOS = 1e4
"""Growth of a sensitivity, from a quarter of a motion to its largest, above which no more is seen of it than that. A
motion that accelerates evenly has 16.
"""


class Blocks(NamedTuple):
    """What blocks of frames say."""

    information: Array  # H_b (B, Q, Q)
    scores: Array  # g_b (B, Q)

    @property
    def freedom(self) -> int:
        """Degrees of freedom."""
        return len(self.scores) - 1

    def covariance(self, own: NDArray[np.intp], K: Array) -> Array:
        """2 (B − 1) / B Σ_b d_b d_bᵀ (F, F) of the values `own` (F,), all others as they are, with their K (F, F); not
        finite where all that is known of them is from one block.
        """
        H, one = self.information[:, own[:, None], own], np.eye(len(own))
        try:
            changes = np.linalg.solve(one - K @ H, (self.scores[:, own] @ K)[..., None])[..., 0]
        except np.linalg.LinAlgError:
            return np.full((len(own), len(own)), np.inf)
        return np.asarray(OTHER_FRAMES * self.freedom / len(changes) * (changes.T @ changes))


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
        H, g = list[Array](), list[Array]()
        wanted = -(-BLOCKS // max(len(self.runs), 1))  # of each run
        for own, scores in self.runs if self.count <= MOST_VALUES else ():
            count = min(wanted, len(scores.parts) // SHORTEST_BLOCK)
            for part in np.array_split(np.arange(len(scores.parts)), count) if count else ():
                information, score = np.zeros((self.count, self.count)), np.zeros(self.count)
                information[np.ix_(own, own)] = sum(scores.information[t] for t in part)
                score[own] = sum(scores.parts[t] for t in part)
                H.append(information * np.outer(scale, scale))
                g.append(score * scale)
        if len(g) < BLOCKS:
            return None
        return Blocks(np.array(H), np.array(g) - np.mean(g, axis=0))
