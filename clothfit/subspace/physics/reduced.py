"""A cloth on a basis: its state is q and p (r,), positions x₀ + T + U q and velocities Ṫ + U p of the free vertices,
with T what carries them (`carrier`).

Each step is that of the scene's method, projected (`step`): implicit Euler with all its Newton iterations, or BDF2
whose inner step begins at the extrapolated state, as `engine.step.bdf2` has it. Where the projected matrix is not
positive definite, an iteration is solved with that of the clamped springs. Steps are never shortened
(`engine.step.guard`). Here steps are taken one by one, in double precision, for derivatives; `march` plays.
"""

from __future__ import annotations

from copy import copy
from dataclasses import dataclass, replace
from typing import Any, Protocol

import numpy as np

from clothfit.base.arrays import Array
from clothfit.base.errors import InvalidInput
from clothfit.engine.step import bdf2
from clothfit.engine.system import BDF2, IMPLICIT, System
from clothfit.subspace import carrier
from clothfit.subspace.physics import samples, step


@dataclass
class State:
    """A state of the reduced cloth, and the one a step before it where BDF2 needs that."""

    q: Array  # (r,)
    p: Array  # (r,), 1/s
    before: tuple[Array, Array] | None = None  # q, p one step before
    t: int = 0  # steps since the start


@dataclass
class Iteration:
    """Where an iteration is linearised, and what it starts from: q, p as in `State`; places (P, 3) of the pins."""

    y: Array  # (r,), of the positions
    u: Array  # (r,), of the velocities
    base: Array  # (r,), velocities before the step: p, or p̃
    h: float  # s
    ahead: bool  # whether y is h u from where the step begins
    pins: tuple[Array, Array, Array]  # y, u and w of the pins, (P + 1, 3) each, the last row that of their mean
    carried: Array  # (3,), the mean's velocity before the step
    cap: float = np.inf  # of the springs
    bend: float = 0.0


class Based(Protocol):
    """A cloth on a basis, whatever steps it."""

    system: System
    basis: Array  # (n, 3, r)
    r: int


class Reduced:
    """The projected steps of one cloth."""

    def __init__(self, system: System, basis: Array, chosen: samples.Selection | None = None) -> None:
        """`basis` U (n, 3, r), 0 at fixed vertices. Raises InvalidInput for what subspaces do not have."""
        check(system)
        self.system, self.basis = system, np.ascontiguousarray(basis)
        self.chosen = samples.everything(system) if chosen is None else chosen
        self.layout, self.own = samples.build(system, basis, self.chosen)
        self.r, self.h = basis.shape[2], system.h
        self.path, self.held, self.v_held = carrier.paths(system)
        self._measure()
        self._make_room()

    def _measure(self) -> None:
        """The projected masses, which no step changes."""
        weighted = self.basis * self.system.vertex.mass[:, None, None]
        flat = self.basis.reshape(-1, self.r)
        self.mass = np.asfortranarray(weighted.reshape(-1, self.r).T @ flat)  # Uᵀ M U
        self.weight = np.ascontiguousarray(weighted.sum(axis=0).T)  # Uᵀ M 1, (r, 3)
        self.alpha = self.system.vertex.damping

    def _make_room(self) -> None:
        copies, points = len(self.layout.point), len(self.layout.constant)
        self.A = samples.blocks(self.layout)
        self.b, self.y, self.u, self.w = (np.zeros((copies, 3)) for _ in range(4))
        self.at_points, self.both = np.zeros((points, 3)), np.zeros((2, 3 * points))
        self.up, self.down = (np.empty((3 * copies, self.r)) for _ in range(2))  # filled as far as needed
        from scipy.linalg import lapack

        self.lapack = lapack

    def under(self, system: System) -> Reduced:
        """The same cloth under other inputs over time, with the same pins; it shares memory with this one."""
        other = copy(self)
        other.system = system
        other.path, other.held, other.v_held = carrier.paths(system)
        other.own = self.own._replace(inputs=system.inputs)
        return other

    def start(self) -> State:
        """The state at the start; velocities are projected on the basis."""
        momentum = (self.basis * self.system.vertex.mass[:, None, None]).reshape(-1, self.r).T
        p = np.linalg.solve(self.mass, momentum @ self.begins().ravel())
        return State(np.zeros(self.r), np.asarray(p, float))

    def begins(self) -> Array:
        """The velocities (n, 3) at the start, past what carries the cloth, m/s."""
        return np.asarray(self.system.v0 - mean_of(self.v_held))

    def to_copies(self, coordinates: Array, pins: Array, out: Array, constant: bool) -> None:
        """Write positions, with the `constant`, or velocities of the copies for coordinates (r,) and pins (P, 3)."""
        points = self.at_points
        np.dot(self.layout.rows, coordinates, out=points.reshape(-1))
        if constant:
            points += self.layout.constant
            pins = pins - self.held
        if len(self.layout.pinned):
            step.add_pins(self.layout, pins, points)
        step.spread(self.layout, points, out)

    def linearise(self, at: Iteration) -> Array:
        """Write y, u and ċ of the copies, the blocks and b; returns the projected b − B ċ, (r,)."""
        points, lay = self.at_points, self.layout
        of_pins = at.pins[0] - self.held, at.pins[1], at.pins[2]
        for out, pins in zip((self.y, self.u, self.w), of_pins, strict=True):
            if len(lay.pinned):
                points[:] = 0.0
                step.add_pins(lay, pins, points)
                step.spread(lay, points, out)
            else:
                out[:] = 0.0
        np.dot(lay.rows, at.y, out=self.both[0])
        np.dot(lay.rows, at.u, out=self.both[1])
        step.linearise(self.forces(at), lay, self.both, at.h, at.ahead, self.y, self.u, self.w, self.A, self.b, points)
        return np.asarray(points.reshape(-1) @ lay.rows)

    def forces(self, at: Iteration) -> samples.Sampled:
        """The forces with the springs that an iteration takes."""
        return self.own._replace(springs=self.own.springs._replace(cap=at.cap, bend=at.bend))

    def matrix(self, at: Iteration) -> Array:
        """The projected matrix (r, r) of what is linearised."""
        more, less = step.factors(self.layout, self.A, self.up, self.down)
        up, down = self.up[:more], self.down[:less]
        A = (1.0 + at.h * self.alpha) * self.mass + up.T @ up  # NumPy computes one half of a square
        if less:
            A -= down.T @ down
        return np.asarray(A)

    def solve(self, at: Iteration) -> tuple[Array, Iteration]:
        """The new velocity (r,) of an iteration, and the iteration as it was taken."""
        right = self.linearise(at) + self.mass @ at.base + at.h * (self.weight @ self.own.vertex.gravity)
        if len(self.path):
            right -= self.weight @ ((1.0 + at.h * self.alpha) * at.pins[2][-1] - at.carried)
        factor, fault = self.lapack.dpotrf(self.matrix(at), overwrite_a=True, clean=False)
        if fault and not at.cap <= 1.0:
            at = replace(at, cap=1.0, bend=0.0)
            return self.solve(at)
        self.factor = factor
        return self.lapack.dpotrs(factor, right)[0], at

    def advance(self, now: State) -> tuple[State, list[tuple[Iteration, Array]]]:
        """The state after a step, and the iterations that led there, each with its velocity."""
        step.begin(self.own, now.t)
        made: list[tuple[Iteration, Array]] = []
        second = self.system.method == BDF2 and now.before is not None
        for k in range(self.system.newton_iterations):
            at = self.iteration(now, made[k - 1][1] if k else None, second)
            w, at = self.solve(at)
            made.append((at, w))
        h, base = made[-1][0].h, self.base(now) if second else now.q
        after = State(base + h * w, w, (now.q, now.p) if self.system.method == BDF2 else None, now.t + 1)
        return after, made

    def base(self, now: State) -> Array:
        """q̃ of a BDF2 step."""
        assert now.before is not None
        return np.asarray(now.q + (now.q - now.before[0]) / 3.0)

    def iteration(self, now: State, last: Array | None, second: bool) -> Iteration:
        """The first iteration of a step, or one after that with the velocity `last`."""
        x, v, place = self.places(now.t)
        if not second:
            h, q, p = self.h, now.q, now.p
            w = (place - x) / h
            if last is None:
                return Iteration(q, p, p, h, False, (x, v, w), mean_of(v))
            return Iteration(q + h * last, last, p, h, True, (x + h * w, w, w), mean_of(v))
        h, q = 2.0 / 3.0 * self.h, self.base(now)
        assert now.before is not None
        p = now.p + (now.p - now.before[1]) / 3.0
        x_before, v_before, _ = self.places(now.t - 1)
        x_base, v_base = x + (x - x_before) / 3.0, v + (v - v_before) / 3.0
        w = (place - x_base) / h
        u = 2.0 * now.p - now.before[1] if last is None else last
        v_pin = 2.0 * v - v_before if last is None else w
        safe = (np.inf, 0.0) if self.system.newton_iterations > 1 else (1.0, bdf2.BEND)
        pins = x_base + h * v_pin, v_pin, w
        return Iteration(q + h * u, u, p, h, True, pins, mean_of(v_base), *safe)

    def iteration_at(self, sample: Any) -> Iteration:
        """The first iteration of an implicit Euler step from q, p at step t of a sample (`cubature`)."""
        x, v, place = self.places(sample.t)
        return Iteration(sample.q, sample.p, sample.p, self.h, False, (x, v, (place - x) / self.h), mean_of(v))

    def places(self, t: int) -> tuple[Array, Array, Array]:
        """Of the pins and their mean before step t their places and velocities, and their places after it."""
        path = self.path
        if not len(path):
            return self.held, self.held, self.held
        if t == 0:
            return path[0], self.v_held, path[1]
        if self.system.method == BDF2 and t > 1:  # w of the step before: from x̃, by h'
            return path[t], (1.5 * path[t] - 2.0 * path[t - 1] + 0.5 * path[t - 2]) / self.h, path[t + 1]
        return path[t], (path[t] - path[t - 1]) / self.h, path[t + 1]


def mean_of(pins: Array) -> Array:
    """The last row, or 0 without pins."""
    return pins[-1] if len(pins) else np.zeros(3)


def check(system: System) -> None:
    """Raise InvalidInput for what subspaces do not have."""
    if system.method not in (IMPLICIT, BDF2):
        raise InvalidInput("a subspace needs implicit steps: integrationMethod 2 or 3")
    if system.surface is not None:
        raise InvalidInput("selfCollision: a subspace does not know where a cloth touches itself")
    if system.inputs is not None and (len(system.inputs.force) or len(system.inputs.gain)):
        raise InvalidInput("a subspace has no applied forces")


def decode(reduced: Based, q: Array, first: int = 0) -> Array:
    """Positions (T, n, 3), m, of coordinates (T, r) of the frames from `first` on."""
    n = len(reduced.system.x0)
    x = (q @ reduced.basis.reshape(-1, reduced.r).T).reshape(-1, n, 3) + reduced.system.x0
    inputs = reduced.system.inputs
    if inputs is not None and inputs.path.size:
        free = reduced.system.vertex.free
        x[:, free] += carrier.shift(inputs, len(q), first)
        x[:, inputs.pins] = inputs.path[first : first + len(q)]
    return x
