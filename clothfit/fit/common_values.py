"""Values that many springs or vertices share: the simplest ones that a motion of the model itself is as near to.

Values one by one carry the rounding of their target, or of the solver: of a few parts in ten thousand, which a cloth
that buckles makes millimetres of. Most fabrics have few different values, often written with few digits. So values are
rounded to one digit, to two, …; those that many share once they are rounded are taken for one value, their median, and
others for the nearest of these; then the medians are rounded, too. What moves the first frames no farther from the
target than what rounding leaves is tried on all of them. Where no short numbers reproduce these, Gauss–Newton by the
common values alone goes on over longer and longer windows. As any point of a search, none is kept that is no nearer.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

import numpy as np

from clothfit.base.arrays import Array
from clothfit.fit import continuation, hierarchy
from clothfit.fit.trajectory_fit import first_window, window_lengths
from clothfit.motion.degrade import digits
from clothfit.motion.divergence import Diverged
from clothfit.objective.objective import Objective
from clothfit.optimise.gauss_newton import Patience
from clothfit.optimise.search import Search
from clothfit.optimise.trajectory import Trajectory
from clothfit.scene.directions import Slots
from clothfit.scene.fit_vector import parameters, with_parameters
from clothfit.scene.kinds import LETTERED
from clothfit.scene.scene import Scene

FEWEST, SHARE = 8, 0.01
"""Values that share one, at least, and their share of all."""

COVERED = 0.6
"""Share of all values, at least, that have a value in common with others."""

MOST_DIGITS = 9
"""Of single precision, in which the editor writes."""

LEAST_ERROR, ROUNDED = 1e-8, 0.6
"""Error, m, that is none; and that of what is rounded, relative to the largest that rounding leaves: √⅓ in the mean.
"""

GROWTH, STEPS, SAVING, PATIENCE = 1.5, 6, 1e-3, Patience(1, 1e-3, 1e-3)
"""Of the windows of Gauss–Newton: the ratio of one to the one before, iterations in each, and what ends it."""


def simplify(search: Search, p: Array) -> bool:
    """Try the simplest values near p (P,); whether some of them reproduce the target to its rounding. Raises Stop."""
    whole = search.objective
    window = whole.until(first_window(whole), whole.tolerance)
    try:
        for values, labels in of_groups(search, p):
            if by_short_numbers(search, window, values, labels):
                return True
            if (found := by_groups(search, values, labels)) is not None:
                return found
        return False
    finally:
        search.own |= whole.rmse(search.best.cost) <= limit(whole)


def limit(objective: Objective) -> float:
    """Error of a motion, m, that is rounding."""
    return max(LEAST_ERROR, ROUNDED * objective.rounding)


def by_short_numbers(search: Search, window: Objective, values: Array, labels: Slots) -> bool:
    """Visit the values (P,) of groups, with as few digits as a window allows; whether they reproduce all frames."""
    before = values
    for count in range(1, MOST_DIGITS + 1):
        short = np.where(labels >= 0, digits(count, values)[0], values)
        if not np.array_equal(short, before) and window.rmse(search.measure(short, window)) <= limit(window):
            return search.objective.rmse(search.visit(short)) <= limit(window)
        before = short
    return False


def of_groups(search: Search, p: Array) -> Iterator[tuple[Array, Slots]]:
    """p (P,) with common values, and the group of each (P,), −1 of those that have none: first few groups, then more.
    """
    before = np.zeros(0)
    for count in range(1, MOST_DIGITS + 1):
        values, labels = p.copy(), np.full(len(p), -1)
        for block in search.objective.blocks:
            if block.name in LETTERED and block.mode == "L":
                known = np.arange(len(p))[block.part]
                known = known[search.fitted[known] & (p[known] != search.start[known]) & (p[known] > 0)]
                labels[known] = grouped(p[known], count, labels.max() + 1)
        for group in range(labels.max() + 1):
            values[labels == group] = np.median(p[labels == group])
        if labels.max() >= 0 and not np.array_equal(values, before):
            before = values
            yield values, labels


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


def by_groups(search: Search, values: Array, labels: Slots) -> bool | None:
    """Gauss–Newton by the values (P,) of groups, over windows that grow as long as it comes to the rounding of each;
    whether it does so on all frames, or short numbers near its values do. None where it does not on the first window:
    these groups are not those of the target. Raises Stop.
    """
    whole = search.objective
    if any(each.scene is not whole.scene for each in whole.experiments):
        return None
    scene = with_groups(search, values, labels)
    if all(cloth.mode("stiffness") == "n" for cloth in scene.cloths):
        return None  # masses have no families by which they could be fitted
    part = search.subsearch(whole.flagging(scene, whole.tolerance), parameters(scene), np.inf)
    y, p, own = part.y, np.zeros(0), search.progress
    for frames in window_lengths(first_window(whole), whole.steps + 1, GROWTH):
        along = Trajectory(part, part.objective.until(frames, whole.tolerance))
        own.p = part.parameters(y)
        try:
            y = continuation.some_steps(along, y, STEPS, SAVING, PATIENCE)
        except Diverged:
            break
        finally:
            own.p = search.best.p
        if not along.objective.rmse(along.cost(y)) <= limit(whole):
            break
        p = hierarchy.as_whole(part, part.parameters(y), whole.scene)
        if by_short_numbers(search, whole.until(frames, whole.tolerance), p, labels):
            return True
    return whole.rmse(search.visit(p)) <= limit(whole) if len(p) else None


def with_groups(search: Search, values: Array, labels: Slots) -> Scene:
    """The scene of these values (P,), whose springs have their groups for families, by factors on these."""
    scene = with_parameters(search.objective.scene, values)
    cloths = [replace(cloth, settings="nn") for cloth in scene.cloths]
    for block in search.objective.blocks:
        own = labels[block.part]
        if block.cloth is not None and block.name == "stiffness" and own.max() >= 0:
            names, family = np.unique(own, return_inverse=True)
            cloth = cloths[block.cloth]
            layout = replace(cloth.layout, names=tuple(map(str, names)), family=family.astype(np.int32), regions=())
            cloths[block.cloth] = replace(cloth, layout=layout, settings="nR")
    return replace(scene, cloths=tuple(cloths))
