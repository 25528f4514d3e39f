"""The methods of a fit by their names, and how a search by one of them ends."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from clothfit.base import interrupts, threads
from clothfit.base.arrays import Array
from clothfit.base.errors import InvalidInput
from clothfit.fit.auto import by_momentum, find, one_value_each
from clothfit.fit.trajectory_fit import by_gauss_newton, go_on, resumed_prior
from clothfit.optimise import momentum
from clothfit.optimise.scipy_methods import METHODS, minimise
from clothfit.optimise.search import Search
from clothfit.optimise.status import Status, Stop


def run(
    search: Search, method: str, start: Array, others: Callable[[], list[Array]] | None, tau: float | None
) -> Status:
    """Search by a method until it or the user ends it; returns the status. A fit that had ended is not repeated."""
    state = search.resumed
    if state is not None and state.status in (Status.CONVERGED, Status.STALLED):
        if len(state.centre):
            search.best.believe(resumed_prior(search, state, tau))
        return state.status
    try:
        with threads.single(), interrupts.heard():
            status = found_by(search, method, start, others, tau)
    except Stop as stop:
        status = stop.status
    except KeyboardInterrupt:
        if not np.isfinite(search.best.cost):
            raise  # there is no result yet
        status = Status.INTERRUPTED
    return search.finish(status)


def found_by(
    search: Search, method: str, start: Array, others: Callable[[], list[Array]] | None, tau: float | None
) -> Status:
    """Search by a method; returns the status. Raises Stop."""
    if not search.fitted.any():
        search(search.y)
        return search.verdict()
    if method in METHODS:
        return minimise(search, method)
    if method == "momentum":
        if not momentum.fits(search.objective):
            raise InvalidInput("memory: too little for the balance of momentum; use another method, or allow more")
        by_momentum(search, start)
        return search.verdict()
    state = search.resumed
    if state is not None and len(state.before) and not one_value_each(search):
        return go_on(search, state, tau)
    if method == "gauss-newton":
        return by_gauss_newton(search, start, start, tau)
    return find(search, start, others, tau)
