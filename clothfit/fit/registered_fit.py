"""Targets whose markers, clock or place are put right: before a fit, and beside its values after it.

Markers that are swapped are exchanged, and what shows no vertex is left out (`registration.mistaken`).

The clock, the place and the scale are sought with few values before the fit (`registration.search`), which then
compares with the registered targets. After it they are looked at again, with one factor for each kind of value
(`better`) or beside all values (`joint`): what is left to go, and 95 % intervals. Near the result the cost is
|r|² + 2 gᵀz + zᵀ H z in the values and the registrations together, and the prior of the fit adds A = (σ²/τ²) P to the
values of a kind. With the values at their minimum, the step to that of all is −(H + A)⁻¹ (0, g_θ), in which they follow
the registrations, and the registrations' covariance is their block of σ² (H + A)⁻¹: what another stiffness could make
up for counts as unknown. Both are mapped to the numbers that are shown by their derivative; the step that is left is
added to the half width.
"""

from __future__ import annotations

from collections.abc import Sequence
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
from clothfit.motion.divergence import Diverged
from clothfit.motion.motion import at_frames
from clothfit.objective.comparison import Loss, loss_named
from clothfit.objective.experiment import Experiment
from clothfit.optimise.evidence import inverse, variance
from clothfit.optimise.prior import WIDEST
from clothfit.registration.mistaken import mistaken
from clothfit.registration.record import Markers, Registration
from clothfit.registration.residuals import RATE, SPACE, THETA, TIME, Around
from clothfit.registration.search import Unknowns, few, find, sought
from clothfit.scene.scene import Scene

BETTER = 0.99
"""Error relative to the one before below which a fit is done again with another registration."""

MOMENT = 5.0
"""Seconds, or as long as the fit takes where that is more, that a look at all values may take."""

FEWEST = 12
"""Frames, at least, with which a registration is sought."""

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


def put_right(
    scene: Scene, given: Sequence[Experiment], options: FitOptions
) -> tuple[list[Experiment], list[Markers] | None, list[Hint]]:
    """The targets with their mistaken markers put right, as far as what is fitted shows them, what was wrong, if
    anything, and what is said of it.
    """
    shown = given if options.holdout is None else split(scene, given, options.holdout, options.holdout_of)[0]
    known = [mistaken(own, motion, late=options.fit_time) for motion, own in shown]
    hints = [
        Hint(code, f"{motion.name}: {text}; --keep-markers takes them as they are")
        for (motion, own), each in zip(given, known, strict=True) for code, text in each.sentences(own.vertex_counts)
    ]  # fmt: skip
    right = [Experiment(each.applied(e.motion), e.scene) for e, each in zip(given, known, strict=True)]
    return right, known if any(known) else None, hints


@dataclass(frozen=True)
class Look:
    """A look at the registrations of targets, as they came, whose coordinates (9,) that are `free` are unknown."""

    scene: Scene
    given: Sequence[Experiment]
    free: Flags
    loss: Loss
    known: Sequence[Registration]

    @classmethod
    def first(cls, scene: Scene, given: Sequence[Experiment], options: FitOptions) -> Look:
        """The look before a fit. Raises InvalidInput where there is nothing to register."""
        if scene.frame:
            what = "where a target's clock or place is to be found"
            raise InvalidInput(f"frame: the axes of the scene must not move {what}")
        free = sought(options.fit_time, options.fit_placement, options.fit_scale)
        late = [Registration(offset=float(each.motion.times[0]) * options.fit_time) for each in given]
        begun = cls(scene, given, free, loss_named(options.loss, options.loss_scale), [Registration()] * len(given))
        search = partial(find, scene, cut(given, late, scene, scene), free, begun.loss)
        return begun.after(in_time(search, begun.known, options.budget))

    def after(self, known: Sequence[Registration]) -> Look:
        """The same from other registrations."""
        return replace(self, known=known)

    def registered(self) -> list[Experiment]:
        """The targets in the scene's time and place."""
        pairs = zip(self.given, self.known, strict=True)
        return [Experiment(known.applied(motion, own.delta), own) for (motion, own), known in pairs]

    def another(self, found: Fit, seconds: float | None) -> Look | None:
        """With registrations that promise a better fit: by few values, or, where the model is right, by all of them."""
        with interrupts.deferred():
            moved = in_time(partial(self.better, found), None, seconds, known=True)
            if moved is None and found.verdict is not None and not found.verdict.differs:
                by_all = self.beside(found, seconds)
                moved = by_all and by_all.moved
        return None if moved is None else self.after(moved)

    def with_intervals(self, found: Fit, seconds: float | None) -> Look:
        """With intervals beside all values, where they are found in time."""
        with interrupts.deferred():
            by_all = self.beside(found, seconds)
        return self if by_all is None else self.after(by_all.known)

    def better(self, found: Fit) -> list[Registration] | None:
        """Registrations with which few of the fitted values cost less; None where there are none such."""
        begun = few(found.scene, cut(self.given, self.known, self.scene, found.scene), self.free, self.loss)
        before = near = begun.at(begun.p, self.known)
        if self.free[SPACE].any():
            near = near.settled()
        near = near.only(TIME).descended() if self.free[TIME].any() else near
        return list(near.registrations) if near.cost() < BETTER**2 * before.cost() else None

    def beside(self, found: Fit, seconds: float | None) -> Joint | None:
        """The registrations beside all values of the fit; None where that takes longer than the fit."""
        longest = max(found.seconds, MOMENT) if seconds is None else min(seconds, max(found.seconds, MOMENT))
        return in_time(partial(self.joint, found), None, longest, known=True)

    def joint(self, found: Fit) -> Joint | None:
        """The registrations with their intervals, and where they should be beside the values of the fit. None where
        the motion diverges, or there are too many values.
        """
        given = cut(self.given, self.known, self.scene, found.scene)
        begun = Unknowns.of(found.scene, given, self.free, self.loss, TOLERANCE)
        near = begun.at(begun.p, self.known)
        if not 0 < len(near.p) <= MOST:
            return None
        try:
            model = near.model(near.here)
        except Diverged:
            return None
        sigma = float(np.sqrt(variance(model.cost, near.residuals, 0.0))) if found.sigma is None else found.sigma
        if not sigma > 0:
            return None
        H, g = np.zeros((2, len(near.chosen), len(near.chosen)))
        H[np.ix_(near.chosen, near.chosen)], g[0, near.chosen] = model.H, model.g
        g[0, : len(near.p)] = 0.0  # the values are at their minimum
        covariance = covariance_of(H + prior_of(found, sigma, len(H)))
        step, known, moved, far = -covariance @ g[0], list[Registration](), list[Registration](), False
        for k, (each, place) in enumerate(zip(self.known, near.where, strict=True)):
            own = slice(len(near.p) + THETA * k, len(near.p) + THETA * (k + 1))
            ends = [[place.at(sign * STEP * e).numbers for sign in (1.0, -1.0)] for e in np.eye(THETA)]
            J, by = np.stack([(up - down) / (2.0 * STEP) for up, down in ends], axis=1), step[own]  # by coordinates
            width, away = NORMAL * sigma * np.sqrt(np.diag(J @ covariance[own, own] @ J.T)), np.abs(J @ by)
            known.append(replace(each, within=width + away))
            most_likely = place.at(by)
            keeps_time = self.free[RATE] and abs(most_likely.rate - 1.0) <= width[RATE]
            moved.append(with_rate_1(place, by, covariance[own, own], J) if keeps_time else most_likely)
            far |= bool((np.abs(moved[-1].numbers - each.numbers) > SETTLED * width).any())
            far |= bool(keeps_time and abs(each.rate - 1.0) > STEADY * width[RATE])
        return Joint(known, moved if far else None)


def cut(
    given: Sequence[Experiment], known: Sequence[Registration], scene: Scene, fitted: Scene
) -> list[Experiment]:
    """The targets, as they came, with only those of their frames that a fit compares with these registrations, and with
    the `fitted` scene in place of `scene`.
    """
    found = []
    for (motion, own), each in zip(given, known, strict=True):
        count = int(np.searchsorted(each.times(motion.times), (own.frames - 0.5) * own.delta))
        seen = at_frames(motion, slice(max(count, min(FEWEST, len(motion.times)))))
        found.append(Experiment(seen, fitted if own is scene else own))
    return found


class Joint(NamedTuple):
    """What is known of the registrations of a fit."""

    known: list[Registration]  # as they were, with intervals
    moved: list[Registration] | None  # where the step leads; None where that says nothing beside the noise


def with_rate_1(near: Around, step: Array, covariance: Array, J: Array) -> Registration:
    """The most likely registration with a clock of rate 1, from the `step` (9,) to the most likely one, their
    covariance (9, 9) and the derivative J (9, 9) of its numbers.
    """
    if not covariance[RATE, RATE] > 0:
        return replace(near.at(step), rate=1.0)
    way = (1.0 - near.at(np.zeros(THETA)).rate) / J[RATE, RATE] - step[RATE]
    return replace(near.at(step + covariance[:, RATE] / covariance[RATE, RATE] * way), rate=1.0)


def prior_of(fit: Fit, sigma: float, size: int) -> Array:
    """A (Q, Q), what the prior of a fit adds to the normal equations of so many unknowns, of which its values are the
    first.
    """
    A = np.zeros((size, size))
    taus = {(each.object, each.name): each.tau for each in fit.prior or []}
    for block in fit.scene.blocks:
        tau = taus.get((block.cloth, block.name), WIDEST if block.mode == "L" and block.kind.log else None)
        if tau is not None:
            A[block.part, block.part] = (sigma / tau) ** 2 * (np.eye(block.count) - 1.0 / block.count)
    return A


def covariance_of(H: Array) -> Array:
    """H⁻¹ (Q, Q) of those unknowns that H shows; 0 of the others."""
    shown = np.diag(H) > 0
    scale, every = 1.0 / np.sqrt(np.diag(H)[shown]), np.ix_(shown, shown)
    covariance = np.zeros_like(H)
    covariance[every] = inverse(H[every] * np.outer(scale, scale)) * np.outer(scale, scale)
    return covariance
