"""Values that many springs or vertices share: the simplest ones that a motion of the model itself is as near to.

Values one by one carry the rounding of their target, or of the solver: of a few parts in ten thousand, which a cloth
that buckles makes millimetres of. Most fabrics have few different values, often written with few digits. So values are
rounded to one digit, to two, …; those that many share once they are rounded are taken for one value, and others for
the nearest of these. The balances that have given the values say how near any others are to them (`fewest`): a value
that hardly shows by itself goes where it fits beside its neighbours, and groups that tell no more apart than scatter
are one. Values may also be alike in number of where they began, as masses go with the area round a vertex. Then common
values are rounded, too. What moves the first frames no farther from the target than what rounding leaves is tried on
all of them. Where no short numbers reproduce these, Gauss–Newton by the common values alone goes on over longer and
longer windows. As any point of a search, none is kept that is no nearer.
"""

from __future__ import annotations

import contextlib
import itertools
from collections.abc import Iterator
from typing import TYPE_CHECKING

import numpy as np

from clothfit.base.arrays import Array, Flags
from clothfit.fit import continuation
from clothfit.fit.options import RMSE_TOLERANCE
from clothfit.fit.trajectory_fit import first_window, window_lengths
from clothfit.motion.degrade import digits
from clothfit.motion.divergence import Diverged
from clothfit.objective.objective import Objective
from clothfit.optimise.gauss_newton import Patience
from clothfit.optimise.momentum import Momentum
from clothfit.optimise.search import Search
from clothfit.optimise.trajectory import Trajectory
from clothfit.scene.directions import Slots
from clothfit.scene.kinds import LETTERED

if TYPE_CHECKING:
    from scipy.sparse import csr_array

FEWEST, SHARE = 8, 0.01
"""Values that share one, at least, and their share of all."""

COVERED = 0.6
"""Share of all values, at least, that have a value in common with others."""

MOST_DIGITS = 9
"""Of single precision, in which the editor writes."""

ROUNDED = 0.6
"""Error of what is rounded, relative to the largest that rounding leaves: √⅓ in the mean."""

GROWTH, STEPS, SAVING, PATIENCE = 1.5, 6, 1e-3, Patience(1, 1e-3, 1e-3)
"""Of the windows of Gauss–Newton: the ratio of one to the one before, iterations in each, and what ends it."""

RELATIVE_ROUNDING = 1e-12
"""What a change of a value must at least gain, relative to what the value itself makes of the balances."""


def simplify(search: Search, p: Array, balances: Momentum) -> bool:
    """Try the simplest values near p (P,), which these balances have given; whether some of them reproduce the target
    to its rounding. Raises Stop.
    """
    whole = search.objective
    window, tried = whole.until(first_window(whole), whole.tolerance), np.zeros(len(p))
    try:
        for labels, unit in of_groups(search, p):
            values, labels = fewer(search, balances, p, labels, unit)
            if np.allclose(values, tried, rtol=RELATIVE_ROUNDING, atol=0.0):
                continue
            tried = values
            if by_short_numbers(search, window, values, labels, unit):
                return True
            if (found := by_groups(search, values, labels, unit)) is not None:
                return found
        return False
    finally:
        search.own |= whole.rmse(search.best.cost) <= limit(whole)


def limit(objective: Objective) -> float:
    """Error of a motion, m, that is rounding."""
    return max(RMSE_TOLERANCE, ROUNDED * objective.rounding)


def by_short_numbers(search: Search, window: Objective, values: Array, labels: Slots, unit: Array) -> bool:
    """Visit the values (P,) of groups, in their unit (P,) with as few digits as a window allows; whether they reproduce
    all frames.
    """
    before = values
    for count in range(1, MOST_DIGITS + 1):
        short = np.where(labels >= 0, digits(count, values / unit)[0] * unit, values)
        if not np.array_equal(short, before) and window.rmse(search.measure(short, window)) <= limit(window):
            return search.objective.rmse(search.visit(short)) <= limit(window)
        before = short
    return False


def of_groups(search: Search, p: Array) -> Iterator[tuple[Slots, Array]]:
    """The group of each of p (P,), −1 of those that have none, first few groups, then more; and the unit (P,) of which
    they are alike in number: 1, or where it began, as a mass goes with the area round its vertex.
    """
    units = np.ones((2, len(p)))
    for block in search.objective.blocks:
        if block.name in LETTERED and block.mode == "L" and np.ptp(search.start[block.part]) > 0.0:
            units[1, block.part] = np.where(search.start[block.part] > 0.0, search.start[block.part], 1.0)
    for count, unit in itertools.product(range(1, MOST_DIGITS + 1), units[: 1 + bool((units[1] != 1.0).any())]):
        labels = np.full(len(p), -1)
        for block in search.objective.blocks:
            if block.name in LETTERED and block.mode == "L":
                known = np.arange(len(p))[block.part]
                known = known[search.fitted[known] & (p[known] != search.start[known]) & (p[known] > 0)]
                labels[known] = grouped((p / unit)[known], count, labels.max() + 1)
        if labels.max() >= 0:
            yield labels, unit


def fewer(search: Search, balances: Momentum, p: Array, labels: Slots, unit: Array) -> tuple[Array, Slots]:
    """p (P,) with common values for groups, in their `unit` (P,), and the group of each (P,), −1 of those that have
    none, from `labels` (P,) on, as `fewest` of the values of each cloth has them.
    """
    labels, values = labels.copy(), p.copy()
    block = np.repeat(np.arange(len(search.objective.blocks)), [each.count for each in search.objective.blocks])
    for places, H in balances.normals.values():
        known = labels[places] >= 0
        own, first = places[known], labels.max() + 1
        H = H[known][:, known].multiply(unit[own]).multiply(unit[own, None]).tocsr()
        values[own], of = fewest(H, p[own] / unit[own], labels[own], block[own])
        values[own] *= unit[own]
        labels[own] = first + of
    return values, labels


def fewest(H: csr_array, p: Array, of: Slots, block: Slots) -> tuple[Array, Slots]:
    """The values (P,) and groups (P,), from groups `of` (P,) on, where (x - p)ᵀ H (x - p) of values x that each group
    shares is least by the choice of these, and no less by another group of its block for one of p (P,). Groups become
    one where that no more than doubles it: they scatter no farther than values of each do.
    """
    rounding = RELATIVE_ROUNDING * (p @ (H @ p))
    while len(p):
        _, first, of = np.unique(of, return_index=True, return_inverse=True)
        of = rearranged(H, p, of, balanced(H, p, of)[0], block[:, None] == block[first])
        _, first, of = np.unique(of, return_index=True, return_inverse=True)
        c, inverse, left = balanced(H, p, of)
        inverse = inverse / np.outer(c, c)  # of logarithms: what scales all values may hardly show
        size, log, home = np.diag(inverse), np.log(c), block[first]
        apart = (home[:, None] != home) | np.eye(len(c), dtype=bool)
        rise = (log[:, None] - log) ** 2 / np.where(apart, 1.0, size[:, None] + size - 2.0 * inverse)
        i, j = divmod(int(np.where(apart, np.inf, rise).argmin()), len(c))
        if apart[i, j] or rise[i, j] > left + rounding:
            return c[of], of
        of = np.where(of == j, i, of)
    return p, of


def balanced(H: csr_array, p: Array, of: Slots) -> tuple[Array, Array, float]:
    """The values (K,) of the groups `of` (P,), between the least and the largest of each, where (x - p)ᵀ H (x - p) is
    least, half of the inverse of its second derivative by them (K, K), and what is left.
    """
    from scipy.sparse import csr_array

    E = csr_array((np.ones(len(p)), (np.arange(len(p)), of)))
    x = (E.T @ p) / E.sum(axis=0)
    inverse = np.linalg.pinv((E.T @ (H @ E)).toarray(), hermitian=True)
    x = x + inverse @ (E.T @ (H @ (p - E @ x)))
    least, most = np.full(len(x), np.inf), np.full(len(x), -np.inf)
    np.minimum.at(least, of, p)
    np.maximum.at(most, of, p)
    x = np.clip(x, least, most)
    away = E @ x - p
    return x, inverse, float(away @ (H @ away))


def rearranged(H: csr_array, p: Array, chosen: Slots, centres: Array, may: Flags) -> Slots:
    """Which of the centres (K,) each of p (P,) has, of those that it `may` have (P, K), where (x - p)ᵀ H (x - p) of the
    centres x (P,) becomes no less by another for one of them: from those `chosen` (P,), and of neighbours the one that
    gains most changes first. Iterated conditional modes: J. Besag, On the statistical analysis of dirty pictures,
    Journal of the Royal Statistical Society B 48, 1986.
    """
    size, each = H.diagonal(), np.arange(len(p))
    row = np.repeat(each, np.diff(H.indptr))
    while True:
        x = centres[chosen]
        step = centres - x[:, None]
        saved = -step * (2.0 * (H @ (x - p))[:, None] + size[:, None] * step)
        saved = np.where(may & (saved > RELATIVE_ROUNDING * size[:, None] * centres**2), saved, 0.0)
        most, order, before = saved.max(axis=1), np.zeros(len(p), int), np.full(len(p), -1)
        order[np.argsort(most)] = each
        np.maximum.at(before, row, np.where(H.indices == row, -1, order[H.indices]))
        changed = (most > 0) & (order > before)
        if not changed.any():
            return chosen
        chosen = np.where(changed, saved.argmax(axis=1), chosen)


def grouped(values: Array, count: int, first: int) -> Slots:
    """The groups (K,), counted from the `first`, of positive values (K,) that are alike to so many digits, `count`, and
    of the others the nearest one; −1 where few are.
    """
    _, of, counts = np.unique(digits(count, values)[0], return_inverse=True, return_counts=True)
    common = counts >= max(FEWEST, SHARE * len(values))
    if counts[common].sum() < COVERED * len(values):
        return np.full(len(values), -1)
    centres = np.log([np.median(values[of == i]) for i in np.flatnonzero(common)])
    order = np.argsort(centres)
    nearest = np.searchsorted((centres[order][1:] + centres[order][:-1]) / 2.0, np.log(values))
    return np.asarray(first + nearest)


def by_groups(search: Search, values: Array, labels: Slots, unit: Array) -> bool | None:
    """Gauss–Newton by the common values of groups, in their `unit` (P,), from `values` (P,) on, over windows that grow
    as long as it comes to the rounding of each; whether it does so on all frames, or short numbers near its values do.
    None where it does not on the first window: these groups are not those of the target. Raises Stop.
    """
    whole, found = search.objective, np.zeros(0)
    for frames in window_lengths(first_window(whole), whole.steps + 1, GROWTH):
        window = whole.until(frames, whole.tolerance)
        part = Common(search, window, values, labels)
        with contextlib.suppress(Diverged):
            values = part.parameters(continuation.some_steps(part, part.y(values), STEPS, SAVING, PATIENCE))
        if not whole.rmse(window.cost_or_infinity(values)) <= limit(whole):
            break
        search.own, found = True, values
        if by_short_numbers(search, window, values, labels, unit):
            return True
    return whole.rmse(search.visit(found)) <= limit(whole) if len(found) else None


class Common(Trajectory):
    """An objective by one factor on the values of each group, beside what is not of single vertices or springs."""

    def __init__(self, search: Search, objective: Objective, values: Array, labels: Slots) -> None:
        """`values` (P,), and the group of each (P,), −1 of those that have none."""
        super().__init__(search, objective)
        self.values, self.shared, alone = values, labels >= 0, search.fitted.copy()
        for block in objective.blocks:
            alone[block.part] &= not (block.name in LETTERED and block.mode == "L")
        self.alone = np.flatnonzero(alone)
        self.first, of = np.unique(labels[self.shared], return_index=True, return_inverse=True)[1:]
        self.column = np.full(len(values), -1)
        self.column[self.shared] = of
        self.column[self.alone] = len(self.first) + np.arange(len(self.alone))

    def y(self, p: Array) -> Array:
        """Coordinates (Q,) of parameters (P,)."""
        factors = (p[self.shared] / self.values[self.shared])[self.first]
        return np.append(np.log(factors), self.search.coordinates.y(p)[self.alone])

    def parameters(self, y: Array) -> Array:
        """Parameters (P,) at coordinates y (Q,)."""
        ends, own, p = self.search.coordinates, self.search.coordinates.y(self.values), self.values.copy()
        own[self.alone] = y[len(self.first) :]
        p[self.alone] = ends.p(own)[self.alone]
        p[self.shared] *= np.exp(y[self.column[self.shared]])
        return ends.clipped(p)

    def derivative(self, p: Array) -> Array:
        """∂p/∂y (P,) at p (P,), of each parameter by its own coordinate."""
        return np.where(self.shared, p, super().derivative(p))

    @property
    def bounds(self) -> tuple[Array, Array]:
        """Ends (Q,) of the coordinates; `parameters` keeps those of groups."""
        ends, groups = self.search.coordinates, np.full(len(self.first), np.inf)
        return np.append(-groups, ends.lower[self.alone]), np.append(groups, ends.upper[self.alone])

    @property
    def own_widths(self) -> Array:
        """Changes (Q,) of the coordinates by a factor e, or by σ where they are linear."""
        return np.append(np.ones(len(self.first)), self.search.coordinates.weight[self.alone])
