"""Continuation: from values that are decades off to those of a motion that the model cannot quite reproduce.

The cost of a whole motion has many minima and, where steps are as long as frames, is rough in its values. Three
families of easier problems lead to it, each from the values that the one before has found:

- Springs of m ω² pull each vertex to where it was seen (nudging), more and more weakly:

      m a = f(x, v; p) + m ω² (y − x),    Σ |x − y|² → min,    ω → 0.

  What is left of a motion that is pulled is what the model does wrong in about 1 / ω. What was not seen is not pulled.
- Implicit Euler steps of a frame's length damp what differs between two motions; shorter steps, and BDF2, come after.
- Few values come before many (`hierarchy`).

Each problem is solved by a few steps of Gauss–Newton in coordinates in which a motion changes evenly,

    log p,    asinh(p / s) of dampings and drags, which may be 0,    c W / m g of a wind beside a drag c that is fitted,

as it is the push c W that moves a cloth, or c W² in the law "air", where the coordinate is √c W: with c alone the push
would change as well. Where the whole motion still ends far
from its target, the same begins again from points between the best one and some that are drawn at random.

Weak-constraint 4D-Var balances a model and observations alike (Y. Trémolet, Accounting for an imperfect model in
4D-Var, 2006); for models that are pulled while their values are fitted see H. D. I. Abarbanel et al., Dynamical state
and parameter estimation, 2009.

The time step of a fit: how many steps to a frame of its targets, and by which integrator.
"""

from __future__ import annotations

import contextlib
from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import cached_property
from math import ceil

import numpy as np

from clothfit.base.arrays import Array, Indices
from clothfit.engine.system import IMPLICIT
from clothfit.motion.divergence import Diverged
from clothfit.motion.motion import Motion
from clothfit.motion.times import frame_places
from clothfit.objective.experiment import Experiment
from clothfit.objective.objective import Objective
from clothfit.optimise import gauss_newton
from clothfit.optimise.gauss_newton import Model, Patience
from clothfit.optimise.prior import Prior, first, none
from clothfit.optimise.search import Search
from clothfit.optimise.trajectory import AIR, Scores, Trajectory
from clothfit.scene.cloth import wind_of
from clothfit.scene.fit_vector import bounds, of_kinds
from clothfit.scene.forces import STRONGEST, Forces
from clothfit.scene.kinds import AIR as BY_AREA
from clothfit.scene.kinds import REST
from clothfit.scene.scene import Scene

NUDGES, WEAKER = (0.5, 0.3, 0.2, 0.1, 0.05, 0.0), (0.2, 0.05, 0.0)
"""ω, in radians per frame, one after the other: from values that may be far off, and from those of another step
or model.
"""

DOUBT, LEAST = 0.5, 1e-2
"""Share of the cost that a value costs which is 1 of its coordinate away from that of the user, for each radian per
frame of a pull, and at least: motions that are pulled hardly depend on some combinations of values, which would run
far off.
"""

STEPS, LAST_STEPS = 4, 8
"""Steps of Gauss–Newton with each of them, and without a pull."""

SAVING, PATIENCE = 0.01, Patience(2, 1e-2, 1e-2)
"""Share of the cost that a step must save."""

TOLERANCE, NUDGED_TOLERANCE = 1e-5, 1e-7
"""Of the linear systems by coarse steps; of other nudged motions: its error is far below what is left of them."""

HOPS, NEAR, FAR, REACH = 8, 0.1, 0.4, 2.0
"""Points that are drawn; the errors relative to that of a still cloth below which motions are not pulled, and no point
is drawn; and how far away these are, in units of the coordinates.
"""

SEED = 0

SHARE = 0.7
"""Of the time of a fit, that goes by before the last of these is drawn."""

SMALL = 0.01
"""s of dampings and drags, relative to what is typical, and to the drag of real air: less hardly moves a cloth."""


class StepLimit(Exception):
    """Ends Gauss–Newton after some steps."""


class Even(Trajectory):
    """An objective in the coordinates x (Q,) in which its motions change evenly."""

    def __init__(self, search: Search, objective: Objective) -> None:
        """As of a trajectory."""
        super().__init__(search, objective)
        blocks, start = objective.blocks, search.start
        self.log = search.coordinates.log
        self.positive = of_kinds(objective.scene, ("damping", "drag"))
        self.drag, self.wind = (np.flatnonzero(of_kinds(objective.scene, names)) for names in (("drag",), AIR))
        cloths = objective.scene.cloths
        sizes = [
            each.kind.scale if each.cloth is None or each.name != "drag" else cloths[each.cloth].air_drag or 1.0
            for each in blocks
        ]
        typical = np.repeat(sizes, [block.count for block in blocks])
        other = np.where(self.log, 1.0, np.maximum(np.abs(start), typical))
        self.power = 0.5 if cloths and all(own.drag_law == BY_AREA for own in cloths) else 1.0
        self.unit = np.where(self.positive, SMALL * typical, other)
        self.unit[self.wind] = self.lift

    @cached_property
    def lift(self) -> float:
        """The wind that carries the weight of the cloths, times the power of a drag that is fitted with it; 1 m/s where
        there is none.
        """
        scene = self.objective.scene
        cloths = [cloth for cloth in scene.cloths if cloth.feels_air]
        weight = float(np.linalg.norm(scene.gravity)) * sum(float(own.mass.sum()) for own in cloths)
        drags = [own.air_drag or 1.0 if len(self.drag) else own.drag for own in cloths]
        factor = float(np.exp(np.log(drags).mean())) ** self.power if len(self.drag) and drags else 1.0
        return factor * wind_of(weight, cloths, drags) or 1.0

    def air(self, p: Array) -> float:
        """The power of the drag that is fitted, no less than what hardly moves a cloth, in the geometric mean of the
        cloths, by which the wind goes; 1 without one.
        """
        size = np.hypot(p[self.drag], self.unit[self.drag])
        return float(np.exp(np.log(size).mean())) ** self.power if len(size) else 1.0

    def y(self, p: Array) -> Array:
        """Coordinates (Q,) of parameters (P,)."""
        x = np.where(self.log, np.log(np.where(self.log, p, 1.0)), p / self.unit)
        x[self.positive] = np.arcsinh(x[self.positive])
        x[self.wind] *= self.air(p)
        return np.asarray(x[self.fitted])

    def parameters(self, y: Array) -> Array:
        """Parameters (P,) at coordinates (Q,)."""
        x = np.zeros(len(self.unit))
        x[self.fitted] = y
        with np.errstate(over="ignore"):
            p = np.where(self.log, np.exp(np.where(self.log, x, 0.0)), self.unit * x)
            p[self.positive] = self.unit[self.positive] * np.sinh(x[self.positive])
        p = np.where(self.fitted, p, self.search.best.p)
        p[self.wind[self.fitted[self.wind]]] /= self.air(p)
        return np.where(self.fitted, self.search.coordinates.clipped(p), p)

    @property
    def bounds(self) -> tuple[Array, Array]:
        """Ends (Q,) of the coordinates; the wind has none of its own."""
        ends = np.stack([self.y(end) for end in bounds(self.objective.scene)])
        moved = np.isin(np.flatnonzero(self.fitted), self.wind)
        ends[:, moved] = [[-np.inf], [np.inf]]
        return ends[0], ends[1]

    @property
    def own_widths(self) -> Array:
        """Those of the coordinates: all are alike."""
        return np.ones(self.size)

    widths = own_widths

    def derivative(self, p: Array) -> Array:
        """∂p/∂x (P,) at p (P,), of each parameter by its own coordinate."""
        size = np.where(self.log, p, self.unit)
        size[self.positive] = np.hypot(self.unit, p)[self.positive]
        size[self.wind] /= self.air(p)
        return size

    def model(self, y: Array, keep: Callable[[Indices], Scores] | None = None) -> Model:
        """The cost near coordinates (Q,). Raises Diverged."""
        known, turn = super().model(y, keep), self.turn(y)
        return Model(y, known.cost, turn.T @ known.H @ turn, turn.T @ known.g)

    def turn(self, y: Array) -> Array:
        """∂x'/∂x (Q, Q) at coordinates (Q,), of coordinates x' in which the wind is not coupled with the drag."""
        p, turn = self.parameters(y), np.eye(self.size)
        place = np.cumsum(self.fitted) - 1
        drag, wind = (own[self.fitted[own]] for own in (self.drag, self.wind))
        if len(drag) and len(wind):
            share = self.power * p[drag] / np.hypot(p[drag], self.unit[drag]) / len(self.drag)
            turn[np.ix_(place[wind], place[drag])] = -np.outer(y[place[wind]], share)
        return turn


def can_nudge(objective: Objective) -> bool:
    """Whether motions can be nudged: by positions, in scenes that move and have no forces of their own."""
    scenes = [scene for _, scene in objective.experiments]
    free = all(scene.forces is None and scene.method != REST for scene in scenes)
    return list(objective.weights) == ["position"] and free


def nudged(objective: Objective, omega: float) -> Objective:
    """The objective of motions with a pull, in radians per frame."""
    given = [Experiment(motion, with_nudging(scene, motion, omega)) for motion, scene in objective.experiments]
    return objective.in_scenes(given, max(NUDGED_TOLERANCE, objective.tolerance))


def with_nudging(scene: Scene, motion: Motion, omega: float) -> Scene:
    """A scene whose vertices are pulled to where a motion shows them, with springs of the masses that it has; between
    frames to places on the line from one to the next, unless all frames are at ends of steps. A cloth at rest is pulled
    to where the last frame shows it, ω in rad/s.
    """
    if scene.method == REST:
        own = np.concatenate([cloth.mass for cloth in scene.cloths]) * omega**2 * motion.seen()[-1]
        places = motion.positions[-1:].copy()
        return scene.with_forces(Forces(np.zeros(1), np.zeros(places.shape), own[None], places, pulls=True))
    step, part = frame_places(motion, scene.delta)
    at, seen, aligned = step + part, motion.seen(), not part.any()
    gap = max(float(np.median(np.diff(at))), 1.0) if len(at) > 1 else 1.0
    mass = np.concatenate([cloth.mass for cloth in scene.cloths])
    per_step = gap if aligned else 1.0  # the same impulse for each frame
    stiffness = np.minimum(per_step * mass * (omega / (gap * scene.delta)) ** 2, STRONGEST)
    count = max(int(at[-1]), 1)
    places = np.tile(np.concatenate([cloth.positions for cloth in scene.cloths]), (count, 1, 1)).astype(float)
    gain = np.zeros(places.shape[:2])
    for row in range(count):
        later = int(np.searchsorted(at, row + 1))
        if later == len(at):
            break
        if at[later] == row + 1:
            shown, place = seen[later], motion.positions[later]
        elif later and not aligned:
            share = (row + 1 - at[later - 1]) / (at[later] - at[later - 1])
            shown = seen[later] & seen[later - 1]
            place = (1.0 - share) * motion.positions[later - 1] + share * motion.positions[later]
        else:
            continue
        places[row, shown], gain[row, shown] = place[shown], stiffness[shown]
    times = scene.delta * np.arange(count, dtype=float)
    return scene.with_forces(Forces(times, np.zeros(places.shape), gain, places, pulls=True))


def some_steps(
    part: Trajectory,
    y: Array,
    most: int,
    saving: float = SAVING,
    patience: Patience = PATIENCE,
    prior: Prior | None = None,
    widths: Array | None = None,
) -> Array:
    """Where some steps of Gauss–Newton lead from y (Q,), without a model of the last point, until one would save less
    than a share of the cost, in a trust region of these `widths` (Q,), or of those of the part. Raises Diverged.
    """
    points: list[Array] = []

    def model(y: Array) -> Model:
        points.append(y)
        if len(points) > most or (len(points) > 1 and part.search.is_late):
            raise StepLimit
        return part.model(y)

    problem = replace(part.problem(saving, patience), model=model, widths=part.widths if widths is None else widths)
    with contextlib.suppress(StepLimit):
        return gauss_newton.minimise(problem, y, prior or none(part.size), part.passed)[0].y
    return points[-1]


def through_nudging(
    own: Search, omegas: Sequence[float] = WEAKER, start: Array | None = None, limit: float = np.inf,
    doubtful: bool = True, near: float = NEAR,
) -> None:  # fmt: skip
    """Steps of Gauss–Newton on motions that are pulled more and more weakly, from `start` (P,) or the best point; given
    up where such a motion costs more than `limit`, m². Values that are not `doubtful` have no prior. Raises Stop.
    """
    p = own.best.p if start is None else start
    is_near = own.measure(p) <= near**2 * own.objective.cost_at_rest
    for omega in omegas[-1:] if is_near or not can_nudge(own.objective) else omegas:
        part = Even(own, nudged(own.objective, omega) if omega else own.objective)
        own.enter("continuation", part.objective)
        y = part.y(p)
        if own.is_late or not np.isfinite(part.cost(y)):
            continue
        share = (DOUBT * omega + LEAST) * part.residuals()
        every = np.arange(part.size, dtype=np.int32)
        prior = first(part.y(own.origin), [every], share**-0.5) if doubtful else none(part.size)
        with contextlib.suppress(Diverged), np.errstate(over="ignore", invalid="ignore"):
            p = part.parameters(some_steps(part, y, STEPS if omega else LAST_STEPS, prior=prior))
        if omega and own.visit(p) > limit and part.objective.cost_or_infinity(p) > limit:
            break


def hops(own: Search, took: float, share: float = SHARE, far: float = FAR, reach: float = REACH) -> None:
    """The same from points half-way to others that are drawn around the best one, while it is `far` from the target and
    this share of the time is left for what `took` so many seconds of computing before. Raises Stop.
    """
    random, part = np.random.default_rng(SEED), Even(own, own.objective)
    for _ in range(HOPS):
        began = own.progress.computing
        if began + took > share * own.longest or own.best.cost <= far**2 * own.objective.cost_at_rest:
            break
        lower, upper = part.bounds
        y = np.clip(part.y(own.best.p) + 0.5 * random.uniform(-reach, reach, part.size), lower, upper)
        through_nudging(own, NUDGES[2:], part.parameters(y), own.best.cost)
        took = max(took, own.progress.computing - began)


def through_weak_nudging(own: Search) -> None:
    """Steps of Gauss–Newton from the best point of a coarser model. Raises Stop."""
    through_nudging(own, WEAKER[1:])


def coarse(objective: Objective) -> Objective:
    """The objective of implicit Euler steps of a frame's length."""
    return with_substeps(objective, 1, IMPLICIT, max(TOLERANCE, objective.tolerance))


def from_afar(own: Search) -> None:
    """Come from values that may be far off to the target, by coarse steps. Raises Stop."""
    began = own.progress.computing
    through_nudging(own, NUDGES)
    took = own.progress.computing - began
    if own.best.cost < NEAR**2 * own.objective.cost_at_rest:  # it shows what its values are
        through_nudging(own, NUDGES, own.start, doubtful=False)
    hops(own, took)


def by_coarse_steps(own: Search) -> None:
    """Come to the target by coarse steps first, and then by those of a search. Raises Stop."""
    rough = own.subsearch(coarse(own.objective), own.best.p, np.inf)
    rough.fitted = own.fitted
    from_afar(rough)
    through_nudging(own, WEAKER, rough.best.p)


ROUNDING = 1e-6
"""Steps by which a whole number of them may be off by rounding."""


def frame_interval(given: Experiment) -> float:
    """Time between two frames of a target, s, in the median: steps of its scene, without the rounding of a whole number
    of them.
    """
    times, delta = given.motion.times, given.scene.delta
    steps = float(np.median(np.diff(times))) / delta if len(times) > 1 else 1.0
    whole = max(round(steps), 1)
    return delta * (whole if abs(steps - whole) < ROUNDING else steps)


def with_substeps(objective: Objective, count: int, method: int | None, tolerance: float | None = None) -> Objective:
    """The objective with so many steps to a frame, each of its own target; `method` None: as they are. The scene's own
    step is that for the first target. The same frames are compared. `tolerance` None: as it is.
    """
    scene, given = objective.scene, objective.experiments
    last = max((last_time(each) for each in given if each.scene is scene), default=0.0)
    main = with_interval(scene, frame_interval(given[0]) / count, method, last)
    pairs = [
        Experiment(
            each.motion,
            main if each.scene is scene
            else with_interval(each.scene, frame_interval(each) / count, method, last_time(each)),
        )
        for each in given
    ]  # fmt: skip
    return objective.against(main, pairs, [pair.scene.frames for pair in pairs], tolerance)


def last_time(given: Experiment) -> float:
    """When the last frame of a target is that its scene reaches, s."""
    step, part = frame_places(given.motion, given.scene.delta)
    places = step + part
    return float(places[places <= given.scene.frames - 1].max(initial=0.0)) * given.scene.delta


def with_interval(scene: Scene, delta: float, method: int | None, last: float = 0.0) -> Scene:
    """The scene with steps of `delta`, s, as many as its time has, and no fewer than reach the time `last`, s."""
    within = int((scene.frames - 1) * scene.delta / delta + ROUNDING)
    needed = ceil(last / delta - ROUNDING)
    return scene.with_step(delta, max(within, needed, 1) + 1, method)


def in_frames(scene: Scene, given: Experiment) -> Scene:
    """The scene with steps that end at the frames of a target, no longer than its own."""
    gap = frame_interval(given)
    return with_interval(scene, gap / ceil(gap / scene.delta - ROUNDING), None, last_time(given))
