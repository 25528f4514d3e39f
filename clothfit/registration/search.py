"""Values of a scene and registrations of its targets, which Gauss–Newton moves together; and where these begin.

A stiffer cloth and a faster clock look alike, so neither can be found without the other: they are one vector z. Few
values suffice to begin with, one factor for each kind that is fitted (`find`); a fit has all of them (`fit`).

The beginning is what the target shows by itself: the clock by the free fall of its first frames, the place by its first
frame, where that is the scene's start. The clock follows over the first third of the frames, then everything over all.
Residuals are weighted by what is left (`trust_in`): few values are wrong in late frames first, and never at what is
held; else a cloth that hangs lower than it should would move the whole target, and one that is too stiff would make its
clock late.
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
from clothfit.registration.residuals import OFFSET, PLACE, SCALE, SPACE, THETA, TIME, Around, Registered, around
from clothfit.scene.fit_vector import parameters
from clothfit.scene.scene import Scene

EARLY, FEWEST = 3, 12
"""The first so many parts of the frames, and frames at least, that show a clock before all of them do."""

ITERATIONS, ROUNDS = 8, 4
"""Iterations with one set of weights, and how many sets there are at most over all frames."""

RIGID = 0.2
"""The largest part of a first frame's distance from the start that may be left when it is moved and turned."""

FLOOR, TINY = 1e-2, 1e-24
"""Error relative to that of all frames below which frames count alike; m², what squares that are 0 count as."""

TOLERANCE = 1e-8
"""Of the linear systems, relative."""

FARTHEST = np.array([np.log(5.0), 0.5, *[np.pi] * 3, *[np.inf] * 3, np.log(5.0)])
"""Changes (9,) of the logarithm of a rate, of an offset, relative to the target's duration, of a place and of the
logarithm of a scale that a search may make.
"""

LEAST = 1e-3
"""A descent ends where a step would save less than this part of the cost."""


@dataclass(frozen=True, eq=False)
class Unknowns:
    """Values and registrations, and the cost around them by the vector z: of values log p, or p / σ, then the θ of each
    target.
    """

    registered: Registered
    p: Array  # (P,)
    registrations: Sequence[Registration]
    free: Flags  # (9,), which coordinates of a registration are unknown

    @classmethod
    def of(
        cls, scene: Scene, given: Sequence[Experiment], free: Flags, loss: Loss, tolerance: float = TOLERANCE
    ) -> Unknowns:
        """The values of a scene, and targets whose clock and place are the scene's."""
        registered = Registered(scene, given, loss, tolerance)
        return cls(registered, parameters(scene), [Registration()] * len(given), free)

    def at(self, p: Array, registrations: Sequence[Registration]) -> Unknowns:
        """The same around another point."""
        return replace(self, p=p, registrations=registrations)

    def only(self, part: slice) -> Unknowns:
        """The same with some coordinates of registrations alone."""
        free = np.zeros(THETA, bool)
        free[part] = self.free[part]
        return replace(self, free=free)

    @property
    def early(self) -> Unknowns:
        """The same over the first frames."""
        frames = max(len(each.motion.times) for each in self.registered.given)
        return replace(self, registered=replace(self.registered, frames=max(frames // EARLY, FEWEST)))

    @property
    def weighted(self) -> Unknowns:
        """The same with weights from what is left here. Raises Diverged."""
        squares = self.registered.sums(self.p, self.where, np.zeros((len(self.where), THETA))).squares
        return replace(self, registered=replace(self.registered, weights=[trust_in(each) for each in squares]))

    @cached_property
    def where(self) -> list[Around]:
        """The registrations around those here."""
        return [around(own, each.motion) for own, each in zip(self.registrations, self.registered.given, strict=True)]

    @cached_property
    def coordinates(self) -> Coordinates:
        """Of the values."""
        return Coordinates(self.registered.main, self.p)

    @property
    def chosen(self) -> Flags:
        """Which of all P + 9 K coordinates are in z."""
        return np.concatenate([np.ones(len(self.p), bool), np.tile(self.free, len(self.where))])

    @property
    def here(self) -> Array:
        """z of this point."""
        plain = self.coordinates.y(self.p) / self.coordinates.weight
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
        p = self.coordinates.p(whole[: len(self.p)] * self.coordinates.weight)
        return p, whole[len(self.p) :].reshape(-1, THETA)

    def model(self, z: Array) -> gauss_newton.Model:
        """The cost near z. Raises Diverged."""
        p, theta = self.split(z)
        found, own = self.registered.sums(p, self.where, theta, self.coordinates.change(p)), self.chosen
        return gauss_newton.Model(z, found.cost, found.H[np.ix_(own, own)], found.g[own])

    def cost(self, z: Array | None = None) -> float:
        """The cost at z, or here; infinite where the simulation diverges."""
        p, theta = self.split(self.here if z is None else z)
        try:
            cost = self.registered.sums(p, self.where, theta).cost
        except Diverged:
            return np.inf
        return cost if np.isfinite(cost) else np.inf

    @property
    def residuals(self) -> int:
        """How many there are."""
        return 3 * sum(int(each.motion.seen()[: self.registered.frames].sum()) for each in self.registered.given)

    def descended(self, iterations: int = ITERATIONS) -> Unknowns:
        """Where Gauss–Newton ends; here where the simulation diverges."""
        here = self.here
        problem = gauss_newton.Problem(self.model, self.cost, *self.bounds, self.residuals, least=LEAST)
        try:
            model, _, _ = gauss_newton.minimise(problem, here, none(len(here)), iterations=iterations)
        except Diverged:
            return self
        if model.y is here:
            return self
        p, theta = self.split(model.y)
        return self.at(p, [near.at(each) for near, each in zip(self.where, theta, strict=True)])

    def settled(self) -> Unknowns:
        """Where values and registrations end with weights that follow what is left."""
        found = self
        for stage in (self.early, *[self] * ROUNDS):
            try:
                weighted = stage.at(found.p, found.registrations).weighted
            except Diverged:
                break
            near = weighted.descended()
            if near is weighted and stage is self:
                break
            found = self.at(near.p, near.registrations)
        return found


def trust_in(squares: Array) -> Array:
    """The weights (F, 2) of each frame's free vertices, and of all held ones, by how near they are, from their mean
    `squares` (F, 2), m²: a model that differs is wrong in its late frames first, and never at what is held.
    """
    known = np.where(np.isfinite(squares), squares, 0.0)
    free, held = known.sum(axis=0) / np.maximum(np.isfinite(squares).sum(axis=0), 1)
    near = np.stack([known[:, 0], np.full(len(known), held)], axis=1)
    return np.asarray(1.0 / np.maximum(near, max(FLOOR**2 * free, TINY)))


def farthest(given: Experiment) -> Array:
    """The largest changes (9,) of a registration's coordinates."""
    duration = float(np.ptp(given.motion.times)) or 1.0
    return FARTHEST * np.where(np.arange(THETA) == OFFSET, duration, 1.0)


def with_few_values(scene: Scene) -> Scene:
    """The scene with one factor for each kind that is fitted with several values."""
    cloths = []
    for cloth in scene.cloths:
        letters = "".join(letter if letter in "nG" else "F" for letter in cloth.settings)
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


def few(scene: Scene, given: Sequence[Experiment], free: Flags, loss: Loss) -> Unknowns:
    """The few values of a scene, and targets, where registrations are looked for."""
    main = with_few_values(scene)
    own = [Experiment(e.motion, main if e.scene is scene else flagged_as(e.scene, main)) for e in given]
    return Unknowns.of(main, own, free, loss)


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
    begun = few(scene, given, free, loss)
    guesses = [first_guesses(each, free) for each in given]
    tries = []
    for i in range(max(map(len, guesses))):
        alike = [each[min(i, len(each) - 1)] for each in guesses]
        tries.append(begun.at(begun.p, alike).early.only(TIME).descended())
    first = min(tries, key=lambda each: each.cost())
    found = begun.at(first.p, first.registrations).settled()
    return list((found if found.cost() < begun.cost() else begun).registrations)
