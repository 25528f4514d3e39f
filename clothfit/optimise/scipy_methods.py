"""SciPy's minimisers on the cost and its gradient, in the coordinates of the search; they go by SciPy's names.

R. H. Byrd, P. Lu, J. Nocedal, C. Zhu, A limited memory algorithm for bound constrained optimization, SIAM Journal on
Scientific Computing 16, 1995: `lbfgs`, which `preconditioned` and `control` use as well.
"""

from __future__ import annotations

import warnings as python_warnings
from collections.abc import Callable, Sequence
from typing import Any

from clothfit.base.arrays import Array
from clothfit.optimise.search import Search
from clothfit.optimise.status import Status

METHODS: dict[str, dict[str, Any]] = {
    "l-bfgs-b": {},
    "tnc": {"ftol": 0.0, "gtol": 0.0, "xtol": 0.0},
    "slsqp": {"ftol": 1e-30},
    "trust-constr": {"gtol": 1e-30, "xtol": 1e-12},
    "bfgs": {"gtol": 0.0},
    "cg": {"gtol": 0.0},
    "nelder-mead": {"xatol": 1e-10, "fatol": 1e-16, "adaptive": True},
    "powell": {"xtol": 1e-10, "ftol": 1e-16},
    "cobyla": {"tol": 1e-10},
}
"""SciPy's minimisers that can fit, with options that leave the end to the search: no tolerance of their own."""

FREE, WITHOUT_GRADIENT = ("bfgs", "cg"), ("nelder-mead", "powell", "cobyla")
"""Those that know no bounds, so that values are clipped to them; and those that ask for no gradient."""

RECENT = 30  # steps that L-BFGS remembers; SciPy's 10 converge about half as fast on per-vertex fits


def lbfgs(
    cost: Callable[[Array], tuple[float, Array]],
    start: Array,
    bounds: Sequence[tuple[float, float]] | None = None,
    recent: int = RECENT,
    limit: int = 10**9,
) -> None:
    """Go down from `start` (Q,) by a cost and its gradient (Q,), which raises what ends the descent; else that comes
    where a line search finds nothing better, or after `limit` evaluations. `recent`: steps that are remembered.
    """
    from scipy.optimize import minimize

    minimizer: Any = minimize  # its stubs know other starts, and options by literal names only
    options = {"maxcor": recent, "maxiter": limit, "maxfun": limit, "ftol": 0.0, "gtol": 0.0}
    minimizer(cost, start, jac=True, method="L-BFGS-B", bounds=bounds, options=options)


def minimise(search: Search, method: str) -> Status:
    """Run a minimiser until it or the search ends it; returns the status. Raises Stop."""
    from scipy import optimize

    search.enter(method)
    minimizer: Any = optimize.minimize  # its stubs know methods by literal names only
    limit = 10 * search.budget.limit + 1000  # of what ends the search by its own count
    with python_warnings.catch_warnings():
        python_warnings.simplefilter("ignore")  # the status says what SciPy's warnings would
        if method == "l-bfgs-b":
            lbfgs(search, search.y, search.bounds, limit=limit)
            return search.verdict()
        gradient, bounds = method not in WITHOUT_GRADIENT, None if method in FREE else search.bounds
        options = {"maxfun" if method == "tnc" else "maxiter": limit, **METHODS[method]}
        cost = search if gradient else lambda y: search(y)[0]
        minimizer(cost, search.y, jac=gradient, method=method, bounds=bounds, options=options)
    return search.verdict()
