"""Fits through steps that switch their form: motions whose steps have given forms, and the search for these.

A compressed cloth buckles in a few steps, which are clamped or shortened (`engine.prescribed`). Which ones depends on
the values, and where one switches, the cost jumps. It is smooth while the forms are held; so the values that bring a
motion nearest are found for some forms, and the forms are chosen by the cost that this comes to:

    min over the forms F of  min_y G(y; F)

Springs that pull a motion to its target (`nudged`) bring its states near the target's, and with them the forms that
steps take from there without springs: the weaker the pull, the nearer. Others that are tried are those of the motion
without springs and, where more than noise is left, those that differ in one step. A cloth buckles early, and the forms
are found on the frames until then; at last all frames are fitted without springs, and what counts then is the cost of
the motion whose steps take their own forms.
"""

from __future__ import annotations

import contextlib
from collections.abc import Callable, Iterable, Iterator, Sequence
from operator import attrgetter
from typing import NamedTuple

import numpy as np

from clothfit.base.arrays import Array
from clothfit.engine.prescribed import Forms
from clothfit.engine.system import meets_itself
from clothfit.fit.continuation import nudged
from clothfit.motion.divergence import Diverged
from clothfit.objective.objective import Objective
from clothfit.objective.whiteness import SIGNIFICANT, residual_test
from clothfit.optimise.prior import Prior
from clothfit.optimise.search import Search

NUDGES = (3.0, 1.0, 0.3, 0.0)
"""ω of the springs, in radians per frame, one after the other."""

BEYOND = 10
"""Steps after the last one that is not plain, on which the forms are found."""

AROUND = 3
"""Steps from one in another form within which a plain one may be shortened."""

PAYS = 0.005
"""Share of the cost that other forms must save."""

ITERATIONS, LAST_ITERATIONS = 12, 30
"""Iterations of Gauss–Newton with given forms; on all frames."""

FEW_ITERATIONS, BEST = 4, 2
"""The same in which forms that differ in one step are compared, and how many of them are fitted after that."""

CHANGES = 6
"""Changes of the forms at each pull, at most."""


class Held(NamedTuple):
    """Where a fit of motions with given forms has come to."""

    forms: Sequence[Forms]  # of each run
    y: Array  # (Q,)
    prior: Prior
    cost: float


cost_of = attrgetter("cost")
"""What a fit has come to."""

Fitted = Callable[[Objective, Array, Prior, int], tuple[Array, Prior]]
"""Fits motions from some coordinates (Q,) with a prior, in so many iterations: where it has come to, and
the prior that it learned.
"""


def through_forms(search: Search, y: Array, prior: Prior, fitted: Fitted) -> Held | None:
    """The fit of motions whose steps have the forms that fit best, from coordinates y (Q,); None where all
    steps of a motion that is strongly pulled are plain. Raises Stop, and Diverged.
    """
    whole = search.objective
    if any(meets_itself(run.system) for run in whole.runs):
        return None
    last = last_of_first(whole.forms_along(nudged(whole, NUDGES[0]), search.parameters(y)))
    if last is None:
        return None
    search.enter("forms of steps")
    part, held = whole.until(last + 1 + BEYOND), Held([], y, prior, np.inf)
    for omega in NUDGES:
        held = best_forms(search, nudged(part, omega) if omega else part, part, held, fitted)
    weak = nudged(whole, min(omega for omega in NUDGES if omega))
    later = whole.forms_along(weak, search.parameters(held.y))
    forms = [joined(own, its) for own, its in zip(held.forms, later, strict=True)]
    trials = Trials(search, whole, fitted)
    best = trials.fit(held, forms, LAST_ITERATIONS)
    for _ in range(CHANGES):
        found = min(trials.of(best, followed(search, whole, whole, best), LAST_ITERATIONS), key=cost_of, default=best)
        if not found.cost < (1.0 - PAYS) * best.cost:
            break
        best = found
    return best


def last_of_first(forms: Sequence[Forms]) -> int | None:
    """The last of the first steps that are not plain, before as many plain ones as `BEYOND`; None where all are plain.
    """
    others = np.unique(np.concatenate([np.flatnonzero(~own.plain) for own in forms]))
    gaps = np.flatnonzero(np.diff(others) > BEYOND)
    return int(others[gaps[0] if len(gaps) else -1]) if len(others) else None


def joined(first: Forms, others: Forms) -> Forms:
    """The forms of the first steps, and the `others` after them."""
    return Forms(*(np.concatenate([a, b[len(a) :]]) for a, b in zip(first, others, strict=True)))


def best_forms(search: Search, objective: Objective, free: Objective, held: Held, fitted: Fitted) -> Held:
    """The forms with which motions of an objective are fitted best, from those that are held; `free` is the objective
    of motions that nothing pulls. Raises Stop.
    """
    trials, best = Trials(search, objective, fitted), held._replace(cost=np.inf)
    if held.forms:
        best = trials.fit(best, held.forms, ITERATIONS)
    for _ in range(CHANGES):
        found = min(trials.of(best, followed(search, objective, free, best), ITERATIONS), key=cost_of, default=best)
        if not found.cost < (1.0 - PAYS) * best.cost and best.forms and not is_noise(search, objective, best):
            others = ([*best.forms[:run], other, *best.forms[run + 1 :]]
                      for run, own in enumerate(best.forms) for other in neighbours(own))  # fmt: skip
            rough = sorted(trials.of(best, others, FEW_ITERATIONS), key=cost_of)
            found = min((trials.fit(each, each.forms, ITERATIONS) for each in rough[:BEST]), key=cost_of, default=best)
        if not found.cost < (1.0 - PAYS) * best.cost:
            break
        best = found
    return best


class Trials:
    """Fits of motions of one objective with given forms, each of them once."""

    def __init__(self, search: Search, objective: Objective, fitted: Fitted) -> None:
        self.search, self.objective, self.fitted = search, objective, fitted
        self.tried = list[Sequence[Forms]]()

    def of(self, held: Held, others: Iterable[Sequence[Forms]], iterations: int) -> list[Held]:
        """Fits with other forms, which were not tried before, from where a fit has come to."""
        new = [forms for forms in others if not any(same(forms, each) for each in self.tried)]
        return [self.fit(held, forms, iterations) for forms in new]

    def fit(self, held: Held, forms: Sequence[Forms], iterations: int) -> Held:
        """A fit with some forms, of so many iterations. Raises Stop."""
        self.tried.append(forms)
        own = self.objective.with_forms(forms)
        if not np.isfinite(self.search.measure(self.search.parameters(held.y), own)):
            return held._replace(forms=forms, cost=np.inf)
        y, prior = self.fitted(own, held.y, held.prior, iterations)
        return Held(forms, y, prior, own.cost_or_infinity(self.search.parameters(y)))


def is_noise(search: Search, objective: Objective, held: Held) -> bool:
    """Whether what is left is noise, in time and in space."""
    test = residual_test(objective.with_forms(held.forms), search.parameters(held.y))
    return test is None or max(test.z_time, test.z_space) < SIGNIFICANT


def followed(search: Search, objective: Objective, free: Objective, best: Held) -> list[Sequence[Forms]]:
    """The forms that free steps take from the states of the motion with the best forms, and those of the free motion.
    """
    p, found = search.parameters(best.y), list[Sequence[Forms]]()
    with contextlib.suppress(Diverged):
        found.append(free.forms_along(objective.with_forms(best.forms) if best.forms else objective, p))
        found.append(free.forms(p))
    return found[:1] if len(found) > 1 and same(*found) else found


def neighbours(forms: Forms) -> Iterator[Forms]:
    """Forms that differ in one step: one that is shortened more, or less, or not; a plain one near another form that is
    shortened; and one that is clamped or not where this begins or ends.
    """
    theta, other = forms.theta, ~forms.plain
    for t in np.flatnonzero(theta < 1.0):
        for part in dict.fromkeys((1.0, min(2.0 * theta[t], 1.0), 0.5 * theta[t])):
            yield forms._replace(theta=changed(theta, t, part))
    near = np.convolve(other, np.ones(2 * AROUND + 1), "same")[: len(other)] > 0.0
    for t in np.flatnonzero(near & (theta == 1.0) & ~forms.clamped):
        yield forms._replace(theta=changed(theta, t, 0.5))
    for place in range(len(other)):
        around = forms.clamped[max(place - 1, 0) : place + 2]
        if around.any() and not around.all():
            clamped = forms.clamped.copy()
            clamped[place] = not clamped[place]
            yield forms._replace(clamped=clamped)


def changed(values: Array, t: np.intp, value: float) -> Array:
    """The values with another one at t."""
    found = values.copy()
    found[t] = value
    return found


def same(forms: Sequence[Forms], others: Sequence[Forms]) -> bool:
    """Whether the steps of all runs have the same forms."""
    return all(own.equals(other) for own, other in zip(forms, others, strict=True))
