"""What is left between a scene's motion and targets with another clock or place, and its derivative by both.

With the values p of the scene, and for each target a registration θ (`record`) in nine coordinates,

    r = s(t; p) − (c R y + d),      t = (t' − offset) / rate

for a frame at the clock's time t'; s lies on the straight line between two states, and is that of the start before the
scene begins. With u = ds/dt and C = c/c₀ exp(w) (c₀ R₀ y + d₀ − m), m the middle of the target,

    ∂r/∂log rate = −t u,   ∂r/∂offset = −u / rate,   ∂r/∂w = C × J(w),   ∂r/∂d = −1,   ∂r/∂log c = −C

beside ∂s/∂p, the sensitivity. That gives the normal equations of values and registration together (H, g), so that what
one of them can explain is not put down to the other.

The descent of values and registrations together, and where it begins.

A stiffer cloth and a faster clock look alike, so neither can be found without the other: both are one vector, which
Gauss–Newton moves. Few values suffice to begin with, one factor for each kind that is fitted.

The beginning is what the target shows by itself: the clock by the free fall of its first frames, the place by its first
frame, where that is the scene's start. Then everything moves, with residuals that are weighted by what is
left (`weighted`): few values are wrong in late frames first, and never at what is held; else a cloth that hangs lower
than it should would move the whole target, and one that is too stiff would make its clock late.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from itertools import product
from typing import NamedTuple

import numpy as np

from clothfit.base.arrays import Array, Flags
from clothfit.derivative.sensitivity import Columns, at_start, columns, sensitivities
from clothfit.engine.rollout import Rollout
from clothfit.engine.system import System, build, mobile, with_elements
from clothfit.engine.tape import Tape
from clothfit.motion.correspondence import weights_of_corners
from clothfit.motion.divergence import Diverged
from clothfit.motion.markers import rigid
from clothfit.motion.motion import Motion, in_groups, rms
from clothfit.objective.comparison import Loss
from clothfit.objective.experiment import Experiment
from clothfit.objective.measures import Cloud, Surface, surface_of
from clothfit.optimise import gauss_newton
from clothfit.optimise.coordinates import Coordinates
from clothfit.optimise.gauss_newton import Model
from clothfit.optimise.prior import none
from clothfit.registration.free_fall import other_fall
from clothfit.registration.record import Registration, rotation, rotation_derivative, scale_between
from clothfit.scene.fit_vector import acting, elements, fitted_cloths
from clothfit.scene.scene import Scene

THETA = 9
"""Coordinates of a registration: of the rate, the offset, the rotation, the translation and the scale."""

RATE, OFFSET, SCALE, TIME, PLACE, SPACE = 0, 1, 8, slice(0, 2), slice(2, 8), slice(2, THETA)
"""Their places."""

LARGE = 0.3, 0.1
"""What counts as a large change: of log rate and of an angle, rad; of the offset relative to the target's duration, of
the translation relative to its size, and of the logarithm of the scale.
"""

RATES = 0.5, 0.5**0.5, 1.0, 2.0**0.5, 2.0
"""Of a clock, which a search begins with where the fall of the target shows none: a frame rate is mostly mistaken for a
half or the double.
"""

TOLERANCE = 1e-8
"""Of the linear systems, relative."""


@dataclass(frozen=True, eq=False)
class Around:
    """The registrations around one: their coordinates θ (9,), each scaled so that 1 is a large change."""

    base: Registration
    centre: Array  # m (3,), m, in the scene
    scale: Array  # (9,): of log rate, of the offset, s, of w, rad, of the translation, m, and of the logarithm of c

    def at(self, theta: Array) -> Registration:
        """The registration with these coordinates."""
        by = theta * self.scale
        turn = rotation(by[2:5])
        larger = float(np.exp(by[SCALE]))
        moved = self.centre + larger * turn @ (self.base.translation - self.centre) + by[5:8]
        return Registration(
            self.base.rate * float(np.exp(by[0])), self.base.offset + float(by[1]), turn @ self.base.rotation, moved,
            self.base.scale * larger,
        )  # fmt: skip


def observed_points(motion: Motion) -> tuple[Array, Flags]:
    """The points (F, m, 3), m, that a motion shows, vertices or places inside triangles, and which it does (F, m)."""
    bound = motion.correspondence
    return (bound.points, bound.seen) if len(bound.seen) else (motion.positions, motion.seen())


def around(base: Registration, motion: Motion) -> Around:
    """The registrations of a motion around one."""
    points, seen = observed_points(motion)
    points = base.placed(points[seen])
    size = float(np.linalg.norm(np.ptp(points, axis=0))) or 1.0
    duration = float(np.ptp(motion.times)) or 1.0
    turn, move = LARGE
    scale = np.array([turn, move * duration, *[turn] * 3, *[move * size] * 3, move])
    return Around(base, points.mean(axis=0), scale)


class Sums(NamedTuple):
    """The cost, m², and its normal equations H (Q, Q) and g (Q,), where asked for."""

    cost: float
    H: Array
    g: Array
    squares: list[Array]  # (F, 2) of each cloth of each target: means of free and of held vertices, m²; NaN: unseen


@dataclass(frozen=True, eq=False)
class Unknowns:
    """Values of a scene and registrations of its targets, and what is left around them by the vector z: of the values
    log p, or p / σ, then the θ of each target.
    """

    main: Scene  # whose flags say which values
    given: Sequence[Experiment]
    p: Array  # (P,)
    registrations: Sequence[Registration]
    free: Flags  # (9,), which coordinates of a registration are unknown
    loss: Loss
    tolerance: float = TOLERANCE
    weights: Sequence[Array] | None = None  # (F, 2) as of `Sums.squares`; None: all 1
    systems: dict[tuple[int, int], System] = field(default_factory=dict)  # of each target and cloth, as they are built

    def at(self, p: Array, registrations: Sequence[Registration]) -> Unknowns:
        """The same around another point."""
        return replace(self, p=p, registrations=registrations)

    def only(self, part: slice) -> Unknowns:
        """The same with some coordinates of registrations alone."""
        free = np.zeros(THETA, bool)
        free[part] = self.free[part]
        return replace(self, free=free)

    @cached_property
    def where(self) -> list[Around]:
        """The registrations around those here."""
        return [around(own, each.motion) for own, each in zip(self.registrations, self.given, strict=True)]

    @cached_property
    def coordinates(self) -> Coordinates:
        """Of the values."""
        return Coordinates(self.main, self.p)

    @property
    def chosen(self) -> Flags:
        """Which of all P + 9 K coordinates are in z."""
        return np.concatenate([np.ones(len(self.p), bool), np.tile(self.free, len(self.given))])

    @property
    def residuals(self) -> int:
        """How many there are."""
        return sum((1 if m.correspondence.mesh else 3) * int(observed_points(m)[1].sum()) for m, _ in self.given)

    def z(self, y: Array, theta: float = 0.0) -> Array:
        """z of coordinates y (P,) of the values, and of a θ all of whose numbers are the same."""
        plain = y / self.coordinates.weight
        return np.asarray(np.concatenate([plain, np.full(THETA * len(self.given), theta)])[self.chosen])

    @property
    def here(self) -> Array:
        """z of this point."""
        return self.z(self.coordinates.y(self.p))

    def split(self, z: Array) -> tuple[Array, Array]:
        """The values (P,), and θ (K, 9)."""
        whole = np.zeros(len(self.chosen))
        whole[self.chosen] = z
        p = self.coordinates.p(whole[: len(self.p)] * self.coordinates.weight)
        return p, whole[len(self.p) :].reshape(-1, THETA)

    def cost(self, z: Array | None = None) -> float:
        """The cost at z, or here; infinite where the simulation diverges."""
        try:
            return self.sums(self.here if z is None else z, derivative=False).cost
        except Diverged:
            return np.inf

    def model(self, z: Array) -> Model:
        """The cost near z. Raises Diverged."""
        found = self.sums(z)
        return Model(z, found.cost, found.H, found.g)

    def sums(self, z: Array, derivative: bool = True) -> Sums:
        """What is left at z. Raises Diverged."""
        p, theta = self.split(z)
        size, cost, squares = len(self.chosen), 0.0, list[Array]()
        H, g = np.zeros((size, size)), np.zeros(size)
        cloths = sorted({self.main.together(cloth)[0] for cloth in fitted_cloths(self.main)})
        for k, cloth in product(range(len(self.given)), cloths):
            weights = None if self.weights is None else self.weights[len(squares)]
            part = self._sums(k, cloth, p, theta[k], weights, derivative)
            cost += part.cost
            squares += part.squares
            if derivative:
                own = np.r_[: len(p), len(p) + THETA * k : len(p) + THETA * (k + 1)]
                H[np.ix_(own, own)] += part.H
                g[own] += part.g
        return Sums(cost, H[np.ix_(self.chosen, self.chosen)], g[self.chosen], squares)

    def _sums(self, k: int, cloth: int, p: Array, theta: Array, weights: Array | None, derivative: bool) -> Sums:
        """What one cloth of a target adds, by all values and its θ."""
        motion, scene = in_groups(self.given[k].motion, self.given[k].scene), self.given[k].scene
        now, own = self.where[k].at(theta), motion.weights_of(cloth)
        times, points, seen = now.times(motion.times), motion.of(cloth), motion.seen(cloth)
        surface = surface_of(motion, cloth)
        if surface:
            points, seen = surface.points, surface.seen
        B = surface.weights if isinstance(surface, Surface) else None

        def of_points(x: Array) -> Array:
            """Values (n, …) of vertices as points have them."""
            return x if B is None else (B @ x.reshape(len(x), -1)).reshape(-1, *x.shape[1:])

        at = np.maximum(times, 0.0)
        steps = int(at.max(initial=0.0) / scene.delta) + 1
        system = with_elements(self._system(k, cloth, steps), elements(scene, cloth, p))
        blocks = acting(scene, cloth) if derivative else []
        count, column = len(p) if derivative else 0, np.arange(len(p), dtype=np.int32)
        wanted = columns(system, blocks, p, column, self.coordinates.change(p), count)
        free = mobile(system)
        size = count + THETA
        cost, H, g, means = 0.0, np.zeros((size, size)), np.zeros(size), np.full((len(times), 2), np.nan)
        for i, (s, change, sensitivity) in enumerate(states(system, at / scene.delta, wanted, self.tolerance)):
            placed = now.placed(np.where(seen[i][:, None], points[i], 0.0))
            weight = seen[i] * (1.0 if own is None or surface else own[i])
            feet = None
            if isinstance(surface, Cloud):
                feet = surface.mesh.feet(placed, surface.faces[i], s)
                B = weights_of_corners(surface.mesh.triangles[feet.faces], feet.weights, len(s))
            held = (of_points(free.astype(float)) == 0.0).astype(int)
            gaps = of_points(s) - placed
            squares = (gaps**2).sum(axis=1)
            total, number = (np.bincount(held, each, 2) for each in (weight * squares, weight))
            means[i, number > 0] = total[number > 0] / number[number > 0]
            weight = weight if weights is None else weight * weights[i, held]
            cost += float(weight @ self.loss.value(squares))
            if derivative:
                moved, J = np.zeros((len(free), 3, count)), np.zeros((len(held), 3, size))
                moved[free] = sensitivity.reshape(-1, 3, count)
                J[..., :count] = of_points(moved)
                u = (times[i] > 0.0) * of_points(change) / scene.delta
                J[..., count:] = by_registration(u, at[i], placed, self.where[k], theta, now.rate)
                if feet is not None:  # places slide along the cloth
                    J = feet.normals[:, :, None] * np.einsum("mc,mcq->mq", feet.normals, J)[:, None]
                root = np.sqrt(weight * self.loss.derivative(squares))
                rows = (root[:, None, None] * J).reshape(-1, size)
                H += rows.T @ rows
                g += rows.T @ (root[:, None] * gaps).reshape(-1)
        return Sums(cost, H, g, [means])

    def _system(self, k: int, cloth: int, steps: int) -> System:
        """A cloth of a target, with inputs for so many steps: another clock may go beyond the frames."""
        own = self.systems.get((k, cloth))
        if own is None or (own.inputs is not None and own.inputs.steps < steps):
            own = self.systems[k, cloth] = build(self.given[k].scene, cloth, steps=steps + steps // 8)
        return own


def states(
    system: System, places: Array, wanted: Columns, tolerance: float
) -> Iterator[tuple[Array, Array, Array]]:
    """The states (n, 3), m, at `places` (F,), in steps, increasing, of the motion of a system, their change (n, 3) in
    the step that they lie in, and their sensitivity (3 f, Q), of free vertices. Raises Diverged.
    """
    step = np.floor(places).astype(np.int64)
    tape = Tape(system, int(step.max(initial=0)) + 1, tolerance)
    chunks, frame, before = deque[Rollout](maxlen=1), 0, at_start(system, wanted)
    for t, after in enumerate(sensitivities(system, tape, wanted, tolerance, chunks.append)):
        x = chunks[0].x[t - chunks[0].first :][:2]
        while frame < len(places) and step[frame] == t:
            share = places[frame] - t
            s, along = ((1.0 - share) * a + share * b for a, b in ((x[0], x[1]), (before, after)))
            yield s, x[1] - x[0], along
            frame += 1
        before = after.copy()  # of what may always be the same array
    if tape.good < tape.steps:
        raise Diverged(f"diverged at step {tape.good + 1}", tape.good + 1)


def by_registration(u: Array, t: float, placed: Array, where: Around, theta: Array, rate: float) -> Array:
    """∂r/∂θ (n, 3, 9) of a frame at the time t, s, of the scene, with velocities u (n, 3), m/s, and the points `placed`
    (n, 3), m.
    """
    by = theta * where.scale
    J = np.zeros((*placed.shape, THETA))
    J[..., RATE], J[..., OFFSET] = -t * u, -u / rate
    arms = placed - where.centre - by[5:8]  # C
    turn = rotation_derivative(by[2:5])
    for axis in range(3):
        J[..., 2 + axis] = np.cross(arms, turn[:, axis])
        J[:, axis, 5 + axis] = -1.0
    J[..., SCALE] = -arms
    return np.asarray(J * where.scale)


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


def reweighted(unknowns: Unknowns) -> Unknowns:
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
        if rms(c * points @ R.T + d - start) < RIGID * rms(points - start):
            place = Registration(rotation=R, translation=d, scale=c)
    if not free[TIME].any():
        return [place]
    begun = replace(place, offset=first).applied(motion, scene.delta)
    fall = other_fall(scene, begun)
    clocks = [(1.0, 0.0), *((rate, first) for rate in RATES)] if fall is None else [(fall.rate, first)]
    return [replace(place, rate=rate, offset=offset) for rate, offset in dict.fromkeys(clocks)]


def find(begun: Unknowns) -> list[Registration]:
    """The registrations of targets beside values from which a search begins; none where nothing lowers the cost."""
    guesses = [first_guesses(each, begun.free) for each in begun.given]
    count = max(len(each) for each in guesses)
    tries = [begun.at(begun.p, [each[min(i, len(each) - 1)] for each in guesses]) for i in range(count)]
    tries.sort(key=lambda each: each.cost())
    on_time = (each for each in tries if all(own.rate == 1.0 for own in each.registrations))  # not by chance another
    ends = [begun, *(reweighted(each) for each in dict.fromkeys([tries[0], next(on_time, tries[0])]))]
    return list(min(ends, key=lambda each: each.cost()).registrations)
