"""Gauss–Newton that goes on from where an earlier fit was killed.

After each accepted iteration the journal keeps the state and how the search stands, in the place of all that this
descent has asked before. A descent that has ended keeps its outcome in the same way.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np

from clothfit.base.arrays import Array
from clothfit.optimise import gauss_newton
from clothfit.optimise.checkpoint import Record
from clothfit.optimise.gauss_newton import Model, Problem, State
from clothfit.optimise.prior import Prior
from clothfit.optimise.search import Search

RUNNING = "running"
STATUSES = (RUNNING, "converged", "stalled", "limit")


class Descent:
    """One descent, and its place in the journal of the search."""

    def __init__(self, search: Search, prior: Prior, count: int) -> None:
        """`count`: Q."""
        self.search, self.journal, self.place = search, search.journal, search.journal.place
        self.name, self.widths = f"Gauss-Newton of {count} with {len(prior.tau)}", len(prior.tau)

    def known(self) -> tuple[State, str] | None:
        """The last state that is known of it, and its status; the search then stands as it did. Raises Stop."""
        if not self.journal.follows(self.name):
            return None
        record, standing = self.journal.next(self.name), self.journal.next("standing")
        if record is None or standing is None:
            return None
        if record.text not in STATUSES:
            raise ValueError(f"there is no status {record.text!r}")
        iteration, radius, *marks = record.values[:6].tolist()
        rest = record.values[6:]
        self.search.stand(standing.values)
        tau = tuple(rest[: self.widths].tolist())
        mark, last = (marks[0], marks[1]), (marks[2], marks[3])
        return State(rest[self.widths :], radius, tau, int(iteration), mark, last), record.text

    def keep(self, state: State, status: str = RUNNING) -> None:
        """Keep a state; at once where the descent goes on from it."""
        values = np.array([state.iteration, state.radius, *state.mark, *state.last, *state.tau, *state.y])
        records = [Record(self.name, values, status), Record("standing", self.search.standing())]
        self.journal.replace(self.place, records, now=status == RUNNING)


def minimise(
    search: Search,
    problem: Problem,
    y: Array,
    prior: Prior,
    accepted: Callable[[State, Model], None] | None = None,
    iterations: int = 200,
) -> tuple[Array, Prior, str]:
    """Go down from y (Q,) as `gauss_newton.minimise` does; returns the last point (Q,), the prior and the status.

    `accepted` may raise Stop.
    """
    descent = Descent(search, prior, len(y))
    known = descent.known()
    if known and known[1] != RUNNING:
        return known[0].y, replace(prior, tau=known[0].tau), known[1]
    state = known[0] if known else None
    if state is not None:
        search.history.pop()  # the model at its point is made again, and was counted
    last = [state or State(y, 0.0, prior.tau, 0)]

    def keep(state: State, model: Model) -> None:
        last[0] = state
        try:
            if accepted:
                accepted(state, model)
        finally:  # the search may end here, and be resumed with a larger budget
            descent.keep(state)

    model, prior, status = gauss_newton.minimise(problem, y, prior, state, keep, iterations)
    descent.keep(replace(last[0], y=model.y, tau=prior.tau), status)
    return model.y, prior, status
