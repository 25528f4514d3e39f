"""Gauss–Newton in a trust region: the fit of a whole motion by its sensitivity to every parameter.

Near a point y the residuals are r + J d, so the cost is |r|² + 2 gᵀd + dᵀH d with H = JᵀJ and g = Jᵀr (`normal`).
Each iteration minimises that, with the prior's penalty added, inside the bounds and a ball whose radius follows how
well the model predicted the cost; a trial costs one simulation, a hundredth of the model, so several are made of one
model. J. J. Moré, The Levenberg–Marquardt algorithm, 1978.

It ends where the step that is left is small against what the noise leaves open: the cost it would save is below a
hundredth of the variance of one residual, a tenth of a standard error over all parameters together; or, where residuals
are noise, below the same for each of the combinations that the data determine (D. M. Bates, D. G. Watts, A relative
offset orthogonality convergence criterion for nonlinear least squares, Technometrics 23, 1981). Where a model
that cannot reproduce the target leaves large residuals, of which neighbours are alike, the last digits come slowly and
say nothing: it also ends where two steps in a row would save less than 1e-5 of the cost. A problem that asks for no
more than a `least` saving ends as soon as the model of the last step says that no more is left.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cached_property
from typing import NamedTuple

import numpy as np

from clothfit.base.arrays import Array
from clothfit.optimise import trust_region
from clothfit.optimise.evidence import inverse
from clothfit.optimise.prior import Prior
from clothfit.optimise.status import Status

LEFT = 1e-2
"""Cost that the rest of the way would save, relative to the variance of a residual, where the fit ends."""

EACH, MOST_GAIN = 5e-2, 5e-3
"""… the same for each combination of values that the data determine, where residuals are noise: a fifth of a standard
error; and relative to the whole cost, which a fit without noise goes far below.
"""

SMALL_GAIN = 1e-5
"""The same relative to the whole cost, twice in a row: where the way is fast, the second is below `LEFT`."""

NEEDED, POOR, GOOD = 1e-4, 0.25, 0.75
"""Achieved over predicted reduction: what a step needs, and below or above which the trust region shrinks or grows."""

FIRST_RADIUS = 1.0
"""Of the trust region, in root mean square of the coordinates: a factor e; with widths, one of these."""

LEARNING = 12
"""Iterations in which the prior's width follows the data; it is kept after that, so that the rest converges. It is held
where residuals are no noise: the width takes them as independent, and what a wrong model leaves would widen it.
"""

SMALLEST = 1e-10
"""Steps below this, in root mean square, lead nowhere."""

ROUNDING = 1e-14
"""A whole step below this, relative to the coordinates or to 1, is rounding: there is the minimum."""


class Patience(NamedTuple):
    """When slow progress ends a fit."""

    iterations: int = 25
    slow: float = 2e-3  # it stalls where so many iterations lower the cost by less than this fraction
    flat: float = 0.0  # … and has converged where the last one did by less than this, or would have, had one been found


PATIENT = Patience()


@dataclass(frozen=True)
class Model:
    """The cost near a point."""

    y: Array  # (Q,)
    cost: float
    H: Array  # (Q, Q)
    g: Array  # (Q,)


@dataclass(frozen=True)
class Problem:
    """What is minimised, as functions of the coordinates y (Q,)."""

    model: Callable[[Array], Model]
    cost: Callable[[Array], float]  # infinite where the simulation diverges
    lower: Array
    upper: Array
    residuals: int
    least: float = 0.0  # relative reduction of the cost below which no more is asked for
    patience: Patience = PATIENT
    believe: Callable[[Prior, float], None] | None = None  # takes the prior of the moment, and σ²
    is_noise: Callable[[Array], bool] | None = None  # whether most of the residuals may be noise; None: they are
    waiting: Callable[[], None] | None = None  # called now and then while a long step is computed
    widths: Array | None = None  # (Q,) of a trust region that is as wide as residuals are flat, at most; None: a ball


def minimise(
    problem: Problem,
    y: Array,
    prior: Prior,
    accepted: Callable[[Prior, Model, float], None] | None = None,
    iterations: int = 200,
    radius: float | None = None,
) -> tuple[Model, Prior, Status]:
    """Go down from y (Q,); returns the last model, the prior and the status.

    `accepted` is called with the prior, the model and the radius after each iteration, and may raise Stop.
    """
    if radius is None:
        radius = FIRST_RADIUS * (np.sqrt(max(len(y), 1)) if problem.widths is None else 1.0)
    model = problem.model(y)
    mark = (0.0, np.inf)  # iteration and cost when it last became much lower
    last = (np.inf, np.inf)  # what the last model would have saved, and its cost
    learning = LEARNING if prior.groups and prior.learns else 0  # iterations that are left
    for iteration in range(iterations):
        patience = problem.patience
        if not model.cost > (1.0 - patience.slow) * mark[1]:
            mark = (float(iteration), model.cost)
        elif iteration - mark[0] >= patience.iterations:
            return model, prior, ended(model.cost > (1.0 - patience.flat) * last[1])
        learned, sigma2 = prior.learned(model.H, model.g, model.y, model.cost, problem.residuals)
        learns = learning > 0 and (problem.is_noise is None or problem.is_noise(model.y))
        if learns:
            prior, learning = prior.between(learned), learning - 1
        near = quadratic(problem, model, prior, sigma2)
        saving = near.reduction(near.whole)
        small = is_small(problem, model, near, sigma2, saving, last)
        if small and learns and not problem.least:
            prior, sigma2 = prior.learned_fully(model.H, model.g, model.y, model.cost, problem.residuals)
            near = quadratic(problem, model, prior, sigma2)
            saving = near.reduction(near.whole)
            small = is_small(problem, model, near, sigma2, saving, last)
        if problem.believe:
            problem.believe(prior, sigma2)
        if small:
            return model, prior, Status.CONVERGED
        last = saving, model.cost
        value = model.cost + prior.value(model.y, sigma2)

        def total(y: Array, prior: Prior = prior, sigma2: float = sigma2) -> float:
            return problem.cost(y) + prior.value(y, sigma2)

        step, radius, new = descend(total, value, near, radius)
        if new is None:
            there = np.abs(near.whole).max(initial=0.0) <= ROUNDING * max(np.abs(model.y).max(initial=0.0), 1.0)
            there |= bool(problem.is_noise and saving <= len(model.y) * sigma2 and problem.is_noise(model.y))
            return model, prior, ended(there or saving <= patience.flat * model.cost)
        # where a whole step has led nearly to the minimum of its model, a new model would save too little to be asked
        # for: it differs from this one by about as much as the cost from what was foretold
        predicted = problem.least > 0 and step is near.whole
        predicted = predicted and abs(value - near.reduction(step) - new) <= problem.least * new
        y = model.y + step
        model = replace(model, y=y, cost=new - prior.value(y, sigma2)) if predicted else problem.model(y)
        if accepted:
            accepted(prior, model, radius)
        if predicted:
            return model, prior, Status.CONVERGED
    return model, prior, Status.LIMIT


def quadratic(problem: Problem, model: Model, prior: Prior, sigma2: float) -> Quadratic:
    """Cost and penalty near the point of a model."""
    A = prior.matrix(sigma2)
    H, g = model.H + A, model.g + A @ (model.y - prior.centre)
    lower, upper, scale = problem.lower - model.y, problem.upper - model.y, None
    if problem.widths is not None and model.cost > 0:  # the residuals' change, relative to their size, and the width
        with np.errstate(over="ignore"):
            scale = np.asarray(np.sqrt(model.H.diagonal() / model.cost + 1.0 / problem.widths**2))
    return Quadratic(model.y, H, g, lower, upper, scale, problem.waiting)


def is_small(
    problem: Problem, model: Model, near: Quadratic, sigma2: float, saving: float, last: tuple[float, float]
) -> bool:
    """Whether what a step would save says nothing, beside the noise where residuals are that; `last`: what the one
    before would have saved, and its cost.
    """
    twice = max(saving / model.cost, last[0] / last[1]) if model.cost > 0 and last[1] < np.inf else np.inf
    if saving <= max(LEFT * sigma2, problem.least * model.cost) or twice <= SMALL_GAIN:
        return True
    if problem.is_noise is None or not saving <= min(MOST_GAIN * model.cost, EACH * len(model.y) * sigma2):
        return False
    determined = float((model.H * inverse(near.H)).sum())
    return saving <= EACH * determined * sigma2 and problem.is_noise(model.y)


def ended(converged: bool) -> Status:
    """The status where slow progress ends a fit."""
    return Status.CONVERGED if converged else Status.STALLED


@dataclass(frozen=True)
class Quadratic:
    """A model of cost and penalty at y, and its minimum within the bounds. The length of a step d is |S d|."""

    y: Array
    H: Array
    g: Array
    lower: Array  # of a step
    upper: Array
    scale: Array | None = None  # (Q,), the diagonal of S, the length of a change of 1 of each coordinate; None: all 1
    waiting: Callable[[], None] | None = None  # as of `Problem`

    @cached_property
    def whole(self) -> Array:
        """The step to the minimum."""
        return self._solved(np.inf)

    def within(self, radius: float) -> Array:
        """The best step of at most this length."""
        return self.whole if self.length(self.whole) <= radius else self._solved(radius)

    def _solved(self, radius: float) -> Array:
        S = self.scale
        if S is None:
            return trust_region.solve(self.H, self.g, self.lower, self.upper, radius, self.waiting)
        ends = self.lower * S, self.upper * S
        return np.asarray(trust_region.solve(self.H / np.outer(S, S), self.g / S, *ends, radius, self.waiting) / S)

    def length(self, step: Array) -> float:
        """How long a step is."""
        return float(np.linalg.norm(step if self.scale is None else self.scale * step))

    def reduction(self, step: Array) -> float:
        """By how much a step lowers the model."""
        return -float(2 * self.g @ step + step @ self.H @ step)

    def at(self, step: Array) -> Array:
        """Where a step leads, not a rounding beyond the bounds."""
        return np.clip(self.y + step, self.y + self.lower, self.y + self.upper)


def descend(
    total: Callable[[Array], float], value: float, model: Quadratic, radius: float
) -> tuple[Array, float, float | None]:
    """A step that lowers `total` from `value`, the new radius, and what it leads to; None where there is none."""
    while radius > SMALLEST * np.sqrt(len(model.y)):
        step = model.within(radius)
        new, predicted = total(model.at(step)), model.reduction(step)
        if new < value and value - new >= NEEDED * predicted:
            break
        radius = POOR * min(radius, model.length(step))
    else:
        return np.zeros(len(model.y)), radius, None
    if value - new < POOR * predicted:
        return step, 0.5 * radius, new
    while value - new > GOOD * model.reduction(step) and model.length(step) < model.length(model.whole):
        wider = model.within(2.0 * radius)
        beyond = total(model.at(wider))
        if not beyond < new:
            break
        step, new, radius = wider, beyond, 2.0 * radius
    return step, radius, new
