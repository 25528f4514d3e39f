"""A fit of many values by few: one factor for all masses, stiffnesses or rest lengths of a cloth.

The values of a kind keep their proportions, y = y₀ + z / √n in their logarithms, for n values with the coordinate z in
common. So few unknowns have a dense model, however large the cloth is, which a fit of each value has not. Other values
that are fitted one by one, velocities, stay as they are.
"""

from __future__ import annotations

import numpy as np

from clothfit.base.arrays import Array, Indices
from clothfit.derivative.columns import LOCAL
from clothfit.objective.objective import Objective
from clothfit.optimise.search import Search
from clothfit.optimise.trajectory import Trajectory


class Shared(Trajectory):
    """An objective in the coordinates z (B,) of factors."""

    def __init__(self, search: Search, objective: Objective, start: Array) -> None:
        """`start` (Q,): where all factors are 1."""
        super().__init__(search, objective)
        self.start = start
        self.group, self.share = self._groups()  # (Q,): the coordinate that moves each, −1 for none, and how much

    def _groups(self) -> tuple[Indices, Array]:
        group, share, count = np.full(len(self.start), -1), np.zeros(len(self.start)), 0
        place = np.cumsum(self.fitted) - 1
        for block in self.objective.blocks:
            own = place[np.flatnonzero(self.fitted[block.part]) + block.start]
            together = block.mode == "L" and block.name in LOCAL
            if not len(own) or (block.mode == "L" and not together):
                continue
            group[own] = count + (0 if together else np.arange(len(own)))
            share[own] = 1.0 / np.sqrt(len(own)) if together else 1.0
            count = int(group.max()) + 1
        return group, share

    @property
    def size(self) -> int:
        """B."""
        return int(self.group.max(initial=-1)) + 1

    @property
    def bounds(self) -> tuple[Array, Array]:
        """Ends (B,) of the coordinates: where the last value of a group comes to its own bound."""
        moved = self.group >= 0
        lower, upper = np.zeros(self.size), np.zeros(self.size)
        for end, out, choose in zip(super().bounds, (lower, upper), (np.minimum, np.maximum), strict=True):
            choose.at(out, self.group[moved], ((end - self.start)[moved]) / self.share[moved])
        return lower, upper

    def all(self, z: Array) -> Array:
        """The coordinates (Q,) of all values at z (B,)."""
        return np.where(self.group >= 0, self.start + self.share * np.append(z, 0.0)[self.group], self.start)

    def parameters(self, z: Array) -> Array:
        """Parameters (P,) at z (B,)."""
        return self.search.parameters(self.all(z))

    def columns(self, p: Array) -> tuple[Indices, Array]:
        """Which coordinate moves each parameter (P,), −1 for none, and how much at p (P,)."""
        column, factor = np.full(len(p), -1), np.zeros(len(p))
        column[self.fitted] = self.group
        factor[self.fitted] = self.search.coordinates.derivative(p)[self.fitted] * self.share
        return column, factor
