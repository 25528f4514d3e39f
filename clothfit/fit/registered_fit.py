"""A fit of targets whose clock or place is found with its values (`registration`).

The registration is sought before the fit, which then compares with the registered target. Where the fitted values leave
room for a better registration, few of them (`search.better`) or all (`joint`), the fit is done again with
that, and kept unless its error is larger. With all of them clocks have the rate 1 where the data show no other.

Before all else markers are looked at (`registration.mistaken`): those that are swapped are exchanged, and what shows no
vertex is left out.

Clock, place and scale beside all the values of the fit (`joint`): what is left to go, and 95 % intervals. Near the
result the cost is |r|² + 2 gᵀz + zᵀ H z in the values and the registrations together, and the prior of the fit adds
A = (σ²/τ²) P to the values of a kind. With the values at their minimum, the step to that of all is −(H + A)⁻¹ (0, g_θ),
in which they follow the registrations, and the registrations' covariance is their block of σ² (H + A)⁻¹: what another
stiffness could make up for counts as unknown. Both are mapped to the numbers that are shown by their derivative; the
step that is left is added to the half width.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import NamedTuple

import numpy as np

from clothfit.base import interrupts
from clothfit.base.arrays import Array, Flags
from clothfit.base.errors import InvalidInput
from clothfit.fit.hints import Hint
from clothfit.fit.holdout import split
from clothfit.fit.options import FitOptions
from clothfit.fit.preparation import in_time
from clothfit.fit.result import Fit
from clothfit.motion.degrade import rounding
from clothfit.motion.divergence import Diverged
from clothfit.motion.motion import at_frames
from clothfit.objective.comparison import Loss, loss_named
from clothfit.objective.experiment import Experiment, Targets, experiments
from clothfit.optimise.coordinates import Coordinates
from clothfit.optimise.evidence import inverse, variance
from clothfit.optimise.prior import WIDEST
from clothfit.optimise.progress import Progress
from clothfit.optimise.status import Status
from clothfit.registration.mistaken import mistaken
from clothfit.registration.record import Registration
from clothfit.registration.residuals import RATE, THETA, Around, Registered, Sums, around
from clothfit.registration.search import better, find, sought
from clothfit.scene.fit_vector import parameters
from clothfit.scene.scene import Scene

BETTER, ROUNDS = 0.99, 2
"""Error relative to the one before below which a fit is done again with another registration, and how often."""

ALIKE = 1.002
"""Error relative to the one before up to which the fit with the better registration is kept: the values that both leave
open differ by more.
"""

MOMENT = 5.0
"""Seconds, or as long as the fit takes where that is more, that a look at all values may take."""

FEWEST = 12
"""Frames, at least, with which a registration is sought."""

SHORTEST = 1e-3
"""Seconds that a fit is given at least."""

SAME_FALL = (
    "gravity is fitted beside the rate of the target's clock: less of it and a slower clock look alike; fit one of them"
)

TOLERANCE = 1e-5
"""Of the linear systems: intervals and steps need no better."""

MOST = 1500
"""Values beside which this is looked for."""

NORMAL = 1.96
"""Standard deviations of a 95 % interval."""

STEP = 1e-5
"""Of the derivative by coordinates, whose 1 is a large change."""

SETTLED = 0.5
"""Step relative to the half width of the interval up to which it is not worth another fit."""

STEADY = 0.1
"""Distance of a rate from 1, relative to the same, that is worth another fit where the data show no other rate than 1:
cameras keep time, and a rate that only noise moves would move the stiffnesses with it.
"""

FitOf = Callable[[Scene, Targets, FitOptions], Fit]
"""A fit of a scene to targets that are registered."""


def registered_fit(scene: Scene, target: Targets | None, options: FitOptions, fit: FitOf) -> Fit:
    """The fit of a scene to targets whose clock or place is found with its values. Raises what `fit` does."""
    if target is None:
        raise InvalidInput("the clock and the place of a target can be found only where one is given; give a target")
    if scene.frame:
        raise InvalidInput("frame: the axes of the scene must not move where a target's clock or place is to be found")
    began, given = interrupts.now(), experiments(scene, target)
    if options.objective == "position":  # turned positions show no rounding
        options = options.within(max(rounding(each.motion) for each in given))
    loss = loss_named(options.loss, options.loss_scale)
    free = sought(options.fit_time, options.fit_placement, options.fit_scale)
    first = [Registration(offset=float(each.motion.times[0]) if options.fit_time else 0.0) for each in given]
    look = Look(scene, given, free, loss, options.budget, began)
    best = in_time(partial(find, scene, cut(given, first), free, loss), [Registration()] * len(given), options.budget)
    plain = replace(options, fit_time=False, fit_placement=False, fit_scale=False)
    fit = Fits(fit)
    found = fitted(scene, given, best, replace(plain, budget=look.remaining), fit)
    again = replace(plain, on_memory=None, on_hint=None, on_found=None, checkpoint=None, resume=False)
    for _ in range(ROUNDS):
        if found.status in (Status.INTERRUPTED, Status.DIVERGED) or look.remaining == SHORTEST:
            break
        with interrupts.deferred():
            next_best = look.another(found, best)
        if next_best is None:
            break
        other = fitted(scene, given, next_best, replace(again, budget=look.remaining), fit)
        if not other.rmse < ALIKE * found.rmse:
            break
        best, found = next_best, replace(other, hints=[*(hint for hint in found.hints if hint.early), *other.hints])
    if options.intervals and found.status not in (Status.INTERRUPTED, Status.DIVERGED):
        with interrupts.deferred():
            known = look.joint(found, best)
        found = found if known is None else replace(found, registration=known.known)
    if options.fit_time and scene.mode("gravity") != "n":
        found = replace(found, warnings=[*found.warnings, SAME_FALL])
    return replace(found, evaluations=fit.evaluations, seconds=fit.seconds)


class Fits:
    """Fits one after the other, whose progress goes on from that of those before."""

    def __init__(self, fit: FitOf) -> None:
        """None yet, each by `fit`."""
        self.fit, self.evaluations, self.seconds, self.iterations = fit, 0, 0.0, 0
        self.cost = self.rmse = np.inf  # of the best of them

    def __call__(self, scene: Scene, target: Targets, options: FitOptions) -> Fit:
        """The next one."""
        show, evaluations, seconds, iterations = options.on_progress, self.evaluations, self.seconds, self.iterations

        def report(progress: Progress) -> None:
            self.iterations = iterations + progress.iteration
            if progress.cost < self.cost:
                self.cost, self.rmse = progress.cost, progress.rmse
            if show is not None:
                show(replace(
                    progress, evaluations=evaluations + progress.evaluations, budget=evaluations + progress.budget,
                    seconds=seconds + progress.seconds, iteration=self.iterations, cost=self.cost, rmse=self.rmse,
                ))  # fmt: skip

        found = self.fit(scene, target, options if show is None else replace(options, on_progress=report))
        self.evaluations, self.seconds = evaluations + found.evaluations, seconds + found.seconds
        return found


@dataclass(frozen=True)
class Look:
    """What fits of a scene leave of registrations of its targets."""

    scene: Scene
    given: Sequence[Experiment]
    free: Flags  # (9,), which of their coordinates are sought
    loss: Loss
    seconds: float | None  # that all has, from `began` on
    began: float

    @property
    def remaining(self) -> float | None:
        """The seconds that are left; None: no limit."""
        return None if self.seconds is None else max(self.seconds - (interrupts.now() - self.began), SHORTEST)

    def own(self, found: Fit, known: list[Registration]) -> list[Experiment]:
        """The targets, with the fitted scene."""
        pairs = cut(self.given, known)
        return [Experiment(e.motion, found.scene if e.scene is self.scene else e.scene) for e in pairs]

    def another(self, found: Fit, known: list[Registration]) -> list[Registration] | None:
        """Registrations that promise a better fit: by few values, or, where the model is right, by all of them."""
        look = partial(better, found.scene, self.own(found, known), self.free, self.loss, known, BETTER**2)
        by_few = in_time(look, None, self.remaining, known=True)
        if by_few is not None or found.verdict is None or found.verdict.differs:
            return by_few
        by_all = self.joint(found, known)
        return None if by_all is None else by_all.moved

    def joint(self, found: Fit, known: list[Registration]) -> Joint | None:
        """The registrations beside all values of the fit; None where that takes longer than the fit."""
        remaining, longest = self.remaining, max(found.seconds, MOMENT)
        look = partial(joint, found, self.own(found, known), known, self.free, self.loss)
        return in_time(look, None, longest if remaining is None else min(remaining, longest), known=True)


def marked_fit(scene: Scene, target: Targets, options: FitOptions, fit: FitOf) -> Fit:
    """The fit of a scene to targets whose mistaken markers are put right, as far as what is fitted shows them. Raises
    what `fit` does.
    """
    given = experiments(scene, target)
    shown = given if options.holdout is None else split(scene, given, options.holdout, options.holdout_of)[0]
    known = [mistaken(own, motion, late=options.fit_time) for motion, own in shown]
    hints = [
        Hint(code, f"{motion.name}: {text}; --keep-markers takes them as they are")
        for (motion, own), each in zip(given, known, strict=True) for code, text in each.sentences(own.vertex_counts)
    ]  # fmt: skip
    if options.on_hint:
        for hint in hints:
            options.on_hint(hint)
    pairs = [(each.applied(e.motion), e) for e, each in zip(given, known, strict=True)]
    targets = [motion if e.scene is scene else (motion, e.scene) for motion, e in pairs]
    found = fit(scene, targets if any(known) else target, replace(options, keep_markers=True))
    return replace(found, hints=[*hints, *found.hints], markers=known if any(known) else None)


def fitted(
    scene: Scene, given: Sequence[Experiment], registrations: list[Registration], options: FitOptions, fit: FitOf
) -> Fit:
    """The fit to registered targets."""
    pairs = zip(given, registrations, strict=True)
    targets = [(known.applied(motion, own.delta), own) for (motion, own), known in pairs]
    return replace(fit(scene, targets, options), registration=registrations)


def cut(given: Sequence[Experiment], known: Sequence[Registration]) -> list[Experiment]:
    """The targets with only those of their frames that a fit compares with these registrations."""
    found = []
    for (motion, scene), own in zip(given, known, strict=True):
        count = int(np.searchsorted(own.times(motion.times), (scene.frames - 0.5) * scene.delta))
        found.append(Experiment(at_frames(motion, slice(max(count, min(FEWEST, len(motion.times))))), scene))
    return found


class Joint(NamedTuple):
    """What is known of the registrations of a fit."""

    known: list[Registration]  # as they were, with intervals
    moved: list[Registration] | None  # where the step leads; None where that says nothing beside the noise


def joint(
    fit: Fit, given: Sequence[Experiment], known: Sequence[Registration], free: Flags, loss: Loss
) -> Joint | None:
    """The registrations with the intervals of those coordinates (9,) that are `free`, and where they should be beside
    the values of a fit to the targets `given`, as they came. None where the motion diverges, or there are too many
    values.
    """
    scene, sigma = fit.scene, fit.sigma
    p = parameters(scene)
    if not 0 < len(p) <= MOST:
        return None
    where = [around(own, each.motion) for own, each in zip(known, given, strict=True)]
    registered = Registered(scene, given, loss, TOLERANCE, summing=True)
    try:
        sums = registered.sums(p, where, np.zeros((len(given), THETA)), Coordinates(scene, p).change(p))
    except Diverged:
        return None
    residuals = 3 * sum(int(each.motion.seen().sum()) for each in given)
    sigma = float(np.sqrt(variance(sums.cost, residuals, 0.0))) if sigma is None else sigma
    if not sigma > 0:
        return None
    covariance, step = solved(fit, sums, np.tile(free, len(given)), sigma)
    found, moved, far = [], [], False
    for k, (each, near) in enumerate(zip(known, where, strict=True)):
        own = slice(len(p) + THETA * k, len(p) + THETA * (k + 1))
        ends = [[near.at(sign * STEP * e).numbers for sign in (1.0, -1.0)] for e in np.eye(THETA)]
        J, by = np.stack([(up - down) / (2.0 * STEP) for up, down in ends], axis=1), step[own]  # by coordinates
        width, away = NORMAL * sigma * np.sqrt(np.diag(J @ covariance[own, own] @ J.T)), np.abs(J @ by)
        found.append(replace(each, within=width + away))
        most_likely = near.at(by)
        keeps_time = free[RATE] and abs(most_likely.rate - 1.0) <= width[RATE]
        moved.append(with_rate_1(near, by, covariance[own, own], J) if keeps_time else most_likely)
        far |= bool((np.abs(moved[-1].numbers - each.numbers) > SETTLED * width).any())
        far |= bool(keeps_time and abs(each.rate - 1.0) > STEADY * width[RATE])
    return Joint(found, moved if far else None)


def with_rate_1(near: Around, step: Array, covariance: Array, J: Array) -> Registration:
    """The most likely registration with a clock of rate 1, from the `step` (9,) to the most likely one, their
    covariance (9, 9) and the derivative J (9, 9) of its numbers.
    """
    if not covariance[RATE, RATE] > 0:
        return replace(near.at(step), rate=1.0)
    way = (1.0 - near.at(np.zeros(THETA)).rate) / J[RATE, RATE] - step[RATE]
    return replace(near.at(step + covariance[:, RATE] / covariance[RATE, RATE] * way), rate=1.0)


def solved(fit: Fit, sums: Sums, free: Flags, sigma: float) -> tuple[Array, Array]:
    """(H + A)⁻¹ (Q, Q) on the values and the `free` of the 9 K other coordinates, and the step (Q,)."""
    H, count = sums.H.copy(), len(sums.g) - len(free)
    taus = {(each.object, each.name): each.tau for each in fit.prior or []}
    for block in fit.scene.blocks:
        tau = taus.get((block.cloth, block.name), WIDEST if block.mode == "L" and block.kind.log else None)
        if tau is not None:
            H[block.part, block.part] += (sigma / tau) ** 2 * (np.eye(block.count) - 1.0 / block.count)
    chosen = np.concatenate([np.ones(count, bool), free]) & (np.diag(H) > 0)
    scale, every = 1.0 / np.sqrt(np.diag(H)[chosen]), np.ix_(chosen, chosen)
    covariance = np.zeros_like(H)
    covariance[every] = inverse(H[every] * np.outer(scale, scale)) * np.outer(scale, scale)
    return covariance, -covariance @ np.concatenate([np.zeros(count), sums.g[count:]])
