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

METHODS = {
    "l-bfgs-b": {"gradient": True, "bounds": True},
    "tnc": {"gradient": True, "bounds": True},
    "slsqp": {"gradient": True, "bounds": True},
    "trust-constr": {"gradient": True, "bounds": True},
    "bfgs": {"gradient": True, "bounds": False},
    "cg": {"gradient": True, "bounds": False},
    "nelder-mead": {"gradient": False, "bounds": True},
    "powell": {"gradient": False, "bounds": True},
    "cobyla": {"gradient": False, "bounds": True},
}
"""SciPy's minimisers that can fit, and what they take. Without bounds of their own, values are clipped to the bounds.
"""

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
    with python_warnings.catch_warnings():
        python_warnings.simplefilter("ignore")  # the status says what SciPy's warnings would
        if method == "l-bfgs-b":
            lbfgs(search, search.y, search.bounds, limit=10 * search.budget.limit + 1000)
            return search.verdict()
        takes = METHODS[method]
        arguments: dict[str, Any] = {"method": method, "options": options(method, search.budget.limit)}
        if takes["bounds"]:
            arguments["bounds"] = search.bounds
        minimizer(search if takes["gradient"] else search.cost, search.y, jac=takes["gradient"], **arguments)
    return search.verdict()


def options(method: str, budget: int) -> dict[str, Any]:
    """Options that leave the end to the search: no tolerance of SciPy's own, more iterations than the budget holds."""
    common: dict[str, Any] = {"maxiter": 10 * budget + 1000}
    own: dict[str, dict[str, Any]] = {
        "tnc": {"maxfun": 10 * budget + 1000, "ftol": 0.0, "gtol": 0.0, "xtol": 0.0},
        "slsqp": {"ftol": 1e-30},
        "trust-constr": {"gtol": 1e-30, "xtol": 1e-12},
        "bfgs": {"gtol": 0.0},
        "cg": {"gtol": 0.0},
        "nelder-mead": {"xatol": 1e-10, "fatol": 1e-16, "adaptive": True},
        "powell": {"xtol": 1e-10, "ftol": 1e-16},
        "cobyla": {"tol": 1e-10},
    }
    if method == "tnc":
        common = {}
    return common | own[method]
