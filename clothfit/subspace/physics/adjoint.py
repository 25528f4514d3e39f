"""The exact adjoint and tangent of reduced motions, by the derivatives of the engine's forces on the copies.

An iteration solves r(ω) = A ω − b = 0 (`step`). Backwards, with ω̄ the gradient by ω: A λ = ω̄, and what −λᵀ r depends
on gets its derivative, force by force, with λ on the copies, times their weights (`engine.forces`). The masses come in
through Uᵀ M U and Uᵀ M 1 only, so their gradient is kept as two small tables, S (r, r) and s (r, 3), until the end:

    ∂G/∂m_i = tr(U_i S U_iᵀ) + Σ_c U_ic · s_c.

What elements that are not evaluated would add is 0: a gradient by single stiffnesses is that of the cubature's sums. It
is exact for the reduced motion, and complete for values that many springs share.
"""

from __future__ import annotations

from collections.abc import Collection, Sequence
from dataclasses import dataclass

import numpy as np

from clothfit.base import interrupts
from clothfit.base.arrays import Array, Elements
from clothfit.engine.system import BDF2, all_elements, zeros
from clothfit.subspace.physics import step
from clothfit.subspace.physics.reduced import Iteration, Reduced, State

KINDS = ("damping", "drag", "rest", "wind", "gravity")
"""What there are derivatives by, besides masses and stiffnesses."""

OF_ELEMENTS = ("stiffness", "rest")
"""Kinds with a value for each spring."""


@dataclass
class Trajectory:
    """A reduced motion, with all that its derivatives need."""

    states: list[State]
    iterations: list[list[tuple[Iteration, Array]]]  # of each step

    @property
    def q(self) -> Array:
        """The coordinates (T + 1, r)."""
        return np.stack([state.q for state in self.states])


def simulate(own: Reduced, steps: int) -> Trajectory:
    """A motion from the start. It ends early where its coordinates are no longer finite."""
    made = Trajectory([own.start()], [])
    for _ in range(steps):
        after, iterations = own.advance(made.states[-1])
        if not np.isfinite(after.q).all():
            break
        made.states.append(after)
        made.iterations.append(iterations)
    return made


class Derivative:
    """What both sweeps share: an iteration of a motion, linearised again."""

    def __init__(self, own: Reduced) -> None:
        self.own, lay = own, own.layout
        self.w, self.s, self.lam, self.gy, self.gu = (np.zeros((len(lay.point), 3)) for _ in range(5))

    def linearise(self, at: Iteration, w: Array) -> None:
        """Set y, u, w and s of the copies, the blocks and the factor of the matrix."""
        own = self.own
        own.linearise(at)
        self.factor, fault = own.lapack.dpotrf(own.matrix(at), overwrite_a=True, clean=False)
        assert not fault  # the motion was solved with it
        own.to_copies(w, at.pins[2], self.w, False)
        self.s[:] = at.h * (self.w - own.u) if at.ahead else at.h * self.w

    def solve(self, right: Array) -> Array:
        """A⁻¹ times a vector (r,)."""
        return np.asarray(self.own.lapack.dpotrs(self.factor, right)[0])

    def rows_times(self, coordinates: Array, out: Array) -> None:
        """Write R times coordinates (r,) to the copies."""
        points = self.own.at_points
        np.dot(self.own.layout.rows, coordinates, out=points.reshape(-1))
        step.spread(self.own.layout, points, out)

    def times_rows(self, copies: Array) -> Array:
        """Rᵀ times values (copies, 3), (r,)."""
        points = self.own.at_points
        points[:] = 0.0
        step.gather(self.own.layout, copies, points)
        return np.asarray(points.reshape(-1) @ self.own.layout.rows)

    def stiffness_times(self, at: Iteration, v: Array) -> Array:
        """−h² K v for coordinates v (r,), as B + h D."""
        own = self.own
        self.rows_times(v, self.gu)
        out = np.zeros_like(self.gy)
        step.weighted_blocks(own.layout, own.A, self.gu, out)
        step.add_damping(own.forces(at), own.layout, own.y, own.u, at.h, self.gu, out)
        return self.times_rows(out)

    def momentum(self, at: Iteration, w: Array) -> tuple[Array, Array]:
        """What the projected masses multiply in the equation: base − (1 + hα) ω, (r,), and what Uᵀ M 1 does, (3,)."""
        grown = 1.0 + at.h * self.own.alpha
        moved = at.carried - grown * at.pins[2][-1] if len(at.pins[2]) else np.zeros(3)
        return at.base - grown * w, at.h * self.own.own.vertex.gravity + moved


class Backward(Derivative):
    """The sweep from the end to the start."""

    def __init__(self, own: Reduced, kinds: Collection[str] = ()) -> None:
        """`kinds` of `KINDS`, besides masses and stiffnesses."""
        super().__init__(own)
        self.grad = zeros(own.system, kinds)
        few = {name: np.zeros(len(own.chosen.springs)) for name in OF_ELEMENTS if len(getattr(self.grad, name))}
        self.few = self.grad._replace(mass=np.zeros(0), **few)
        self.S, self.s_table = np.zeros((own.r, own.r)), np.zeros((own.r, 3))

    def through(self, motion: Trajectory, by_q: Array) -> Elements:
        """The gradient by all values, for one by the coordinates (T + 1, r)."""
        q_bar, p_bar = by_q.copy(), np.zeros_like(by_q)
        for t in range(len(motion.iterations) - 1, -1, -1):
            step.begin(self.own.own, t)
            self.step(motion, t, q_bar, p_bar)
            interrupts.check()
        return self.total(motion.states[0].p, p_bar[0])

    def step(self, motion: Trajectory, t: int, q_bar: Array, p_bar: Array) -> None:
        """Carry the gradient by state t + 1 to state t, and to the one before where a BDF2 step knows it."""
        second = self.own.system.method == BDF2 and motion.states[t].before is not None
        iterations = motion.iterations[t]
        h = iterations[-1][0].h
        w_bar, base_q, base_p = p_bar[t + 1] + h * q_bar[t + 1], q_bar[t + 1].copy(), np.zeros(self.own.r)
        for k in range(len(iterations) - 1, -1, -1):
            at, w = iterations[k]
            by_y, by_u, by_base = self.iteration(at, w, w_bar)
            base_q += by_y
            base_p += by_base
            w_bar = by_u
        if not second:
            q_bar[t] += base_q
            p_bar[t] += base_p + w_bar
            return
        q_bar[t] += 4.0 / 3.0 * base_q
        p_bar[t] += 4.0 / 3.0 * base_p + 2.0 * w_bar
        q_bar[t - 1] -= base_q / 3.0
        p_bar[t - 1] -= base_p / 3.0 + w_bar

    def iteration(self, at: Iteration, w: Array, w_bar: Array) -> tuple[Array, Array, Array]:
        """The gradients by the position where the step begins, by u and by the base velocity, (r,) each."""
        own, lay = self.own, self.own.layout
        self.linearise(at, w)
        lam = self.solve(w_bar)
        points = own.at_points
        np.dot(lay.rows, lam, out=points.reshape(-1))
        step.spread_weighted(lay, points, self.lam)
        self.gy[:] = 0.0
        self.gu[:] = 0.0
        step.pull(own.forces(at), lay, at.h, own.y, own.u, self.w, self.s, self.lam, self.few, self.gy, self.gu)
        by_y, by_u = self.times_rows(self.gy), self.times_rows(self.gu)
        self.add_masses(at, w, lam)
        if at.ahead:
            by_u = by_u + at.h * by_y + self.stiffness_times(at, lam)
        return by_y, by_u, own.mass @ lam

    def add_masses(self, at: Iteration, w: Array, lam: Array) -> None:
        """The part of an iteration in the gradients by masses, damping of vertices, and gravity."""
        own, grad = self.own, self.grad
        by_mass, by_weight = self.momentum(at, w)
        self.S += np.outer(lam, by_mass)
        self.s_table += np.outer(lam, by_weight)
        if len(grad.damping):
            moved = own.weight @ at.pins[2][-1] if len(at.pins[2]) else 0.0
            grad.damping[0] -= at.h * (lam @ (own.mass @ w + moved))
        if len(grad.gravity):
            grad.gravity[:] += at.h * (lam @ own.weight)

    def total(self, p: Array, p_bar: Array) -> Elements:
        """The gradient, elements that are not evaluated with 0, for the velocity p (r,) at the start and the gradient
        by it: Uᵀ M U p = Uᵀ M v.
        """
        U, grad, few = self.own.basis, self.grad, self.few
        lam = np.linalg.solve(self.own.mass, p_bar)
        self.S -= np.outer(lam, p)
        mass = np.einsum("icr,rs,ics->i", U, self.S, U, optimize=True) + np.einsum("icr,rc->i", U, self.s_table)
        mass += ((U @ lam) * self.own.begins()).sum(axis=1)
        changed = {"mass": mass}
        for name in OF_ELEMENTS:
            if len(getattr(grad, name)):
                changed[name] = getattr(grad, name).copy()
                np.add.at(changed[name], self.own.chosen.springs, getattr(few, name))
        return grad._replace(**changed)


class Forward(Derivative):
    """The sweep along one direction."""

    def __init__(self, own: Reduced, direction: Elements) -> None:
        super().__init__(own)
        chosen, U = own.chosen.springs, own.basis
        few = {name: getattr(direction, name)[chosen] for name in OF_ELEMENTS if len(getattr(direction, name))}
        self.direction, self.few = direction, direction._replace(mass=np.zeros(0), **few)
        weighted = U * direction.mass[:, None, None]
        self.mass = weighted.reshape(-1, own.r).T @ U.reshape(-1, own.r)
        self.weight = weighted.sum(axis=0).T

    def through(self, motion: Trajectory) -> Array:
        """The change of the coordinates (T + 1, r)."""
        dq, dp = (np.zeros((len(motion.states), self.own.r)) for _ in range(2))
        weighted = (self.own.basis * self.direction.mass[:, None, None]).reshape(-1, self.own.r)
        right = weighted.T @ self.own.begins().ravel() - self.mass @ motion.states[0].p
        dp[0] = np.linalg.solve(self.own.mass, right)
        for t in range(len(motion.iterations)):
            step.begin(self.own.own, t)
            self.step(motion, t, dq, dp)
            interrupts.check()
        return dq

    def step(self, motion: Trajectory, t: int, dq: Array, dp: Array) -> None:
        """The change of state t + 1 from those before."""
        second = self.own.system.method == BDF2 and motion.states[t].before is not None
        base_q, base_p, du = dq[t], dp[t], dp[t]
        if second:
            base_q, base_p = dq[t] + (dq[t] - dq[t - 1]) / 3.0, dp[t] + (dp[t] - dp[t - 1]) / 3.0
            du = 2.0 * dp[t] - dp[t - 1]
        h = motion.iterations[t][-1][0].h
        for at, w in motion.iterations[t]:
            du = self.iteration(at, w, base_q, base_p, du)
        dq[t + 1], dp[t + 1] = base_q + h * du, du

    def iteration(self, at: Iteration, w: Array, base_q: Array, base_p: Array, du: Array) -> Array:
        """The change of ω (r,)."""
        own, lay = self.own, self.own.layout
        self.linearise(at, w)
        right = own.mass @ base_p
        if at.ahead:
            right += self.stiffness_times(at, du)
        dy, change = self.gy, self.lam
        self.rows_times(base_q + at.h * du if at.ahead else base_q, dy)
        self.rows_times(du, self.gu)
        step.push(own.forces(at), lay, at.h, own.y, own.u, self.w, self.s, dy, self.gu, self.few, change)
        right += self.times_rows(change)
        by_mass, by_weight = self.momentum(at, w)
        right += self.mass @ by_mass + self.weight @ by_weight
        if len(self.direction.damping):
            moved = own.weight @ at.pins[2][-1] if len(at.pins[2]) else 0.0
            right -= at.h * self.direction.damping[0] * (own.mass @ w + moved)
        if len(self.direction.gravity):
            right += at.h * (own.weight @ self.direction.gravity)
        return self.solve(right)


def gradient(own: Reduced, motion: Trajectory, by_q: Array, kinds: Collection[str] = ()) -> Elements:
    """The gradient of a cost by masses, stiffnesses and `kinds`, for its gradient by the coordinates (T + 1, r)."""
    return Backward(own, kinds).through(motion, by_q)


def tangent(own: Reduced, motion: Trajectory, direction: Elements) -> Array:
    """The change of the coordinates (T + 1, r) along a direction; its empty fields do not change."""
    return Forward(own, direction).through(motion)


def with_values(own: Reduced, values: Sequence[Array] | Elements) -> Reduced:
    """The same subspace of the cloth with other values."""
    from clothfit.engine.system import with_elements

    given = values if isinstance(values, Elements) else Elements(*values)
    return Reduced(with_elements(own.system, given), own.basis, own.chosen)


def values_of(own: Reduced) -> Elements:
    """The values that a reduced cloth has now."""
    return all_elements(own.system)
