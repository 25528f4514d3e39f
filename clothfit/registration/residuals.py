"""What is left between a scene's motion and targets with another clock or place, and its derivative by both.

With the values p of the scene, and for each target a registration θ (`record`) in nine coordinates,

    r = s(t; p) − (c R y + d),      t = (t' − offset) / rate

for a frame at the clock's time t'; s lies on the straight line between two states, and is that of the start before the
scene begins. With u = ds/dt and C = c/c₀ exp(w) (c₀ R₀ y + d₀ − m), m the middle of the target,

    ∂r/∂log rate = −t u,   ∂r/∂offset = −u / rate,   ∂r/∂w = C × J(w),   ∂r/∂d = −1,   ∂r/∂log c = −C

beside ∂s/∂p, the sensitivity. That gives the normal equations of values and registration together (H, g), so that what
one of them can explain is not put down to the other.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple

import numpy as np

from clothfit.base.arrays import Array, Flags
from clothfit.derivative.sensitivity import Columns, at_start, columns, one_by_one, sweep, tangents
from clothfit.engine.rollout import Rollout
from clothfit.engine.system import System, build, mobile, with_elements
from clothfit.engine.tape import Tape
from clothfit.motion.divergence import Diverged
from clothfit.motion.motion import Motion
from clothfit.objective.comparison import Loss
from clothfit.objective.experiment import Experiment
from clothfit.registration.record import Registration, rotation, rotation_derivative
from clothfit.scene.fit_vector import elements, fitted_cloths
from clothfit.scene.scene import Scene

THETA = 9
"""Coordinates of a registration: of the rate, the offset, the rotation, the translation and the scale."""

RATE, OFFSET, SCALE, TIME, PLACE, SPACE = 0, 1, 8, slice(0, 2), slice(2, 8), slice(2, THETA)
"""Their places."""


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


def around(base: Registration, motion: Motion) -> Around:
    """The registrations of a motion around one."""
    points = base.placed(motion.positions[motion.seen()])
    size = float(np.linalg.norm(np.ptp(points, axis=0))) or 1.0
    duration = float(np.ptp(motion.times)) or 1.0
    scale = np.array([0.3, 0.1 * duration, *[0.3] * 3, *[0.1 * size] * 3, 0.1])
    return Around(base, points.mean(axis=0), scale)


class Sums(NamedTuple):
    """The cost, m², and its normal equations H (Q, Q) and g (Q,), where asked for."""

    cost: float
    H: Array
    g: Array
    squares: list[Array]  # (F, 2) of each cloth of each target: means of free and of held vertices, m²; NaN: unseen


class State(NamedTuple):
    """A frame of a motion of n vertices, f of them free, with its sensitivity to Q values."""

    s: Array  # (n, 3), m
    change: Array  # (n, 3), m, during the step that it lies in
    sensitivity: Array  # (3 f, Q)


@dataclass(frozen=True, eq=False)
class Registered:
    """Targets with their scenes, under registrations; the values are those that `main` flags."""

    main: Scene
    given: Sequence[Experiment]
    loss: Loss
    tolerance: float  # of the linear systems, relative
    frames: int | None = None  # of each target that are compared, the first ones; None: all
    weights: Sequence[Array] | None = None  # (F, 2) as of `Sums.squares`; None: all 1

    @cached_property
    def systems(self) -> list[dict[int, System]]:
        """The cloths of each target that are compared."""
        cloths = fitted_cloths(self.main)
        return [{cloth: build(each.scene, cloth) for cloth in cloths} for each in self.given]

    def _system(self, k: int, cloth: int, end: float) -> System:
        """A cloth of a target, with inputs up to the time `end`, s: another clock may go beyond the frames."""
        own, scene = self.systems[k][cloth], self.given[k].scene
        steps = int(end / scene.delta) + 1
        if own.inputs is not None and own.inputs.steps < steps:
            own = self.systems[k][cloth] = build(scene, cloth, steps=steps + steps // 8)
        return own

    def sums(self, p: Array, where: Sequence[Around], theta: Array, factor: Array | None = None) -> Sums:
        """The cost at values p (P,) and registrations θ (K, 9); with H and g by (P + 9 K) coordinates where `factor`
        (P,), the change of each value for its coordinate, is given. Raises Diverged.
        """
        size = len(p) + THETA * len(self.given)
        cost, H, g, squares = 0.0, np.zeros((size, size)), np.zeros(size), list[Array]()
        for k, systems in enumerate(self.systems):
            own = np.r_[: len(p), len(p) + THETA * k : len(p) + THETA * (k + 1)]
            for cloth in systems:
                weights = None if self.weights is None else self.weights[len(squares)]
                part = self._cloth(k, cloth, p, where[k], theta[k], factor, weights)
                cost += part.cost
                if factor is not None:
                    H[np.ix_(own, own)] += part.H
                    g[own] += part.g
                squares += part.squares
        return Sums(cost, H, g, squares)

    def _cloth(
        self, k: int, cloth: int, p: Array, where: Around, theta: Array, factor: Array | None, weights: Array | None
    ) -> Sums:
        """What one cloth of a target adds."""
        motion, scene = self.given[k]
        now, kept = where.at(theta), slice(self.frames)
        times, points, seen = motion.times[kept], motion.of(cloth)[kept], motion.seen(cloth)[kept]
        own, begun = motion.weights_of(cloth), now.times(times) > 0.0
        at = np.where(begun, now.times(times), 0.0)
        system = with_elements(self._system(k, cloth, at.max(initial=0.0)), elements(scene, cloth, p))
        wanted = self._columns(system, cloth, p, factor)
        free = mobile(system)
        held, size = (~free).astype(int), wanted.width + THETA
        cost, H, g, means = 0.0, np.zeros((size, size)), np.zeros(size), np.full((len(times), 2), np.nan)
        for i, state in enumerate(states(system, at / scene.delta, wanted, self.tolerance)):
            placed = now.placed(np.where(seen[i][:, None], points[i], 0.0))
            weight = seen[i] * (1.0 if own is None else own[i])
            gaps = state.s - placed
            squares = (gaps**2).sum(axis=1)
            total, count = (np.bincount(held, each, 2) for each in (weight * squares, weight))
            means[i, count > 0] = total[count > 0] / count[count > 0]
            weight = weight if weights is None else weight * weights[i, held]
            cost += float(weight @ self.loss.value(squares))
            if factor is not None:
                u = begun[i] * state.change / scene.delta
                own_columns = by_registration(u, at[i], placed, where, theta, now.rate)
                J = np.concatenate([spread(state.sensitivity, free), own_columns], axis=2)
                root = np.sqrt(weight * self.loss.derivative(squares))
                rows = (root[:, None, None] * J).reshape(-1, size)
                H += rows.T @ rows
                g += rows.T @ (root[:, None] * gaps).reshape(-1)
        return Sums(cost, H, g, [means])

    def _columns(self, system: System, cloth: int, p: Array, factor: Array | None) -> Columns:
        """The columns of all values; of those of other cloths they are 0."""
        own = [block for block in self.main.blocks if block.cloth in (cloth, None)]
        count = 0 if factor is None else len(p)
        by = np.zeros(len(p)) if factor is None else factor
        return columns(system, own if count else [], p, np.arange(len(p), dtype=np.int32), by, count)


def states(system: System, places: Array, wanted: Columns, tolerance: float) -> Iterator[State]:
    """The states at `places` (F,), in steps, increasing, of the motion of a system. Raises Diverged."""
    step = np.floor(places).astype(np.int64)
    tape = Tape(system, int(step.max(initial=0)) + 1, tolerance)
    chunks: list[Rollout] = []
    frame, before = 0, at_start(system, wanted)
    for t, after in enumerate(steps(system, tape, wanted, tolerance, chunks)):
        x = chunks[-1].x[t - chunks[-1].first :][:2]
        while frame < len(places) and step[frame] == t:
            fraction = places[frame] - t
            s, along = ((1.0 - fraction) * a + fraction * b for a, b in ((x[0], x[1]), (before, after)))
            yield State(s, x[1] - x[0], along)
            frame += 1
        before = after
    if tape.good < tape.steps:
        raise Diverged(f"diverged at step {tape.good + 1}", tape.good + 1)


def steps(
    system: System, tape: Tape, wanted: Columns, tolerance: float, chunks: list[Rollout]
) -> Iterator[Array]:
    """The sensitivity (3 f, Q) after each step; the last of `chunks` has the state there."""

    def keep(chunk: Rollout) -> None:
        chunks[:] = [chunk]

    if wanted.width and one_by_one(system, wanted, tape.steps):
        yield from tangents(system, tape, wanted, tolerance, keep)
        return
    if wanted.width:
        yield from (dx.copy() for dx in sweep(system, tape, wanted, keep))  # it is always the same array
        return
    for chunk in tape.forward():
        keep(chunk)
        for _ in range(chunk.steps):
            yield np.zeros((3 * int(mobile(system).sum()), 0))


def spread(sensitivity: Array, free: Flags) -> Array:
    """A sensitivity (3 f, Q) of the free vertices as that of all, (n, 3, Q)."""
    whole = np.zeros((len(free), 3, sensitivity.shape[1]))
    whole[free] = sensitivity.reshape(-1, 3, sensitivity.shape[1])
    return whole


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
