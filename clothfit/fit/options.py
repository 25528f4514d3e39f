"""The options of a fit: everything that `clothfit.estimate` takes besides the scene, its target and its start.

They have the names of the command's options; what Python alone has begins with `on_` for what is called, or says what
the option leaves out (`--no-intervals`: `intervals`). With a cost of one's own some of them mean something else.

This module loads no library, so that commands can build and check options before they load any.
"""

from __future__ import annotations

import math
import os
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any, TypedDict

from clothfit.base import memory
from clothfit.base.errors import InvalidInput
from clothfit.base.limits import FIT_TOLERANCE, checked_tolerance, duration
from clothfit.base.messages import meant
from clothfit.scene.kinds import REST

if TYPE_CHECKING:
    from clothfit.fit.hints import Hint
    from clothfit.objective.experiment import Targets
    from clothfit.objective.memory_needs import Needs
    from clothfit.objective.objective import Compared
    from clothfit.optimise.checkpoint import Checkpoint
    from clothfit.optimise.progress import Progress
    from clothfit.scene.scene import Scene

OWN_METHODS = ("auto", "momentum", "gauss-newton")
"""The methods of this package, besides SciPy's (`scipy_methods.METHODS`)."""

HOLDOUTS = ("frames", "vertices")
"""What can be kept out: the last frames of each target, or vertices drawn at random, the same in all targets."""

AUTO = "auto"

MODELS = (AUTO, "F", "G", "R", "M", "L")
"""The models that can take the place of a scene's flags; auto: the smallest that no finer one beats."""

RMSE_TOLERANCE = 1e-8  # m; the rounding of the target's numbers where that is more (`Objective.rounding`)
BUDGET = 1000  # evaluations

RESIDUALS_METHOD, OWN_METHOD = "gauss-newton", "l-bfgs-b"
"""What `auto` means for a cost of one's own, with and without residuals."""

SHORTEST_WINDOW = 2
"""Frames of a window, of which each shows how the cloth goes on from its start."""

LONGEST, LONGEST_OVER_TIME = 54.0, 150.0
"""Seconds of a search for a target that no values reproduce, where the user gives no other limit: more of them gain
little there. Values over time bring a motion much nearer, and there are many of them.
"""


@dataclass(frozen=True)
class FitOptions:
    """The options of one fit; `clothfit.estimate` says what each means."""

    method: str = "auto"
    max_evaluations: int = BUDGET  # of cost and gradient
    rmse: float | None = None  # m, with another objective in the unit of that; None: as `within` says
    tolerance: float | None = None  # of the linear systems, relative; None: `FIT_TOLERANCE`
    on_progress: Callable[[Progress], None] | None = None
    objective: Compared = "position"
    loss: str = "linear"
    loss_scale: float | None = None  # m
    prior: float | str = "auto"
    checkpoint: str | os.PathLike[str] | Checkpoint | None = None
    resume: bool = False
    holdout: float | None = None  # fraction
    holdout_of: str = "frames"
    intervals: bool = True
    memory: int | str | None = None  # bytes, or as "200MB"; None: half of what is free
    on_memory: Callable[[Needs], None] | None = None
    on_hint: Callable[[Hint], None] | None = None  # called with each hint that comes before the fit
    budget: float | None = None  # s, for the search and the intervals; None: no limit
    on_found: Callable[[Scene], None] | None = None
    bounds: Mapping[str, tuple[float | None, float | None]] | None = None  # of kinds, by name, in their units
    model: str | None = None  # one of `MODELS` in place of the scene's flags
    substeps: int | str | None = None  # steps to a frame of the target, or "auto"; None: auto for scenes with BDF2
    keep_step: bool = False  # whether the scene keeps its step
    windows: int | None = None  # frames of each window that begins in the target's own states; None: the whole motion
    fit_time: bool = False  # whether the rate and the offset of each target's clock are found
    fit_placement: bool = False  # whether each target's place is found: a rotation and a translation
    fit_scale: bool = False  # whether each target's scale is found
    fit: tuple[str, ...] = ()  # kinds to fit in place of the scene's flags, such as "wind" or "stiffness=R"
    auto: bool = False  # whether the fit chooses the kinds by itself; so it does where the scene says so, and not `fit`
    hold: bool = False  # whether held vertices stay where they are, also where they move in the target
    keep_markers: bool = False  # whether mistaken markers of targets are left as they are

    def check(self) -> None:
        """Raise InvalidInput when a value is not possible."""
        check_method(self.method)
        if self.holdout_of not in HOLDOUTS:
            asked = f"there is nothing called {self.holdout_of!r} to keep out"
            raise InvalidInput(f"holdout: {asked}; use {' or '.join(HOLDOUTS)}")
        if self.holdout is not None and not 0 < self.holdout < 1:
            raise InvalidInput(f"holdout must be a fraction above 0 and below 1; {self.holdout:g} was given")
        self.prior_width()
        if self.bounds:
            from clothfit.scene.bounds import from_user

            from_user(self.bounds)
        if self.max_evaluations < 1:
            raise InvalidInput(f"max_evaluations: {self.max_evaluations} evaluations are too few, at least 1 is needed")
        if self.model is not None and self.model not in MODELS:
            raise InvalidInput(f"model: there is no {self.model!r}; use {', '.join(MODELS)}{meant(self.model, MODELS)}")
        count = self.substeps
        if not (count is None or count == AUTO or (isinstance(count, int) and count >= 1)):
            raise InvalidInput(f"substeps must be auto or a whole number from 1 on; {count} was given")
        if self.windows is not None and self.windows < SHORTEST_WINDOW:
            raise InvalidInput(f"windows must have {SHORTEST_WINDOW} frames or more; {self.windows} was given")
        if self.windows is not None and self.registers:
            raise InvalidInput("windows: they begin in the target's own states, whose clock and place must be known")
        if self.keep_step and count is not None:
            raise InvalidInput("substeps: the step is to be kept; use either substeps or keep_step")
        if self.budget is not None and not self.budget > 0:
            raise InvalidInput(f"budget must be a time above 0; {self.budget:g} s was given")

    @property
    def registers(self) -> bool:
        """Whether the clock or the place of targets is found."""
        return self.fit_time or self.fit_placement or self.fit_scale

    def checked(self) -> FitOptions:
        """The same with the tolerance and the bytes that None stands for. Raises InvalidInput."""
        self.check()
        tolerance = checked_tolerance(self.tolerance, FIT_TOLERANCE)
        return replace(self, tolerance=tolerance, memory=memory.budget(self.memory))

    def within(self, rounding: float) -> FitOptions:
        """The same with an error that is good enough: where nobody asks for another, `RMSE_TOLERANCE`, but no less than
        what the `rounding` of the target's numbers leaves.
        """
        return self if self.rmse is not None else replace(self, rmse=max(RMSE_TOLERANCE, rounding))

    @property
    def enough(self) -> float:
        """The error that is good enough, m."""
        return RMSE_TOLERANCE if self.rmse is None else self.rmse

    def prior_width(self) -> float | None:
        """The width τ of the prior: "auto" learns it (None), "none" or 0 leaves it out (inf). Raises InvalidInput."""
        if self.prior == "auto":
            return None
        try:
            width = math.inf if self.prior in ("none", 0) else float(self.prior)
        except ValueError:
            width = math.nan
        if not width > 0:
            given = f"{self.prior!r} was given"
            raise InvalidInput(f"prior must be auto, none or a width in log parameters above 0; {given}")
        return width

    @property
    def identity(self) -> dict[str, object]:
        """What must be the same for a fit to be resumed."""
        return {
            "method": self.method, "prior": self.prior, "tolerance": self.tolerance, "holdout": self.holdout,
            "of": self.holdout_of, "objective": self.objective, "loss": self.loss, "loss_scale": self.loss_scale,
            "model": self.model, "substeps": self.substeps, "keep_step": self.keep_step,
            **({"windows": self.windows} if self.windows else {}),
            **({"hold": True} if self.hold else {}),
            **({"fit": list(self.fit), "auto": self.auto} if self.fit or self.auto else {}),
            **({"bounds": dict(self.bounds)} if self.bounds else {}),
        }  # fmt: skip


def check_method(method: str) -> None:
    """Raise InvalidInput when there is no such method."""
    if method in OWN_METHODS:
        return
    from clothfit.optimise.scipy_methods import METHODS

    if method not in METHODS:
        known = (*OWN_METHODS, *METHODS)
        raise InvalidInput(f"method: there is no {method!r}; use {', '.join(known)}{meant(method, known)}")


class Keywords(TypedDict, total=False):
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
    hold: bool
    fit: str | Sequence[str] | None
    on_memory: Callable[[Needs], None] | None
    on_hint: Callable[[Hint], None] | None
    on_found: Callable[[Scene], None] | None


def options_of(caller: str, given: Mapping[str, Any]) -> FitOptions:
    """The options that keyword arguments mean. Raises TypeError, as Python does, for a name that there is not;
    InvalidInput for a time that is none.
    """
    for name in given:
        if name not in Keywords.__annotations__:
            raise TypeError(f"{caller}() got an unexpected keyword argument {name!r}")
    named = dict(given)
    if isinstance(named.get("budget"), str):
        named["budget"] = duration(named["budget"], "budget")
    if named.get("max_evaluations", 0) is None:
        named["max_evaluations"] = BUDGET
    named |= asked_fit(named.pop("fit", None))
    return FitOptions(**named)


def asked_fit(given: str | Sequence[str] | None) -> dict[str, Any]:
    """The options `fit` and `auto` that kinds to fit, or "auto", mean. Raises InvalidInput where both are given."""
    asked = (given,) if isinstance(given, str) else tuple(given or ())
    if AUTO in asked and len(asked) > 1:
        raise InvalidInput("fit: auto chooses what to fit by itself; leave the others out")
    return {"fit": () if AUTO in asked else asked, "auto": AUTO in asked}


def settled(scene: Scene, target: Targets | None, options: FitOptions) -> tuple[Targets | None, FitOptions]:
    """The target and the options of a fit; those of one by a cost of one's own (`objective.own_cost`) as the other
    parts of a fit know them. Raises InvalidInput where an option does not go with that.
    """
    if scene.method == REST:
        options = at_rest(options)
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


def at_rest(options: FitOptions) -> FitOptions:
    """Those of a fit to shapes at rest, which have no time. Raises InvalidInput where an option asks for one."""
    given = {
        "substeps": options.substeps is not None, "windows": options.windows is not None, "fit_time": options.fit_time,
        "fit_placement": options.fit_placement, "fit_scale": options.fit_scale, "fit auto": options.auto,
        "model auto": options.model == AUTO,
        "holdout of frames": bool(options.holdout) and options.holdout_of == HOLDOUTS[0],
        "method momentum": options.method == "momentum",
    }  # fmt: skip
    for name in (name for name, is_given in given.items() if is_given):
        raise InvalidInput(f"{name}: is for motions; this scene is at rest (integrationMethod 4)")
    method = "gauss-newton" if options.method == AUTO else options.method
    return replace(options, method=method, keep_step=True, keep_markers=True, hold=True)


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
