"""Targets whose markers, clock or place are put right: before a fit, and beside its values after it.

Markers that are swapped are exchanged, and what shows no vertex is left out (`registration.mislabelled`).

The clock, the place and the scale are sought with few values before the fit (`fit.registration`), which then
compares with the registered targets. After it they are looked at again, with one factor for each kind of value or
beside all values: what is left to go, and 95 % intervals. Near the result the cost is |r|² + 2 gᵀz + zᵀ H z in the
values and the registrations together, and the prior of the fit adds A = (σ²/τ²) P to the values of a kind. With the
values at their minimum, the step to that of all is −(H + A)⁻¹ (0, g_θ), in which they follow the registrations, and
the registrations' covariance is their block of σ² (H + A)⁻¹: what another stiffness could make up for counts as
unknown. Both are mapped to the numbers that are shown by their derivative; the step that is left is added to the half
width.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import partial

import numpy as np

from clothfit.base import interrupts
from clothfit.base.arrays import Array, Flags
from clothfit.base.errors import InvalidInput
from clothfit.fit.hierarchy import as_model
from clothfit.fit.hints import Hint
from clothfit.fit.holdout import split
from clothfit.fit.options import Request
from clothfit.fit.preparation import in_time
from clothfit.fit.registration import RATE, SPACE, THETA, TIME, Unknowns, descended, find, reweighted, sought
from clothfit.fit.result import Fit
from clothfit.motion.correspondence import SCANNED
from clothfit.motion.divergence import Diverged
from clothfit.motion.motion import at_frames
from clothfit.objective.comparison import Loss, loss_named
from clothfit.objective.experiment import Experiment, flagged_as
from clothfit.optimise.evidence import inverse, variance
from clothfit.optimise.prior import WIDEST
from clothfit.registration.free_fall import late_start
from clothfit.registration.mislabelled import mislabelled
from clothfit.registration.record import Markers, Registration
from clothfit.scene.fit_vector import parameters
from clothfit.scene.scene import Scene

BETTER = 0.99
"""Error relative to the one before below which a fit is done again with another registration."""

REFINE_SECONDS = 5.0
"""Seconds, or as long as the fit takes where that is more, that a look at all values may take."""

FEWEST = 12
"""Frames, at least, with which a registration is sought."""

SAME_FALL = (
    "gravity is fitted beside the rate of the target's clock: less of it and a slower clock look alike; fit one of them"
)

MOST = 1500
"""Values beside which this is looked for."""

NORMAL = 1.96
"""Standard deviations of a 95 % interval."""

STEP = 1e-5
"""Of the derivative by coordinates, whose 1 is a large change."""

SMALL_STEP = 0.5
"""Step relative to the half width of the interval up to which it is not worth another fit."""

STEADY = 0.1
"""Distance of a rate from 1, relative to the same, that is worth another fit where the data show no other rate than 1:
cameras keep time, and a rate that only noise moves would move the stiffnesses with it.
"""


def put_right(
    scene: Scene, given: Sequence[Experiment], options: Request
) -> tuple[list[Experiment], list[Markers] | None, list[Hint]]:
    """The targets with their mislabelled markers put right, as far as what is fitted shows them, what was wrong, if
    anything, and what is said of it.
    """
    shown = given if options.holdout is None else split(scene, given, options.holdout, options.holdout_of)[0]
    known = [
        Markers() if len(motion.correspondence.seen) or motion.correspondence.kind == SCANNED
        else mislabelled(own, motion, late=options.fit_time)
        for motion, own in shown
    ]
    hints = [
        Hint(code, f"{motion.name}: {text}; --keep-markers takes them as they are")
        for (motion, own), each in zip(given, known, strict=True) for code, text in each.sentences(own.vertex_counts)
    ]  # fmt: skip
    right = [Experiment(each.applied(e.motion), e.scene) for e, each in zip(given, known, strict=True)]
    return right, known if any(known) else None, hints


def begun(given: Sequence[Experiment]) -> tuple[list[Experiment], list[Registration] | None, list[Hint]]:
    """The targets from where their cloths begin to move, those clocks, if one begins late, and what is said of it."""
    starts = [Registration(offset=late_start(own, motion)) for motion, own in given]
    if not any(each.offset for each in starts):
        return list(given), None, []
    hints = [
        Hint("late_start", f"{motion.name}: its cloth stands still for {each.offset:.3g} s; the fit begins after that")
        for (motion, _), each in zip(given, starts, strict=True) if each.offset
    ]  # fmt: skip
    pairs = zip(given, starts, strict=True)
    return [Experiment(each.applied(e.motion, e.scene.delta), e.scene) for e, each in pairs], starts, hints


@dataclass(frozen=True)
class Refinement:
    """A look at the registrations of targets, as they came, whose coordinates (9,) that are `free` are unknown."""

    scene: Scene
    given: Sequence[Experiment]
    free: Flags
    loss: Loss
    known: Sequence[Registration]

    @classmethod
    def first(cls, scene: Scene, given: Sequence[Experiment], options: Request) -> Refinement:
        """The look before a fit. Raises InvalidInput where there is nothing to register."""
        if scene.frame:
            what = "where a target's clock or place is to be found"
            raise InvalidInput(f"frame: the axes of the scene must not move {what}")
        free = sought(options.fit_time, options.fit_placement, options.fit_scale)
        late = [
            Registration(offset=(float(motion.times[0]) + late_start(own, motion)) * options.fit_time)
            for motion, own in given
        ]
        begun = cls(scene, given, free, loss_named(options.loss, options.loss_scale), [Registration()] * len(given))
        search = partial(find, few(scene, cut(given, late, scene, scene), free, begun.loss))
        return begun.after(in_time(search, begun.known, options.time_limit))

    def after(self, known: Sequence[Registration]) -> Refinement:
        """The same from other registrations."""
        return replace(self, known=known)

    def registered(self) -> list[Experiment]:
        """The targets in the scene's time and place."""
        pairs = zip(self.given, self.known, strict=True)
        return [Experiment(known.applied(motion, own.delta), own) for (motion, own), known in pairs]

    def another(self, fit: Fit, seconds: float | None) -> Refinement | None:
        """With registrations that promise a better fit: by few values, or, where the model is right, by all of them."""
        moved = self._within(fit, seconds, self._better)
        if moved is None and fit.verdict and not fit.verdict.differs:
            moved = self._within(fit, seconds, partial(self._by_all_values, intervals=False))
        return moved

    def with_intervals(self, fit: Fit, seconds: float | None) -> Refinement:
        """With intervals beside all values of a fit, unless that takes longer than the fit."""
        return self._within(fit, seconds, partial(self._by_all_values, intervals=True)) or self

    def _within(self, fit: Fit, seconds: float | None, refine: Callable[[Fit], Refinement | None]) -> Refinement | None:
        longest = min(np.inf if seconds is None else seconds, max(fit.seconds, REFINE_SECONDS))
        with interrupts.deferred():
            return in_time(partial(refine, fit), None, longest, known=True)

    def _better(self, fit: Fit) -> Refinement | None:
        """With registrations with which few of the fitted values cost less; None where there are none such."""
        begun = few(fit.scene, cut(self.given, self.known, self.scene, fit.scene), self.free, self.loss)
        before = near = begun.at(begun.p, self.known)
        if self.free[SPACE].any():
            near = reweighted(near)
        near = descended(near.only(TIME)) if self.free[TIME].any() else near
        return self.after(near.registrations) if near.cost() < BETTER**2 * before.cost() else None

    def _by_all_values(self, fit: Fit, intervals: bool) -> Refinement | None:
        """With intervals beside all values of a fit, or where it should be then. None where the motion diverges, there
        are too many values, or another place says nothing beside the noise.
        """
        given, p = cut(self.given, self.known, self.scene, fit.scene), parameters(fit.scene)
        near, count = Unknowns(fit.scene, given, p, self.known, self.free, self.loss), len(p)
        if not 0 < count <= MOST:
            return None
        try:
            model = near.model(near.here)
        except Diverged:
            return None
        sigma = float(np.sqrt(variance(model.cost, near.residuals, 0.0))) if fit.sigma is None else fit.sigma
        if not sigma > 0:
            return None
        every = np.ix_(near.chosen, near.chosen)
        covariance, steps = prior_of(fit, sigma, len(near.chosen)), np.zeros(len(near.chosen))
        covariance[every] = C = inverse(model.H + covariance[every])
        steps[near.chosen] = -C[:, count:] @ model.g[count:]  # the values are at their minimum
        known, far = list[Registration](), intervals
        for each, place, k in zip(self.known, near.where, range(count, len(steps), THETA), strict=True):
            C, step = covariance[k : k + THETA, k : k + THETA], steps[k : k + THETA]
            ends = [[place.at(sign * STEP * e).numbers for sign in (1.0, -1.0)] for e in np.eye(THETA)]
            J = np.stack([(up - down) / (2.0 * STEP) for up, down in ends], axis=1)  # of the numbers by coordinates
            width, likely = NORMAL * sigma * np.sqrt(np.diag(J @ C @ J.T)), place.at(step)
            if keeps_time := bool(self.free[RATE] and abs(likely.rate - 1.0) <= width[RATE]):
                way = -np.log(each.rate) / place.scale[RATE] - step[RATE]  # the most likely one with that rate
                likely = replace(place.at(step + C[:, RATE] / max(C[RATE, RATE], np.finfo(float).tiny) * way), rate=1.0)
            far |= bool((np.abs(likely.numbers - each.numbers) > SMALL_STEP * width).any())
            far |= keeps_time and abs(each.rate - 1.0) > STEADY * width[RATE]
            known.append(replace(each, within=width + np.abs(J @ step)) if intervals else likely)
        return self.after(known) if far else None


def few(scene: Scene, given: Sequence[Experiment], free: Flags, loss: Loss) -> Unknowns:
    """One factor for each kind that is fitted with several values, and the targets, whose coordinates (9,) that are
    `free` are unknown as well.
    """
    main = as_model(scene, "F")
    own = [Experiment(e.motion, main if e.scene is scene else flagged_as(e.scene, main)) for e in given]
    return Unknowns(main, own, parameters(main), [Registration()] * len(own), free, loss)


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
