"""The clock and the place of targets, found with few values of the scene.

Gauss–Newton on both together goes over the first third of the frames, then over all. It begins with what the target
shows by itself: the clock by the free fall of its first frames, the place by its first frame, where that is the scene's
start. Places are found from weighted residuals: a model that differs is wrong in its late frames first, and never at
what is held; else a cloth that hangs lower than it should would move the whole target. The clock is the one with the
lowest cost.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from clothfit.base.arrays import Array, Flags
from clothfit.motion.alignment import apart
from clothfit.motion.divergence import Diverged
from clothfit.objective.experiment import Experiment, flagged_as
from clothfit.objective.loss import Loss
from clothfit.registration.free_fall import other_fall
from clothfit.registration.record import Registration, rigid
from clothfit.registration.residuals import PLACE, THETA, TIME, Around, Parts, Registered, Sums, around
from clothfit.registration.unknowns import Found, Unknowns, with_few_values
from clothfit.scene.fit_vector import parameters
from clothfit.scene.scene import Scene

FIRST_FRAMES, FEWEST = 3, 12
"""The first so many parts of the frames, and frames at least, on which all starts are tried."""

SHORT, LONG = 8, 25
"""Iterations on these, and on all frames."""

RIGID = 0.2
"""The largest part of a first frame's distance from the start that may be left when it is moved and turned."""

FLOOR, TINY = 1e-2, 1e-24
"""Error relative to that of all frames below which frames count alike; m², what squares that are 0 count as."""

TOLERANCE = 1e-8
"""Of the linear systems, relative."""


@dataclass(frozen=True)
class Wanted:
    """What of registrations is sought, and how residuals count."""

    time: bool  # rate and offset
    placement: bool  # rotation and translation
    loss: Loss

    @property
    def free(self) -> Flags:
        """Which coordinates (8,) are sought."""
        free = np.zeros(THETA, bool)
        free[TIME], free[PLACE] = self.time, self.placement
        return free


def first_guesses(given: Experiment, wanted: Wanted) -> list[Registration]:
    """What the target shows by itself: its place, where its first frame is the start, and its clock, where it falls."""
    motion, scene = given
    place, first = Registration(), float(motion.times[0])
    seen = motion.seen()[0]
    start, points = np.concatenate([cloth.positions for cloth in scene.cloths])[seen], motion.positions[0][seen]
    if wanted.placement and len(points) >= 3:
        R, d = rigid(points, start)
        if apart(points @ R.T + d, start) < RIGID * apart(points, start):
            place = Registration(rotation=R, translation=d)
    if not wanted.time:
        return [place]
    begun = replace(place, offset=first).applied(motion, scene.delta)
    fall = other_fall(scene, begun)
    clocks = [(1.0, 0.0), (1.0, first)] if fall is None else [(fall.rate, first)]
    return [replace(place, rate=rate, offset=offset) for rate, offset in dict.fromkeys(clocks)]


def find(scene: Scene, given: Sequence[Experiment], wanted: Wanted) -> list[Registration]:
    """The registration of each target, with few of the scene's values beside it; none where nothing lowers the cost."""
    whole, unmoved = Stage.of(scene, given, wanted), [Registration()] * len(given)
    guesses = [first_guesses(each, wanted) for each in given]
    tries = []
    for i in range(max(map(len, guesses))):
        alike = [each[min(i, len(each) - 1)] for each in guesses]
        tries.append(whole.early().only(TIME).descended(whole.start, alike, SHORT))
    known = [each for each in tries if each is not None]
    if not known:
        return unmoved
    found = whole.refined(min(known, key=lambda each: each.cost), LONG)
    lower = whole.cost(found.p, found.registrations) < whole.cost(whole.start, unmoved)
    return found.registrations if lower else unmoved


def better(
    scene: Scene, given: Sequence[Experiment], wanted: Wanted, known: list[Registration], least: float
) -> list[Registration] | None:
    """Registrations with which the scene's values, and one factor for each kind, cost less than the part `least` of
    what they cost with those that are `known`; None where there are none such.
    """
    stage = Stage.of(scene, given, wanted)
    before = stage.cost(stage.start, known)
    found = stage.refined(Found(before, stage.start, known), SHORT)
    return found.registrations if stage.cost(found.p, found.registrations) < least * before else None


@dataclass(frozen=True, eq=False)
class Stage:
    """Targets, and which coordinates (8,) of their registrations are sought."""

    registered: Registered
    free: Flags

    @classmethod
    def of(cls, scene: Scene, given: Sequence[Experiment], wanted: Wanted) -> Stage:
        """All frames of the targets, with the few values of the scene."""
        few = with_few_values(scene)
        own = [Experiment(e.motion, few if e.scene is scene else flagged_as(e.scene, few)) for e in given]
        return cls(Registered(few, own, wanted.loss, TOLERANCE), wanted.free)

    @property
    def start(self) -> Array:
        """The scene's values (P,)."""
        return parameters(self.registered.main)

    def early(self) -> Stage:
        """The same over the first frames."""
        frames = max(len(each.motion.times) for each in self.registered.given)
        return replace(self, registered=self.registered.first(max(frames // FIRST_FRAMES, FEWEST)))

    def only(self, part: slice) -> Stage:
        """The same with some coordinates alone."""
        free = np.zeros(THETA, bool)
        free[part] = self.free[part]
        return replace(self, free=free)

    def near(self, registrations: Sequence[Registration]) -> list[Around]:
        """The registrations around these."""
        return [around(own, each.motion) for own, each in zip(registrations, self.registered.given, strict=True)]

    def sums(self, p: Array, registrations: Sequence[Registration]) -> Sums:
        """What is left with these values and registrations. Raises Diverged."""
        return self.registered.sums(p, self.near(registrations), np.zeros((len(registrations), THETA)))

    def cost(self, p: Array, registrations: Sequence[Registration]) -> float:
        """The cost; infinite where the simulation diverges."""
        try:
            return self.sums(p, registrations).cost
        except Diverged:
            return np.inf

    def descended(self, p: Array, registrations: Sequence[Registration], iterations: int) -> Found | None:
        """Where Gauss–Newton ends; None where the simulation diverges at its start."""
        unknowns = Unknowns(self.registered, p, self.near(registrations), self.free)
        try:
            return unknowns.descended(iterations)
        except Diverged:
            return None

    def refined(self, found: Found, iterations: int) -> Found:
        """Better places, then a better clock, as far as they are sought."""
        found = self.placed(found)
        if self.free[TIME].any():
            found = self.only(TIME).descended(found.p, found.registrations, iterations) or found
        return found

    def weighted(self, found: Found | None = None) -> Stage:
        """The same with weights (`trust_in`) from what is left at a point, or at the start. Raises Diverged."""
        unmoved = [Registration()] * len(self.registered.given)
        p, registrations = (self.start, unmoved) if found is None else (found.p, found.registrations)
        return replace(self, registered=replace(self.registered, trust=trust_in(self.sums(p, registrations).parts)))

    def placed(self, found: Found) -> Found:
        """A better place, if places are sought, from residuals weighted by what can be known (`trust_in`)."""
        if not self.free[PLACE].any():
            return found
        for stage in (self.early(), self):
            try:
                weighted = stage.weighted(found)
            except Diverged:
                return found
            found = weighted.descended(found.p, found.registrations, SHORT) or found
        return found


def trust_in(parts: Sequence[Parts]) -> tuple[Array, ...]:
    """The weights (F, 2) of each frame's free vertices, and of all held ones, by how near they are: a model that
    differs is wrong in its late frames first, and never at what is held.
    """
    weights = []
    for each in parts:
        known = np.where(np.isfinite(each.mean), each.mean, 0.0)
        count = np.maximum(np.isfinite(each.mean).sum(axis=0), 1)
        held, floor = known[:, 1].sum() / count[1], FLOOR**2 * float(known[:, 0].sum() / count[0])
        weights.append(1.0 / np.maximum(np.stack([known[:, 0], np.full(len(known), held)], axis=1), max(floor, TINY)))
    return tuple(weights)
