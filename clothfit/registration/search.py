"""The descent of values and registrations together, and where it begins.

A stiffer cloth and a faster clock look alike, so neither can be found without the other: both are one vector, which
Gauss–Newton moves. Few values suffice to begin with, one factor for each kind that is fitted.

The beginning is what the target shows by itself: the clock by the free fall of its first frames, the place by its first
frame, where that is the scene's start. Then everything moves, with residuals that are weighted by what is
left (`weighted`): few values are wrong in late frames first, and never at what is held; else a cloth that hangs lower
than it should would move the whole target, and one that is too stiff would make its clock late.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from clothfit.base.arrays import Flags
from clothfit.motion.divergence import Diverged
from clothfit.motion.foreign import apart
from clothfit.objective.experiment import Experiment
from clothfit.optimise import gauss_newton
from clothfit.optimise.prior import none
from clothfit.registration.free_fall import other_fall
from clothfit.registration.record import Registration, rigid, scale_between
from clothfit.registration.residuals import PLACE, SCALE, SPACE, THETA, TIME, Unknowns

ITERATIONS = 8
"""At most, with one set of weights, and sets of weights."""

RIGID = 0.2
"""The largest part of a first frame's distance from the start that may be left when it is moved and turned."""

FLOOR = 1e-2
"""Error relative to that of all frames below which frames count alike."""

LEAST = 1e-3
"""A descent ends where a step would save less than this part of the cost."""


def descended(unknowns: Unknowns, iterations: int = ITERATIONS) -> Unknowns:
    """Where Gauss–Newton ends; the same where it goes nowhere."""
    here = unknowns.here
    ends = unknowns.coordinates
    lower, upper = unknowns.z(ends.lower, -np.inf), unknowns.z(ends.upper, np.inf)
    problem = gauss_newton.Problem(unknowns.model, unknowns.cost, lower, upper, unknowns.residuals, least=LEAST)
    try:
        model, _, _ = gauss_newton.minimise(problem, here, none(len(here)), iterations=iterations)
    except Diverged:
        return unknowns
    if model.y is here:
        return unknowns
    p, theta = unknowns.split(model.y)
    return unknowns.at(p, [near.at(each) for near, each in zip(unknowns.where, theta, strict=True)])


def weighted(unknowns: Unknowns) -> Unknowns:
    """The same with weights from what is left here: a model that differs is wrong in its late frames first, and never
    at what is held. So free vertices weigh by what is left of their frame, and held ones of all. Raises Diverged.
    """
    weights = []
    for squares in unknowns.sums(unknowns.here, derivative=False).squares:
        known = np.where(np.isfinite(squares), squares, 0.0)
        free, held = known.sum(axis=0) / np.maximum(np.isfinite(squares).sum(axis=0), 1)
        near = np.stack([known[:, 0], np.full(len(known), held)], axis=1)
        weights.append(1.0 / np.maximum(near, FLOOR**2 * free or 1.0))
    return replace(unknowns, weights=weights)


def settled(unknowns: Unknowns) -> Unknowns:
    """Where values and registrations end with weights that follow what is left."""
    for _ in range(ITERATIONS):
        try:
            start = weighted(unknowns)
        except Diverged:
            break
        near = descended(start)
        if near is start:
            break
        unknowns = replace(near, weights=None)
    return unknowns


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


def find(begun: Unknowns) -> list[Registration]:
    """The registrations of targets beside values from which a search begins; none where nothing lowers the cost."""
    guesses = [first_guesses(each, begun.free) for each in begun.given]
    tries = [begun.at(begun.p, [each[min(i, len(each) - 1)] for each in guesses]) for i in range(2)]
    found = settled(min(tries, key=lambda each: each.cost()))
    return list((found if found.cost() < begun.cost() else begun).registrations)
