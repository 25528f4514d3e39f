"""The values of a scene and the registrations of its targets as one vector z, which Gauss–Newton moves together.

A stiffer cloth and a faster clock look alike, so neither can be found without the other. Few values suffice for that:
one factor for each kind that is fitted.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from clothfit.base.arrays import Array, Flags
from clothfit.motion.divergence import Diverged
from clothfit.objective.experiment import Experiment
from clothfit.optimise import gauss_newton
from clothfit.optimise.coordinates import Coordinates
from clothfit.optimise.prior import none
from clothfit.registration.record import Registration
from clothfit.registration.residuals import THETA, Around, Registered, Sums
from clothfit.scene.scene import Scene

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
        whole = np.concatenate([self._plain(self.start), np.zeros(THETA * len(self.where))])
        return np.asarray(whole[self.chosen])

    @property
    def bounds(self) -> tuple[Array, Array]:
        """Ends of z."""
        ends = []
        for sign, end in zip((-1.0, 1.0), (self.coordinates.lower, self.coordinates.upper), strict=True):
            theta = [sign * farthest(each) / near.scale
                     for each, near in zip(self.registered.given, self.where, strict=True)]  # fmt: skip
            ends.append(np.concatenate([end / self.coordinates.weight, *theta])[self.chosen])
        return ends[0], ends[1]

    def _plain(self, p: Array) -> Array:
        return np.asarray(self.coordinates.y(p) / self.coordinates.weight)

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
        try:
            cost = self.registered.sums(*self.arguments(z)).cost
        except Diverged:
            return np.inf
        return cost if np.isfinite(cost) else np.inf

    def arguments(self, z: Array) -> tuple[Array, Sequence[Around], Array]:
        """Those of `Registered.sums`."""
        p, theta = self.split(z)
        return p, self.where, theta

    def descended(self, iterations: int) -> Found:
        """Where Gauss–Newton from the start ends. Raises Diverged."""
        given, frames = self.registered.given, self.registered.frames
        residuals = 3 * sum(int(each.motion.seen()[:frames].sum()) for each in given)
        problem = gauss_newton.Problem(self.model, self.cost, *self.bounds, residuals, least=LEAST)
        model, _, _ = gauss_newton.minimise(problem, self.begin, none(len(self.begin)), iterations=iterations)
        p, theta = self.split(model.y)
        return Found(model.cost, p, [near.at(each) for near, each in zip(self.where, theta, strict=True)])


def farthest(given: Experiment) -> Array:
    """The largest changes (9,) of a registration's coordinates."""
    factor = np.log(SLOWEST)
    return np.array([factor, LATEST * span(given), *[np.pi] * 3, *[np.inf] * 3, factor])


def span(given: Experiment) -> float:
    """The duration of a target, s."""
    return float(np.ptp(given.motion.times)) or 1.0


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
