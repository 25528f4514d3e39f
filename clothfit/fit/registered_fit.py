"""A fit of targets whose clock or place is found with its values (`registration`).

The registration is sought before the fit, which then compares with the registered target. Where the fitted values leave
room for a better registration, the fit is done again with that, and kept if its error is smaller.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import partial

import numpy as np

from clothfit.base import interrupts, threads
from clothfit.base.errors import InvalidInput
from clothfit.fit.options import FitOptions
from clothfit.fit.result import Fit
from clothfit.motion.motion import at_frames
from clothfit.motion.rounding import rounding
from clothfit.objective.experiment import Experiment, Targets, experiments
from clothfit.objective.loss import loss_named
from clothfit.optimise.status import Status
from clothfit.registration.record import Registration
from clothfit.registration.search import Wanted, better, find
from clothfit.scene.scene import Scene

BETTER, ROUNDS = 0.99, 2
"""Error relative to the one before below which a fit is done again with another registration, and how often."""

FEWEST = 12
"""Frames, at least, with which a registration is sought."""

SHORTEST = 1e-3
"""Seconds that a fit is given at least."""

SAME_FALL = (
    "gravity is fitted beside the rate of the target's clock: less of it and a slower clock look alike; fit one of them"
)

FitOf = Callable[[Scene, Targets, FitOptions], Fit]
"""A fit of a scene to targets that are registered."""


def registered_fit(scene: Scene, target: Targets | None, options: FitOptions, fit: FitOf) -> Fit:
    """The fit of a scene to targets whose clock or place is found with its values. Raises what `fit` does."""
    if target is None:
        raise InvalidInput("the clock and the place of a target can be found only where one is given; give a target")
    if scene.frame:
        raise InvalidInput("frame: the axes of the scene must not move where a target's clock or place is to be found")
    began, left = interrupts.now(), options.seconds
    given = experiments(scene, target)
    if options.objective == "position":  # turned positions show no rounding
        options = options.within(max(rounding(each.motion) for each in given))
    wanted = Wanted(options.fit_time, options.fit_placement, loss_named(options.loss, options.loss_scale))
    first = [Registration(offset=float(each.motion.times[0]) if options.fit_time else 0.0) for each in given]
    best = in_time(partial(find, scene, cut(given, first), wanted), left) or [Registration()] * len(given)
    plain = replace(options, fit_time=False, fit_placement=False)
    found = fitted(scene, given, best, replace(plain, seconds=rest(left, began)), fit)
    again = replace(plain, foreseen=None, hinted=None, found=None, checkpoint=None, resume=False)
    for _ in range(ROUNDS):
        remaining = rest(left, began)
        if found.status in (Status.INTERRUPTED, Status.DIVERGED) or remaining == SHORTEST:
            break
        own = [Experiment(e.motion, found.scene if e.scene is scene else e.scene) for e in cut(given, best)]
        with interrupts.deferred():
            next_best = in_time(partial(better, found.scene, own, wanted, best, BETTER**2), remaining, found)
        if next_best is None:
            break
        other = fitted(scene, given, next_best, replace(again, seconds=rest(left, began)), fit)
        if not other.rmse < found.rmse:
            break
        best, found = next_best, replace(other, hints=[*(hint for hint in found.hints if hint.early), *other.hints])
    if options.fit_time and scene.mode("gravity") != "n":
        found = replace(found, warnings=[*found.warnings, SAME_FALL])
    return found


def rest(seconds: float | None, began: float) -> float | None:
    """The seconds that are left."""
    return None if seconds is None else max(seconds - (interrupts.now() - began), SHORTEST)


def in_time(
    look: Callable[[], list[Registration] | None], seconds: float | None, result: Fit | None = None
) -> list[Registration] | None:
    """What `look` finds; None where the time, or a request after there is a `result`, ends it."""
    try:
        with threads.single(), interrupts.heard(), interrupts.limited(seconds):
            return look()
    except KeyboardInterrupt:
        if result is None:
            raise
        interrupts.request()
        interrupts.answer()
    except interrupts.OutOfTime:
        pass
    return None


def fitted(
    scene: Scene, given: Sequence[Experiment], registrations: list[Registration], options: FitOptions, fit: FitOf
) -> Fit:
    """The fit to registered targets."""
    pairs = zip(given, registrations, strict=True)
    targets = [(known.applied(motion, own.delta), own) for (motion, own), known in pairs]
    return replace(fit(scene, targets, options), registration=registrations)


def cut(given: Sequence[Experiment], known: Sequence[Registration]) -> list[Experiment]:
    """The targets with only those of their frames that a fit compares with these registrations."""
    return [compared(each, own) for each, own in zip(given, known, strict=True)]


def compared(given: Experiment, known: Registration) -> Experiment:
    """The target with only those of its frames that a fit compares with this registration."""
    motion, scene = given
    count = int(np.searchsorted(known.times(motion.times), (scene.frames - 0.5) * scene.delta))
    return Experiment(at_frames(motion, slice(max(count, min(FEWEST, len(motion.times))))), scene)
