"""A fit by a cost of one's own (`objective.own_cost`): which of the options go with it, and what they mean there."""

from __future__ import annotations

from dataclasses import replace

from clothfit.base.errors import InvalidInput
from clothfit.fit.options import AUTO, FitOptions
from clothfit.objective.experiment import Targets
from clothfit.objective.own_cost import Residuals, unseen
from clothfit.optimise.scipy_methods import METHODS
from clothfit.scene.fit_vector import fitted_cloths
from clothfit.scene.scene import Scene

RESIDUALS_METHOD, METHOD = "gauss-newton", "l-bfgs-b"
"""What `auto` means, with and without residuals."""


def settled(scene: Scene, target: Targets | None, options: FitOptions) -> tuple[Targets | None, FitOptions]:
    """The target and the options of a fit; those by a cost of one's own as the other parts of a fit know them. Raises
    InvalidInput where an option does not go with that.
    """
    if not callable(options.objective):
        return target, options
    refuse(options)
    linear = isinstance(options.objective, Residuals) and len(fitted_cloths(scene)) == 1
    method = options.method
    if method == AUTO:
        method = RESIDUALS_METHOD if linear else METHOD
    if method not in METHODS and not (linear and method == RESIDUALS_METHOD):
        needed = "Residuals of one object" if method == RESIDUALS_METHOD else "an objective of this program"
        raise InvalidInput(f"method: {method} needs {needed}; with a cost of one's own use {METHOD}")
    keep_step = options.substeps is None
    found = replace(options, method=method, intervals=options.intervals and linear, keep_step=keep_step)
    return unseen(scene) if target is None else target, found


def refuse(options: FitOptions) -> None:
    """Raise InvalidInput where an option needs to know what is compared."""
    given = {
        "holdout": options.holdout is not None, "fit_time": options.fit_time, "fit_placement": options.fit_placement,
        "loss": options.loss != "linear", "model auto": options.model == AUTO,
        "substeps auto": options.substeps == AUTO,
    }  # fmt: skip
    for name in (name for name, is_given in given.items() if is_given):
        raise InvalidInput(f"{name}: does not go with a cost of one's own, as it needs to know what is compared")
