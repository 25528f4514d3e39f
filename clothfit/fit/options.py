"""The options of a fit: what `clothfit.estimate` compares, what it knows of the capture, what may change, and how long
it searches. They have the names of the command's options and settings.

This module loads no library, so that commands can build and check options before they load any.
"""

from __future__ import annotations

import math
import os
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, fields, replace
from typing import TYPE_CHECKING

from clothfit.base import memory
from clothfit.base.errors import InvalidInput
from clothfit.base.limits import FIT_TOLERANCE, checked_tolerance, duration
from clothfit.base.messages import meant
from clothfit.fit.observer import Observer
from clothfit.scene.kinds import REST

if TYPE_CHECKING:
    from clothfit.objective.experiment import Targets
    from clothfit.objective.objective import Compared
    from clothfit.optimise.checkpoint import Checkpoint
    from clothfit.scene.scene import Scene

OWN_METHODS = ("auto", "momentum", "gauss-newton")
"""The methods of this package, besides SciPy's (`scipy_methods.METHODS`)."""

HOLDOUTS = ("frames", "vertices")
"""What can be kept out: the last frames of each target, or vertices drawn at random, the same in all targets."""

AUTO = "auto"

MODELS = (AUTO, "F", "G", "R", "M", "L")
"""The models that can take the place of a scene's flags; auto: the smallest that no finer one beats."""

RMSE_TOLERANCE = 1e-8
"""Error, m, that no noise of a target is below; good enough, but for the rounding of the target's numbers where that is
more (`Objective.rounding`).
"""

MAX_EVALUATIONS = 1000

RESIDUALS_METHOD, OWN_METHOD = "gauss-newton", "l-bfgs-b"
"""What `auto` means for a cost of one's own, with and without residuals."""

SHORTEST_WINDOW = 2
"""Frames of a window, of which each shows how the cloth goes on from its start."""

LONGEST, LONGEST_KEYED = 54.0, 150.0
"""Seconds of a search for a target that no values reproduce, where the user gives no other limit: more of them gain
little there. Values over time bring a motion much nearer, and there are many of them.
"""


@dataclass(frozen=True, kw_only=True)
class ComparisonOptions:
    """What a fit compares.

    A cost of one's own as `objective` takes a `Motion` of F frames and N vertices and returns the cost, at least 0, and
    its derivative (F, N, 3) by the positions; `Residuals` let Gauss–Newton minimise it. Windows begin in the target's
    own states, its positions and the velocities of the frames around, so that what the model lacks, or chaos, does not
    add up; the error is that over the windows, and `Fit.whole` has that of the whole motion.
    """

    objective: Compared = "position"  # a quantity, several with their weights, or a cost of one's own
    loss: str = "linear"  # of a distance: linear, soft_l1 or huber
    loss_scale: float | None = None  # m, from which on a distance counts as an outlier; None: 0.01
    holdout: float | None = None  # share of the target that is kept out of the fit, to judge it by
    holdout_of: str = "frames"  # the last of which are kept out, or "vertices"
    windows: int | None = None  # frames of each window that is compared; None: the whole motion


@dataclass(frozen=True, kw_only=True)
class CaptureOptions:
    """What a fit finds out of a target besides the values; `Fit.registration` and `Fit.markers` say what that was.

    Fixed vertices that move in the target, by more than noise, follow it, and `Fit.scene` has pins for them; in windows
    they stay. Markers that are swapped are exchanged, and what shows no vertex is left out.
    """

    fit_time: bool = False  # the rate and the offset of each target's clock
    fit_placement: bool = False  # the rotation and the translation that bring it into the scene
    fit_scale: bool = False  # its scale
    hold: bool = False  # whether fixed vertices stay where they are, also where they move in the target
    keep_markers: bool = False  # whether its markers are taken as they are


@dataclass(frozen=True, kw_only=True)
class ModelOptions:
    """What may change. By Gauss–Newton the values of one kind scatter around those of a fabric, as widely as the data
    say, or as `prior` says around the start. Substeps are by the scene's integrator or by BDF2, whichever comes nearer;
    `Fit.scene` has the step with which it is to be played.
    """

    fit: str | Sequence[str] = ()  # kinds such as "wind" or "stiffness=R" in place of the scene's flags, or "auto"
    bounds: Mapping[str, tuple[float | None, float | None]] | None = None  # of kinds in their unit; None: the default
    prior: float | str = "auto"  # standard deviation of the logarithm of the values; "none"
    substeps: int | str | None = None  # time steps to a frame of the target; "auto": as many as pay; None: with BDF2
    keep_step: bool = False  # whether the scene's step and integrator stay


@dataclass(frozen=True, kw_only=True)
class SearchOptions:
    """How far a fit goes. With a `checkpoint` a fit that was killed goes on from there when `resume` is true;
    `max_evaluations` and `rmse` may differ then. Where matrices do not fit into `memory`, another method takes over,
    with a warning.
    """

    max_evaluations: int = MAX_EVALUATIONS  # of cost and gradient
    rmse: float | None = None  # m, or the objective's unit, below which it ends; None: 1e-8, or the target's rounding
    tolerance: float | None = None  # of the linear systems, relative; None: 1e-10
    intervals: bool = True  # whether 95 % intervals are found, which take about as long as a step of Gauss–Newton
    memory: int | str | None = None  # bytes, or a text such as "200MB"; None: half of what is free
    checkpoint: str | os.PathLike[str] | Checkpoint | None = None  # file in which the fit keeps its state
    resume: bool = False  # whether it goes on from there


@dataclass(frozen=True, kw_only=True)
class FitOptions(SearchOptions, ModelOptions, CaptureOptions, ComparisonOptions):
    """The options of `clothfit.estimate`: what is compared (`ComparisonOptions`), what is found out of the capture
    (`CaptureOptions`), what may change (`ModelOptions`), and how far the fit goes (`SearchOptions`).
    """

    def __post_init__(self) -> None:
        kinds = (self.fit,) if isinstance(self.fit, str) else tuple(self.fit or ())
        object.__setattr__(self, "fit", kinds)
        if AUTO in kinds and len(kinds) > 1:
            raise InvalidInput("fit: auto chooses what to fit by itself; leave the others out")

    def __repr__(self) -> str:
        given = (each for each in fields(self) if each.repr and getattr(self, each.name) != each.default)
        return f"{type(self).__name__}({', '.join(f'{each.name}={getattr(self, each.name)!r}' for each in given)})"


@dataclass(frozen=True, kw_only=True, repr=False)
class Request(FitOptions):
    """All that a fit is asked for, besides the scene, its target and its start."""

    method: str = "auto"
    model: str | None = None  # one of `MODELS` in place of the scene's flags
    time_limit: float | None = None  # s, for the search and the intervals; None: no limit
    observer: Observer = field(default_factory=Observer, compare=False)

    @property
    def auto(self) -> bool:
        """Whether the fit chooses the kinds by itself."""
        return self.fit == (AUTO,)

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
        if self.time_limit is not None and not self.time_limit > 0:
            raise InvalidInput(f"time_limit must be a time above 0; {self.time_limit:g} s was given")

    @property
    def registers(self) -> bool:
        """Whether the clock or the place of targets is found."""
        return self.fit_time or self.fit_placement or self.fit_scale

    def checked(self) -> Request:
        """The same with the tolerance and the bytes that None stands for. Raises InvalidInput."""
        from clothfit.objective.comparison import loss_named

        self.check()
        loss_named(self.loss, self.loss_scale)
        tolerance = checked_tolerance(self.tolerance, FIT_TOLERANCE)
        return replace(self, tolerance=tolerance, memory=memory.budget(self.memory))

    def within(self, rounding: float) -> Request:
        """The same with an error that is good enough: where nobody asks for another, `RMSE_TOLERANCE`, but no less than
        what the `rounding` of the target's numbers leaves.
        """
        return self if self.rmse is not None else replace(self, rmse=max(RMSE_TOLERANCE, rounding))

    @property
    def rmse_tolerance(self) -> float:
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
            **({"fit": list(self.fit)} if self.fit else {}),
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


def requested(
    options: FitOptions, *, method: str = AUTO, model: str | None = None, time_limit: str | float | None = None,
    observer: Observer | None = None,
) -> Request:
    """All that a fit is asked for. Raises InvalidInput for a time that is none."""
    if not isinstance(options, FitOptions):
        raise InvalidInput(f"options: FitOptions are needed, not a {type(options).__name__}")
    own = {each.name: getattr(options, each.name) for each in fields(FitOptions)}
    seconds = duration(time_limit, "time_limit") if isinstance(time_limit, str) else time_limit
    watching = Observer() if observer is None else observer
    return Request(**own, method=method, model=model, time_limit=seconds, observer=watching)


def resolved(scene: Scene, target: Targets | None, options: Request) -> tuple[Targets | None, Request]:
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


def at_rest(options: Request) -> Request:
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


def refuse(options: Request) -> None:
    """Raise InvalidInput where an option needs to know what is compared."""
    given = {
        "holdout": options.holdout is not None, "fit_time": options.fit_time, "fit_placement": options.fit_placement,
        "fit_scale": options.fit_scale,
        "loss": options.loss != "linear", "model auto": options.model == AUTO, "windows": options.windows is not None,
        "substeps auto": options.substeps == AUTO,
    }  # fmt: skip
    for name in (name for name, is_given in given.items() if is_given):
        raise InvalidInput(f"{name}: does not go with a cost of one's own, as it needs to know what is compared")
