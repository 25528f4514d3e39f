"""The keyword arguments of a fit. They have the names of the command's options; what Python alone has begins with `on_`
for what is called, or says what the option leaves out (`--no-intervals`: `intervals`).

Names of before this agreement still work and warn. With a cost of one's own some arguments mean something else.
"""

from __future__ import annotations

import warnings
from collections.abc import Callable, Mapping
from dataclasses import replace
from numbers import Integral
from typing import TYPE_CHECKING, Any, TypedDict

from clothfit.base.errors import InvalidInput
from clothfit.base.limits import duration
from clothfit.fit.options import AUTO, BUDGET, FitOptions

if TYPE_CHECKING:
    from clothfit.fit.hints import Hint
    from clothfit.objective.experiment import Targets
    from clothfit.objective.memory_needs import Needs
    from clothfit.objective.objective import Compared
    from clothfit.optimise.progress import Progress
    from clothfit.scene.scene import Scene

FIELDS = {
    "on_progress": "report", "on_hint": "hinted", "on_memory": "foreseen", "on_found": "found",
    "max_evaluations": "budget", "budget": "seconds", "rmse": "rmse_tolerance",
}  # fmt: skip
"""Arguments to the fields of `FitOptions` that have other names."""

RENAMED = {
    "report": "on_progress", "hinted": "on_hint", "foreseen": "on_memory", "found": "on_found",
    "seconds": "budget", "rmse_tolerance": "rmse",
}  # fmt: skip
"""Older names of arguments to those of now."""

RESIDUALS_METHOD, OWN_METHOD = "gauss-newton", "l-bfgs-b"
"""What `auto` means for a cost of one's own, with and without residuals."""


class OlderNames(TypedDict, total=False):
    """Arguments by their older names."""

    report: Callable[[Progress], None] | None
    hinted: Callable[[Hint], None] | None
    foreseen: Callable[[Needs], None] | None
    found: Callable[[Scene], None] | None
    seconds: float | None
    rmse_tolerance: float | None


class Keywords(OlderNames, total=False):
    """The keyword arguments of `estimate`, which says what each means, but those of its checkpoint."""

    method: str
    budget: str | float | None
    max_evaluations: int | None
    rmse: float | None
    tolerance: float | None
    on_progress: Callable[[Progress], None] | None
    objective: Compared
    loss: str
    loss_scale: float | None
    prior: float | str
    holdout: float | None
    holdout_of: str
    intervals: bool
    memory: int | str | None
    bounds: Mapping[str, tuple[float | None, float | None]] | None
    model: str | None
    substeps: int | str | None
    keep_step: bool
    windows: int | None
    fit_time: bool
    fit_placement: bool
    fit_scale: bool
    keep_markers: bool
    on_memory: Callable[[Needs], None] | None
    on_hint: Callable[[Hint], None] | None
    on_found: Callable[[Scene], None] | None


def options_of(caller: str, given: Mapping[str, Any], level: int = 3) -> FitOptions:
    """The options that keyword arguments mean, by their names or by older ones, which warn at the call that is `level`
    calls up. Raises TypeError, as Python does, for a name that there is not, or one that is given twice; InvalidInput
    for a time that is none.
    """
    named = dict(given)
    for older, name in RENAMED.items():
        if older not in named:
            continue
        value = named.pop(older)
        if named.get(name) is not None:
            raise TypeError(f"{caller}() got {name!r} twice: {older!r} is its older name")
        deprecated(f"{caller}({older}=…) is now {caller}({name}=…)", level)
        named[name] = float(value) if older == "seconds" and value is not None else value
    budget = named.get("budget")
    if isinstance(budget, Integral) and named.get("max_evaluations") is None:
        text = f"{caller}(budget={budget}) is a time on the command line; for a number of evaluations"
        deprecated(f'{text} use max_evaluations={budget}, for a time budget="{budget}s"', level)
        named |= {"max_evaluations": budget, "budget": None}
    elif isinstance(budget, str):
        named["budget"] = duration(budget, "budget")
    if named.get("max_evaluations", 0) is None:
        named["max_evaluations"] = BUDGET
    known = [name for name in Keywords.__annotations__ if name not in RENAMED]
    for name in named:
        if name not in known:
            raise TypeError(f"{caller}() got an unexpected keyword argument {name!r}")
    return FitOptions(**{FIELDS.get(name, name): value for name, value in named.items()})


def deprecated(text: str, level: int) -> None:
    """Warn of an older way to call, at the call that is `level` calls up from where it is noticed."""
    warnings.warn(text, DeprecationWarning, stacklevel=level + 1)


def settled(scene: Scene, target: Targets | None, options: FitOptions) -> tuple[Targets | None, FitOptions]:
    """The target and the options of a fit; those of one by a cost of one's own (`objective.own_cost`) as the other
    parts of a fit know them. Raises InvalidInput where an option does not go with that.
    """
    if not callable(options.objective):
        return target, options
    from clothfit.objective.own_cost import Residuals, unseen
    from clothfit.optimise.scipy_methods import METHODS
    from clothfit.scene.fit_vector import fitted_cloths

    refuse(options)
    linear = isinstance(options.objective, Residuals) and len(fitted_cloths(scene)) == 1
    method = options.method
    if method == AUTO:
        method = RESIDUALS_METHOD if linear else OWN_METHOD
    if method not in METHODS and not (linear and method == RESIDUALS_METHOD):
        needed = "Residuals of one object" if method == RESIDUALS_METHOD else "an objective of this program"
        raise InvalidInput(f"method: {method} needs {needed}; with a cost of one's own use {OWN_METHOD}")
    keep_step = options.substeps is None
    found = replace(options, method=method, intervals=options.intervals and linear, keep_step=keep_step)
    return unseen(scene) if target is None else target, found


def refuse(options: FitOptions) -> None:
    """Raise InvalidInput where an option needs to know what is compared."""
    given = {
        "holdout": options.holdout is not None, "fit_time": options.fit_time, "fit_placement": options.fit_placement,
        "fit_scale": options.fit_scale,
        "loss": options.loss != "linear", "model auto": options.model == AUTO, "windows": options.windows is not None,
        "substeps auto": options.substeps == AUTO,
    }  # fmt: skip
    for name in (name for name, is_given in given.items() if is_given):
        raise InvalidInput(f"{name}: does not go with a cost of one's own, as it needs to know what is compared")
