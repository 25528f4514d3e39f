"""Gauss–Newton in a trust region: the fit of a whole motion by its sensitivity to every parameter.

Near a point y the residuals are r + J d, so the cost is |r|² + 2 gᵀd + dᵀH d with H = JᵀJ and g = Jᵀr (`normal`).
Each iteration minimises that, with the prior's penalty added, inside the bounds and a ball whose radius follows how
well the model foretold the cost; a trial costs one simulation, a hundredth of the model, so several are made of one
model. J. J. Moré, The Levenberg–Marquardt algorithm, 1978.

It ends where the step that is left is small against what the noise leaves open: the cost it would save is below a
hundredth of the variance of one residual, a tenth of a standard error over all parameters together. Where a model
that cannot reproduce the target leaves large residuals, of which neighbours are alike, the last digits come slowly and
say nothing: it also ends where two steps in a row would save less than 1e-5 of the cost.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import partial
from typing import NamedTuple

import numpy as np

from clothfit.base.arrays import Array
from clothfit.optimise import bounded
from clothfit.optimise.checkpoint import Record
from clothfit.optimise.prior import Prior
from clothfit.optimise.search import Search
from clothfit.optimise.status import Status

LEFT = 1e-2
"""Cost that the rest of the way would save, relative to the variance of a residual, where the fit ends."""

SMALL = 1e-5
"""The same relative to the whole cost, twice in a row: where the way is fast, the second is below `LEFT`."""

ENOUGH, POOR, GOOD = 1e-4, 0.25, 0.75
"""Achieved over foretold reduction: what a step needs, and below or above which the trust region shrinks or grows."""

FIRST_RADIUS = 1.0
"""Of the trust region, in root mean square of the coordinates: a factor e."""


LEARNING = 12
"""Iterations in which the prior's width follows the data; it is kept after that, so that the rest converges."""

SMALLEST = 1e-10
"""Steps below this, in root mean square, lead nowhere."""


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
class State:
    """Where a fit stands after an iteration: all that the next one depends on."""

    y: Array  # (Q,)
    radius: float
    tau: tuple[float, ...]
    iteration: int
    mark: tuple[float, float] = (0.0, np.inf)  # iteration and cost when it last became much lower
    last: tuple[float, float] = (np.inf, np.inf)  # what the iteration's model would have saved, and its cost


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


def minimise(
    problem: Problem,
    y: Array,
    prior: Prior,
    state: State | None = None,
    accepted: Callable[[State, Model], None] | None = None,
    iterations: int = 200,
) -> tuple[Model, Prior, Status]:
    """Go down from y, or from a `state` that `accepted` was given; returns the last model, the prior and the status."""
    if state is None:
        state = State(y, FIRST_RADIUS * np.sqrt(max(len(y), 1)), prior.tau, 0)
    prior, radius = replace(prior, tau=state.tau), state.radius
    model = problem.model(state.y)
    mark, last = state.mark, state.last
    for iteration in range(state.iteration, iterations):
        patience = problem.patience
        if not model.cost > (1.0 - patience.slow) * mark[1]:
            mark = (float(iteration), model.cost)
        elif iteration - mark[0] >= patience.iterations:
            return model, prior, ended(model.cost > (1.0 - patience.flat) * last[1])
        learned, sigma2 = prior.learned(model.H, model.g, model.y, model.cost, problem.residuals)
        if iteration < LEARNING:
            prior = prior.between(learned)
        A = prior.matrix(sigma2)
        H, g = model.H + A, model.g + A @ (model.y - prior.centre)
        lower, upper = problem.lower - model.y, problem.upper - model.y
        whole = bounded.solve(H, g, lower, upper)
        saving = -float(2 * g @ whole + whole @ H @ whole)
        twice = max(saving / model.cost, last[0] / last[1]) if model.cost > 0 and last[1] < np.inf else np.inf
        if saving <= max(LEFT * sigma2, problem.least * model.cost) or twice <= SMALL:
            return model, prior, Status.CONVERGED
        last = saving, model.cost
        value = model.cost + prior.value(model.y, sigma2)
        total = partial(penalised, problem, prior, sigma2)
        step, radius, good = descend(total, value, Quadratic(model.y, H, g, lower, upper, whole), radius)
        if not good:
            return model, prior, ended(saving <= patience.flat * model.cost)
        model = problem.model(model.y + step)
        if accepted:
            accepted(State(model.y, radius, prior.tau, iteration + 1, mark, last), model)
    return model, prior, Status.LIMIT


def ended(converged: bool) -> Status:
    """The status where slow progress ends a fit."""
    return Status.CONVERGED if converged else Status.STALLED


def penalised(problem: Problem, prior: Prior, sigma2: float, y: Array) -> float:
    """Cost and penalty at y."""
    return problem.cost(y) + prior.value(y, sigma2)


@dataclass(frozen=True)
class Quadratic:
    """A model of cost and penalty at y, and its minimum within the bounds."""

    y: Array
    H: Array
    g: Array
    lower: Array  # of a step
    upper: Array
    whole: Array  # the step to the minimum

    def within(self, radius: float) -> Array:
        """The best step of at most this length."""
        if np.linalg.norm(self.whole) <= radius:
            return self.whole
        return bounded.solve(self.H, self.g, self.lower, self.upper, radius)

    def foretold(self, step: Array) -> float:
        """By how much a step lowers the model."""
        return -float(2 * self.g @ step + step @ self.H @ step)

    def at(self, step: Array) -> Array:
        """Where a step leads, not a rounding beyond the bounds."""
        return np.clip(self.y + step, self.y + self.lower, self.y + self.upper)


def descend(
    total: Callable[[Array], float], value: float, model: Quadratic, radius: float
) -> tuple[Array, float, bool]:
    """A step that lowers `total` from `value`, the new radius, and whether there is one."""
    while radius > SMALLEST * np.sqrt(len(model.y)):
        step = model.within(radius)
        new, foretold = total(model.at(step)), model.foretold(step)
        if new < value and value - new >= ENOUGH * foretold:
            break
        radius = POOR * min(radius, float(np.linalg.norm(step)))
    else:
        return np.zeros(len(model.y)), radius, False
    if value - new < POOR * foretold:
        return step, 0.5 * radius, True
    while value - new > GOOD * model.foretold(step) and np.linalg.norm(step) < np.linalg.norm(model.whole):
        wider = model.within(2.0 * radius)
        beyond = total(model.at(wider))
        if not beyond < new:
            break
        step, new, radius = wider, beyond, 2.0 * radius
    return step, radius, True


RUNNING = "running"


class Descent:
    """One descent, and its place in the journal of the search.

    After each accepted iteration the journal keeps the state and how the search stands, in the place of all that this
    descent has asked before. A descent that has ended keeps its outcome in the same way.
    """

    def __init__(self, search: Search, prior: Prior, count: int) -> None:
        """`count`: Q."""
        self.search, self.journal, self.place = search, search.journal, search.journal.place
        self.name, self.widths = f"Gauss-Newton of {count} with {len(prior.tau)}", len(prior.tau)

    def known(self) -> tuple[State, Status | None] | None:
        """The last state that is known of it, and its status where it has ended; the search then stands as it did.

        Raises Stop.
        """
        if not self.journal.follows(self.name):
            return None
        record, standing = self.journal.next(self.name), self.journal.next("standing")
        if record is None or standing is None:
            return None
        ended = None if record.text == RUNNING else Status(record.text)  # ValueError where there is none
        iteration, radius, *marks = record.values[:6].tolist()
        rest = record.values[6:]
        self.search.restore(standing.values)
        tau = tuple(rest[: self.widths].tolist())
        mark, last = (marks[0], marks[1]), (marks[2], marks[3])
        return State(rest[self.widths :], radius, tau, int(iteration), mark, last), ended

    def keep(self, state: State, status: str = RUNNING) -> None:
        """Keep a state; at once where the descent goes on from it."""
        values = np.array([state.iteration, state.radius, *state.mark, *state.last, *state.tau, *state.y])
        records = [Record(self.name, values, status), Record("standing", self.search.state_vector())]
        self.journal.replace(self.place, records, now=status == RUNNING)


def minimise_resumed(
    search: Search,
    problem: Problem,
    y: Array,
    prior: Prior,
    accepted: Callable[[State, Model], None] | None = None,
    iterations: int = 200,
) -> tuple[Array, Prior, Status]:
    """Go down from y (Q,) as `minimise` does; returns the last point (Q,), the prior and the status.

    `accepted` may raise Stop.
    """
    descent = Descent(search, prior, len(y))
    known = descent.known()
    if known and known[1]:
        return known[0].y, replace(prior, tau=known[0].tau), known[1]
    state = known[0] if known else None
    if state is not None:
        search.budget.history.pop()  # the model at its point is made again, and was counted
    last = [state or State(y, 0.0, prior.tau, 0)]

    def keep(state: State, model: Model) -> None:
        last[0] = state
        try:
            if accepted:
                accepted(state, model)
        finally:  # the search may end here, and be resumed with a larger budget
            descent.keep(state)

    model, prior, status = minimise(problem, y, prior, state, keep, iterations)
    descent.keep(replace(last[0], y=model.y, tau=prior.tau), status)
    return model.y, prior, status
