"""SciPy's minimisers on the cost and its gradient, in the coordinates of the search; they go by SciPy's names."""

from __future__ import annotations

import warnings as python_warnings
from typing import Any

import numpy as np

from clothfit.base.arrays import Array
from clothfit.objective.objective import Objective
from clothfit.optimise.search import Search, cost_and_gradient
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

SHORT_EVALUATIONS, SHORT_SAVING = 40, 1e-3
"""Evaluations of a short descent, and relative reduction of the cost by a step that ends it."""


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


def short(search: Search, objective: Objective, y: Array) -> tuple[Array, Status]:
    """Some steps of L-BFGS-B down from y (Q,), on an objective that may be solved less tightly than the search's: what
    many values still gain where the model cannot reproduce the target. Returns the point and how it ended.
    """
    from scipy.optimize import minimize

    unit = max(search.measure(search.parameters(y), objective), np.finfo(float).tiny)

    def cost(y: Array) -> tuple[float, Array]:
        p = search.parameters(y)
        search.count()
        value, gradient = cost_and_gradient(objective, p)
        search.advance(p, objective.rmse(value))
        if not (np.isfinite(value) and np.isfinite(gradient).all()):
            return 1e3, np.zeros(len(y))  # the line search steps back
        by_y = gradient * search.coordinates.derivative(p)
        return value / unit, by_y[search.fitted] / unit

    found = minimize(
        cost, y, jac=True, method="L-BFGS-B", bounds=search.bounds,
        options={"maxfun": SHORT_EVALUATIONS, "maxcor": MEMORY, "ftol": SHORT_SAVING, "gtol": 0.0},
    )  # fmt: skip
    return np.asarray(found.x), Status.CONVERGED if found.status == 0 else Status.STALLED
