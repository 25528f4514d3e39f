"""The clock and the place of targets, found with few values of the scene.

Gauss–Newton on both together goes over the first third of the frames, then over all. It begins with what the target
shows by itself: the clock by the free fall of its first frames, the place by its first frame, where that is the scene's
start. Residuals are weighted: few values are wrong in late frames first, and never at what is held; else a cloth that
hangs lower than it should would move the whole target, and one that is too stiff would make its clock late. Weights
follow what is left, for some rounds, at last with a factor for each family and region. From fitted values (`better`)
the clock is the one with the lowest cost.

The values of a scene and the registrations of its targets are one vector z, which Gauss–Newton moves together: a
stiffer cloth and a faster clock look alike, so neither can be found without the other. Few values suffice for that, one
factor for each kind that is fitted.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from clothfit.base.arrays import Array, Flags
from clothfit.motion.divergence import Diverged
from clothfit.motion.foreign import apart
from clothfit.objective.comparison import Loss
from clothfit.objective.experiment import Experiment, flagged_as
from clothfit.optimise import gauss_newton
from clothfit.optimise.coordinates import Coordinates
from clothfit.optimise.prior import none
from clothfit.registration.free_fall import other_fall
from clothfit.registration.record import Registration, rigid, scale_between
from clothfit.registration.residuals import PLACE, SCALE, SPACE, THETA, TIME, Around, Parts, Registered, Sums, around
from clothfit.scene.fit_vector import parameters, with_parameters
from clothfit.scene.scene import Scene

FIRST_FRAMES, FEWEST = 3, 12
"""The first so many parts of the frames, and frames at least, on which all starts are tried."""

SHORT, ROUNDS = 8, 4
"""Iterations on these, and with one set of weights; and how many sets there are at most."""

FINER = 16
"""Values, at most, with which registrations are sought: each takes a sensitivity of its own."""

QUICK = 50_000
"""Positions of a motion, at most, for which that takes seconds."""

SETTLED = 1e-3
"""Change of a registration's coordinates, each relative to a large one, that ends the rounds."""

RIGID = 0.2
"""The largest part of a first frame's distance from the start that may be left when it is moved and turned."""

FLOOR, TINY = 1e-2, 1e-24
"""Error relative to that of all frames below which frames count alike; m², what squares that are 0 count as."""

TOLERANCE = 1e-8
"""Of the linear systems, relative."""


SLOWEST, LATEST = 5.0, 0.5
"""The largest change of a rate or a scale, a factor, and of an offset, relative to the target's duration."""

LEAST = 1e-3
"""A descent ends where a step would save less than this part of the cost."""


@dataclass(frozen=True, eq=False)
class Found:
    """Where a descent ended."""

    cost: float
    p: Array  # (P,)
    registrations: list[Registration]


@dataclass(frozen=True, eq=False)
class Unknowns:
    """Values and registrations as one vector z: of values log p, or p / σ, then θ of each target."""

    registered: Registered
    start: Array  # (P,)
    where: Sequence[Around]
    free: Flags  # (9,), which coordinates of a registration are sought

    @cached_property
    def coordinates(self) -> Coordinates:
        """Of the values."""
        return Coordinates(self.registered.main, self.start)

    @property
    def chosen(self) -> Flags:
        """Which of all P + 9 K coordinates are in z."""
        return np.concatenate([np.ones(len(self.start), bool), np.tile(self.free, len(self.where))])

    @property
    def begin(self) -> Array:
        """z at the start."""
        plain = self.coordinates.y(self.start) / self.coordinates.weight
        return np.asarray(np.concatenate([plain, np.zeros(THETA * len(self.where))])[self.chosen])

    @property
    def bounds(self) -> tuple[Array, Array]:
        """Ends of z."""
        ends = []
        for sign, end in zip((-1.0, 1.0), (self.coordinates.lower, self.coordinates.upper), strict=True):
            theta = [sign * farthest(each) / near.scale
                     for each, near in zip(self.registered.given, self.where, strict=True)]  # fmt: skip
            ends.append(np.concatenate([end / self.coordinates.weight, *theta])[self.chosen])
        return ends[0], ends[1]

    def split(self, z: Array) -> tuple[Array, Array]:
        """The values (P,), and θ (K, 9)."""
        whole = np.zeros(len(self.chosen))
        whole[self.chosen] = z
        p = self.coordinates.p(whole[: len(self.start)] * self.coordinates.weight)
        return p, whole[len(self.start) :].reshape(-1, THETA)

    def model(self, z: Array) -> gauss_newton.Model:
        """The cost near z. Raises Diverged."""
        return self.model_of(z, self.sums(z))

    def sums(self, z: Array) -> Sums:
        """The cost near z with its parts. Raises Diverged."""
        p, theta = self.split(z)
        return self.registered.sums(p, self.where, theta, self.coordinates.change(p))

    def model_of(self, z: Array, found: Sums) -> gauss_newton.Model:
        """What was found near z as a model."""
        own = self.chosen
        return gauss_newton.Model(z, found.cost, found.H[np.ix_(own, own)], found.g[own])

    def cost(self, z: Array) -> float:
        """The cost at z; infinite where the simulation diverges."""
        p, theta = self.split(z)
        try:
            cost = self.registered.sums(p, self.where, theta).cost
        except Diverged:
            return np.inf
        return cost if np.isfinite(cost) else np.inf


def farthest(given: Experiment) -> Array:
    """The largest changes (9,) of a registration's coordinates."""
    factor, duration = np.log(SLOWEST), float(np.ptp(given.motion.times)) or 1.0
    return np.array([factor, LATEST * duration, *[np.pi] * 3, *[np.inf] * 3, factor])


def with_few_values(scene: Scene, mode: str = "F") -> Scene:
    """The scene with one factor for each kind that is fitted with several values; or, of another `mode`, "R", one for
    each family and region.
    """
    cloths = []
    for cloth in scene.cloths:
        letters = "".join(letter if letter in "nG" else mode for letter in cloth.settings)
        fits = {kind: letter if letter in "nG" else "F" for kind, letter in cloth.fits.items()}
        if cloth.fits.get("velocity", "n") != "G":
            fits.pop("velocity", None)
        cloths.append(replace(cloth, settings=letters, fits=fits))
    return replace(scene, cloths=tuple(cloths))


def sought(time: bool, placement: bool, scale: bool = False) -> Flags:
    """Which coordinates (9,) of a registration are sought where its clock, its place or its scale is."""
    free = np.zeros(THETA, bool)
    free[TIME], free[PLACE], free[SCALE] = time, placement, scale
    return free


def first_guesses(given: Experiment, free: Flags) -> list[Registration]:
    """What the target shows by itself of the coordinates (9,) that are `free`: its place and size, where its first
    frame is the start, and its clock, where it falls.
    """
    motion, scene = given
    place, first = Registration(), float(motion.times[0])
    seen = motion.seen()[0]
    start, points = np.concatenate([cloth.positions for cloth in scene.cloths])[seen], motion.positions[0][seen]
    if free[SPACE].any() and len(points) >= 3:
        c = 1.0 / scale_between(points, start) if free[SCALE] else 1.0
        R, d = rigid(c * points, start) if free[PLACE].any() else (np.eye(3), np.zeros(3))
        if apart(c * points @ R.T + d, start) < RIGID * apart(points, start):
            place = Registration(rotation=R, translation=d, scale=c)
    if not free[TIME].any():
        return [place]
    begun = replace(place, offset=first).applied(motion, scene.delta)
    fall = other_fall(scene, begun)
    clocks = [(1.0, 0.0), (1.0, first)] if fall is None else [(fall.rate, first)]
    return [replace(place, rate=rate, offset=offset) for rate, offset in dict.fromkeys(clocks)]


def find(scene: Scene, given: Sequence[Experiment], free: Flags, loss: Loss) -> list[Registration]:
    """The registration of each target in the coordinates (9,) that are `free`, with few of the scene's values beside
    it; none where nothing lowers the cost.
    """
    whole = Stage.of(scene, given, free, loss)
    guesses = [first_guesses(each, free) for each in given]
    tries = []
    for i in range(max(map(len, guesses))):
        alike = [each[min(i, len(each) - 1)] for each in guesses]
        tries.append(whole.early().only(TIME).descended(whole.start, alike, SHORT))
    known = [each for each in tries if each is not None]
    if not known:
        return whole.unmoved
    found = whole.settled(min(known, key=lambda each: each.cost))
    if (finer := whole.finer(scene, found)) is not None:
        return finer
    values = whole.only(slice(0)).descended(found.p, found.registrations, SHORT)
    return found.registrations if values and values.cost < whole.cost(whole.start, whole.unmoved) else whole.unmoved


def better(
    scene: Scene, given: Sequence[Experiment], free: Flags, loss: Loss, known: list[Registration], least: float
) -> list[Registration] | None:
    """Registrations with which the scene's values, and one factor for each kind, cost less than the part `least` of
    what they cost with those that are `known`; None where there are none such.
    """
    stage = Stage.of(scene, given, free, loss)
    before = stage.cost(stage.start, known)
    found = stage.placed(Found(before, stage.start, known))
    if free[TIME].any():
        found = stage.only(TIME).descended(found.p, found.registrations, SHORT) or found
    return found.registrations if stage.cost(found.p, found.registrations) < least * before else None


@dataclass(frozen=True, eq=False)
class Stage:
    """Targets, and which coordinates (9,) of their registrations are sought."""

    registered: Registered
    free: Flags

    @classmethod
    def of(cls, scene: Scene, given: Sequence[Experiment], free: Flags, loss: Loss, mode: str = "F") -> Stage:
        """All frames of the targets, with the few values of the scene, one factor or those of another `mode`."""
        few = with_few_values(scene, mode)
        own = [Experiment(e.motion, few if e.scene is scene else flagged_as(e.scene, few)) for e in given]
        return cls(Registered(few, own, loss, TOLERANCE), free)

    @property
    def start(self) -> Array:
        """The scene's values (P,)."""
        return parameters(self.registered.main)

    def finer(self, scene: Scene, found: Found) -> list[Registration] | None:
        """Where the registrations settle with a factor for each family and region of the values of a scene, from what
        is found with one; None where these are no more, or too many, or cost no less.
        """
        near = with_parameters(self.registered.main, found.p)
        cloths = [replace(own, settings=each.settings, fits=each.fits)
                  for own, each in zip(near.cloths, scene.cloths, strict=True)]  # fmt: skip
        begun, main = replace(near, cloths=tuple(cloths)), self.registered.main
        given = [Experiment(e.motion, begun if e.scene is main else e.scene) for e in self.registered.given]
        stage = Stage.of(begun, given, self.free, self.registered.loss, "R")
        size = scene.frames * sum(scene.vertex_counts)
        if not len(self.start) < len(stage.start) <= FINER or size > QUICK:
            return None
        better = stage.settled(Found(found.cost, stage.start, found.registrations))
        lower = stage.cost(better.p, better.registrations) < self.cost(self.start, self.unmoved)
        return better.registrations if lower else None

    def early(self) -> Stage:
        """The same over the first frames."""
        frames = max(len(each.motion.times) for each in self.registered.given)
        return replace(self, registered=replace(self.registered, frames=max(frames // FIRST_FRAMES, FEWEST)))

    def only(self, part: slice) -> Stage:
        """The same with some coordinates alone."""
        free = np.zeros(THETA, bool)
        free[part] = self.free[part]
        return replace(self, free=free)

    @property
    def unmoved(self) -> list[Registration]:
        """No other clock and no other place of any target."""
        return [Registration()] * len(self.registered.given)

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
        own = Unknowns(self.registered, p, self.near(registrations), self.free)
        begin, frames = own.begin, self.registered.frames
        residuals = 3 * sum(int(each.motion.seen()[:frames].sum()) for each in self.registered.given)
        problem = gauss_newton.Problem(own.model, own.cost, *own.bounds, residuals, least=LEAST)
        try:
            model, _, _ = gauss_newton.minimise(problem, begin, none(len(begin)), iterations=iterations)
        except Diverged:
            return None
        p, theta = own.split(model.y)
        return Found(model.cost, p, [near.at(each) for near, each in zip(own.where, theta, strict=True)])

    def settled(self, found: Found) -> Found:
        """Where the registrations settle with weights that follow what is left."""
        found = self.placed(found)
        for _ in range(ROUNDS):
            try:
                near = self.weighted(found).descended(found.p, found.registrations, SHORT)
            except Diverged:
                return found
            if near is None:
                return found
            pairs = zip(self.near(found.registrations), near.registrations, strict=True)
            settled = all(np.abs(where.of(each)).max() <= SETTLED for where, each in pairs)
            found = near
            if settled:
                break
        return found

    def weighted(self, found: Found | None = None) -> Stage:
        """The same with weights (`trust_in`) from what is left at a point, or at the start. Raises Diverged."""
        p, registrations = (self.start, self.unmoved) if found is None else (found.p, found.registrations)
        return replace(self, registered=replace(self.registered, trust=trust_in(self.sums(p, registrations).parts)))

    def placed(self, found: Found) -> Found:
        """A better place, if places are sought, from residuals weighted by what can be known (`trust_in`)."""
        if not self.free[SPACE].any():
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
