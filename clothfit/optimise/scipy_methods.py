"""SciPy's minimisers on the cost and its gradient, in the coordinates of the search; they go by SciPy's names."""

from __future__ import annotations

import warnings as python_warnings
from typing import Any

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

MEMORY = 30  # steps that L-BFGS-B remembers; SciPy's 10 converge about half as fast on per-vertex fits


def minimise(search: Search, method: str) -> Status:
    """Run a minimiser until it or the search ends it; returns the status. Raises Stop."""
    from scipy import optimize

    search.enter(method)
    minimizer: Any = optimize.minimize  # its stubs know methods by literal names only
    takes = METHODS[method]
    arguments: dict[str, Any] = {"method": method, "options": options(method, search.budget.limit)}
    if takes["bounds"]:
        arguments["bounds"] = search.bounds
    with python_warnings.catch_warnings():
        python_warnings.simplefilter("ignore")  # the status says what SciPy's warnings would
        minimizer(search if takes["gradient"] else search.cost, search.y, jac=takes["gradient"], **arguments)
    return search.verdict()


def options(method: str, budget: int) -> dict[str, Any]:
    """Options that leave the end to the search: no tolerance of SciPy's own, more iterations than the budget holds."""
    common: dict[str, Any] = {"maxiter": 10 * budget + 1000}
    own: dict[str, dict[str, Any]] = {
        "l-bfgs-b": {"maxfun": 10 * budget + 1000, "maxcor": MEMORY, "ftol": 0.0, "gtol": 0.0},
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
