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

from clothfit.base.arrays import Array, Flags, Indices
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


    def of(self, other: Registration) -> Array:
        """The coordinates (9,) of a registration near this one."""
        turn, larger = other.rotation @ self.base.rotation.T, other.scale / self.base.scale
        w = 0.5 * np.array([turn[2, 1] - turn[1, 2], turn[0, 2] - turn[2, 0], turn[1, 0] - turn[0, 1]])
        moved = other.translation - self.centre - larger * turn @ (self.base.translation - self.centre)
        clock = np.log(other.rate / self.base.rate), other.offset - self.base.offset
        return np.array([*clock, *w, *moved, np.log(larger)]) / self.scale


def around(base: Registration, motion: Motion) -> Around:
    """The registrations of a motion around one."""
    points = base.placed(motion.positions[motion.seen()])
    size = float(np.linalg.norm(np.ptp(points, axis=0))) or 1.0
    duration = float(np.ptp(motion.times)) or 1.0
    scale = np.array([0.3, 0.1 * duration, *[0.3] * 3, *[0.1 * size] * 3, 0.1])
    return Around(base, points.mean(axis=0), scale)


class Parts(NamedTuple):
    """What each of the F frames of a cloth of a target adds, its free and its held vertices apart; of H and g the sums
    over all frames, as one, where nobody weights these (`Registered.summing`).
    """

    own: Indices  # (q,), the coordinates that it depends on, of all Q
    cost: Array  # (F, 2), m²
    H: Array  # (F, 2, q, q)
    g: Array  # (F, 2, q)
    mean: Array  # (F, 2), mean squares, m²; NaN where nothing is seen


class Sums(NamedTuple):
    """The cost, m², its normal equations H (Q, Q) and g (Q,), where asked for, and its parts."""

    cost: float
    H: Array
    g: Array
    parts: list[Parts]  # of each cloth of each target


def summed(size: int, parts: Sequence[Parts], trust: Sequence[Array] | None) -> Sums:
    """The sums of parts by so many coordinates, each with its weight of `trust` (F, 2); None: all 1."""
    cost, H, g = 0.0, np.zeros((size, size)), np.zeros(size)
    for number, each in enumerate(parts):
        weight = np.ones(each.cost.shape) if trust is None else trust[number]
        cost += float((weight * each.cost).sum())
        weight = weight[: len(each.H)]
        H[np.ix_(each.own, each.own)] += np.tensordot(weight, each.H, 2)
        g[each.own] += np.tensordot(weight, each.g, 2)
    return Sums(cost, H, g, list(parts))


class State(NamedTuple):
    """A frame of a motion of n vertices, f of them free, with its sensitivity to Q values."""

    frame: int
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
    trust: tuple[Array, ...] | None = None  # weights (F, 2) as in `Sums.parts`; None: all 1
    summing: bool = False  # whether H and g are summed over frames at once: for many values, without weights

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
        parts = list[Parts]()
        for k, systems in enumerate(self.systems):
            own = np.r_[: len(p), len(p) + THETA * k : len(p) + THETA * (k + 1)]
            parts += [self._cloth(k, cloth, own, p, where[k], theta[k], factor) for cloth in systems]
        return summed(size, parts, self.trust)

    def _cloth(
        self, k: int, cloth: int, own: Indices, p: Array, where: Around, theta: Array, factor: Array | None
    ) -> Parts:
        motion, scene = self.given[k]
        now, kept = where.at(theta), slice(self.frames)
        times, points, seen = motion.times[kept], motion.of(cloth)[kept], motion.seen(cloth)[kept]
        weights = motion.weights_of(cloth)
        at = np.maximum(now.times(times), 0.0)
        system = with_elements(self._system(k, cloth, at.max(initial=0.0)), elements(scene, cloth, p))
        wanted = self._columns(system, cloth, p, factor)
        free = mobile(system)
        shape, size = (len(times), 2), 0 if factor is None else wanted.width + THETA
        kept_frames = min(len(times), 1) if self.summing else len(times)
        H, g = (np.zeros((kept_frames, 2, *each)) for each in ((size, size), (size,)))
        found = Parts(own[:size], np.zeros(shape), H, g, np.full(shape, np.nan))
        for state in states(system, at / scene.delta, wanted, self.tolerance):
            i = state.frame
            placed = now.placed(np.where(seen[i][:, None], points[i], 0.0))
            weight = seen[i] * (1.0 if weights is None else weights[i])
            gaps = state.s - placed
            squares = (gaps**2).sum(axis=1)
            if factor is not None:
                u = state.change / scene.delta if now.times(times[i]) > 0.0 else np.zeros_like(gaps)
                J = np.concatenate([
                    spread(state.sensitivity, free),
                    by_registration(u, at[i], placed, where, theta, now.rate),
                ], axis=2)  # fmt: skip
                root = np.sqrt(weight * self.loss.derivative(squares))
            for part, which in enumerate((free, ~free)):
                if not weight[which].any():
                    continue
                found.mean[i, part] = np.average(squares[which], weights=weight[which])
                found.cost[i, part] = weight[which] @ self.loss.value(squares[which])
                if factor is not None:
                    rows = (root[which, None, None] * J[which]).reshape(-1, size)
                    found.H[min(i, kept_frames - 1), part] += rows.T @ rows
                    found.g[min(i, kept_frames - 1), part] += rows.T @ (root[which, None] * gaps[which]).reshape(-1)
        return found

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
            yield State(frame, s, x[1] - x[0], along)
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
