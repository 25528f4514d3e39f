"""Factors on the values that a cloth has: what modes F, R and M fit in place of the values themselves.

    value_i = base_i Π_k p_k^{B_ik},    p_k > 0, 1 at the values of the scene itself

F: one factor for all values, B = 1. R: one for each group of values, B says which group a value is in. M: a smooth
map for each group, whose first mode is constant: the factor k says by how much the values change where mode k is 1. So
a map can be all that the factors of groups can be, and these all that one factor can be. A value of 0 stays 0.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from clothfit.base.arrays import Array, Flags, Indices

FACTOR_MODES = "FRM"

MAP_VALUES, LEAST_MODES = 96, 4
"""Values of all maps of one kind of a cloth, about; modes of each map at least, where its group has as many values."""

DEPENDENT = 1e-6
"""Size of what a mode adds to those before it within its group, relative to that of the constant one, below which it is
left out.
"""

LARGEST_LOG = 600.0
"""Logarithm beyond which a product of factors grows no more: times 0 it is still 0, and every value is at its end."""


@dataclass(frozen=True, eq=False)
class Factors:
    """Factors on E values: B in its N entries, those of a value together and in order; its limits are those of maps."""

    base: Array  # (E,) the values where all factors are 1
    row: Indices  # (N,) the value of each entry, from 0 to E − 1
    column: Indices  # (N,) its factor
    exponent: Array | None  # (N,) B; None: 1, and one entry for each value, so that the values are linear in p
    names: tuple[str, ...]  # of the groups
    modes: tuple[int, ...]  # factors of each group
    ends: tuple[float, float] = (0.0, np.inf)  # that no value passes, nor its base where that is beyond them

    @property
    def count(self) -> int:
        """K."""
        return sum(self.modes)

    @cached_property
    def constant(self) -> Flags:
        """Which factors (K,) act on all values of their group alike."""
        first = np.zeros(self.count, bool)
        first[np.cumsum((0, *self.modes[:-1]))] = True
        return first

    @cached_property
    def weights(self) -> Array:
        """Σ B² (K,) over the values that are not 0: their change in logarithms by one of the factor's, squared."""
        squares = np.ones(len(self.row)) if self.exponent is None else self.exponent**2
        return np.maximum(self._sum(squares * (self.base[self.row] > 0)), np.finfo(float).tiny)

    @cached_property
    def level(self) -> float:
        """Geometric mean of the values that are not 0; 1 where there is none."""
        return geometric_mean(self.base)

    def values(self, p: Array) -> Array:
        """The values (E,) at p (K,)."""
        if self.exponent is None:
            return np.asarray(self.base * p[self.column])
        return np.clip(self._beyond(p), self._low, self._high)

    def change(self, p: Array, direction: Array) -> Array:
        """Change of the values (E,) at p (K,) along `direction` (K,)."""
        if self.exponent is None:
            return np.asarray(self.base * direction[self.column])
        entries = self.entries(p) * direction[self.column]
        return np.asarray(np.bincount(self.row, weights=entries, minlength=len(self.base)), float)

    def gradient(self, p: Array, by_value: Array) -> Array:
        """Gradient (K,) by the factors at p (K,) from the gradient by the values (E,)."""
        return self._sum(by_value[self.row] * self.entries(p))

    def entries(self, p: Array) -> Array:
        """∂value/∂p (N,) of each entry at p (K,); 0 where a value is at its end."""
        if self.exponent is None:
            return self.base
        values = self._beyond(p)
        inside = np.where((values >= self._low) & (values <= self._high), values, 0.0)
        return np.asarray(inside[self.row] * self.exponent / p[self.column])

    def nearest(self, values: Array) -> Array:
        """The factors (K,) that come nearest to the values (E,) in logarithms; 1 where none of a group is known."""
        known = (values > 0) & (self.base > 0)
        if np.array_equal(values, self.base) or not known.any():
            return np.ones(self.count)
        ratio = np.log(np.where(known, values, 1.0) / np.where(known, self.base, 1.0))
        if self.exponent is None:
            number = self._sum(known.astype(float))
            return np.exp(self._sum(np.where(known, ratio, 0.0)) / np.maximum(number, 1.0))
        B = self.dense()[known]
        return np.asarray(np.exp(np.linalg.lstsq(B, ratio[known], rcond=None)[0]))

    def acting(self, shown: Flags) -> Flags:
        """Which factors (K,) act on a value that is `shown` (E,) and not 0."""
        entries = np.ones(len(self.row)) if self.exponent is None else self.exponent
        return self._sum((entries != 0) & (shown & (self.base > 0))[self.row]) > 0

    def at_level(self, number: float) -> Array:
        """The factors (K,) of values in their own proportions whose geometric mean is `number`."""
        return np.where(self.constant, number / self.level, 1.0)

    def bounds(self, low: float, high: float) -> tuple[Array, Array]:
        """Bounds (K,) of the factors from those of the values, positive. The constant factors of F and R, and of a map
        alone, keep all values of their group within them; where these span more, the first and the last value of
        the group come to a bound at the bounds of the factor. Other modes reach from one end to the other.
        """
        lower, upper = np.full(self.count, low / high), np.full(self.count, high / low)
        group = (np.cumsum(self.constant) - 1)[self.column]
        least, most = np.full(len(self.modes), np.inf), np.zeros(len(self.modes))
        positive = self.base[self.row] > 0
        np.minimum.at(least, group[positive], self.base[self.row][positive])
        np.maximum.at(most, group[positive], self.base[self.row][positive])
        some = most > 0
        ends = np.sort([low / np.where(some, least, 1.0), high / np.where(some, most, 1.0)], axis=0)
        lower[self.constant], upper[self.constant] = np.where(some, ends[0], low), np.where(some, ends[1], high)
        return lower, upper

    def dense(self) -> Array:
        """B (E, K)."""
        B = np.zeros((len(self.base), self.count))
        B[self.row, self.column] = 1.0 if self.exponent is None else self.exponent
        return B

    def _sum(self, entries: Array) -> Array:
        """Sums (K,) of entries (N,) by factor."""
        return np.asarray(np.bincount(self.column, weights=entries, minlength=self.count), float)

    def _beyond(self, p: Array) -> Array:
        """The values (E,) at p (K,), of a map, without their ends."""
        logs = np.log(p)[self.column] * self.exponent
        log = np.bincount(self.row, weights=logs, minlength=len(self.base))
        return np.asarray(self.base * np.exp(np.minimum(log, LARGEST_LOG)))

    @cached_property
    def _low(self) -> Array:
        return np.minimum(self.base, self.ends[0])

    @cached_property
    def _high(self) -> Array:
        return np.maximum(self.base, self.ends[1])


def geometric_mean(values: Array) -> float:
    """Geometric mean of the positive ones among values; 1 where there is none."""
    known = values[values > 0]
    return float(np.exp(np.log(known).mean())) if len(known) else 1.0


def one_factor(base: Array) -> Factors:
    """Mode F: one factor for all values."""
    return factors_of(base, np.zeros(len(base), np.int32), ("all",))


def factors_of(base: Array, group: Indices, names: Sequence[str]) -> Factors:
    """Mode R: one factor for each group; `group` (E,) is that of each value."""
    return Factors(base, np.arange(len(base), dtype=np.int32), group, None, tuple(names), (1,) * len(names))


def modes_of_each(sizes: Sequence[int]) -> list[int]:
    """How many modes the map of each group has at most, for groups of so many values."""
    share = max(LEAST_MODES, MAP_VALUES // max(len(sizes), 1))
    return [min(size, share) for size in sizes]


def smooth_maps(
    base: Array, group: Indices, names: Sequence[str], modes: Array, ends: tuple[float, float]
) -> Factors:
    """Mode M: the modes (E, ·), of which the first is constant, within each group."""
    sizes = np.bincount(group, minlength=len(names)).tolist()
    rows, columns, exponents = [], [], []
    numbers: list[int] = []
    for i, most in enumerate(modes_of_each(sizes)):
        own = np.flatnonzero(group == i)
        B = independent(modes[own, :most])
        rows.append(np.repeat(own, B.shape[1]))
        columns.append(sum(numbers) + np.tile(np.arange(B.shape[1]), len(own)))
        exponents.append(B.reshape(-1))
        numbers.append(B.shape[1])
    row, column = np.concatenate(rows).astype(np.int32), np.concatenate(columns).astype(np.int32)
    order = np.argsort(row, kind="stable")
    exponent: Array = np.concatenate(exponents)[order]
    return Factors(base, row[order], column[order], exponent, tuple(names), tuple(numbers), ends)


def independent(modes: Array) -> Array:
    """The columns (E, ·) of modes that those before them do not already give."""
    added = np.abs(np.diag(np.linalg.qr(modes, mode="r")))
    some: Array = modes[:, : len(added)]
    return some[:, added > DEPENDENT * np.sqrt(len(modes))]
