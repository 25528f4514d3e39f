"""Effort and its gradient along motions that springs hold near a path.

With f the unknown forces, κ and R what the springs pull with and to, each step of the closed loop ends at the x⁺ of
u = f + κ (R − x⁺), and u are the forces that take the cloth there without springs. Effort counts u, so the springs cost
nothing of their own: they only change the coordinates in which the least effort is sought, from u, by which a cloth
that buckles or flutters depends on its start by factors of 10²⁰, to f, by which it hardly depends at all. Springs that
are stiff for one step hold the keys; where a key asks for vertices without forces, or for a mean, it is a penalty with
a multiplier (the augmented Lagrangian; J. Nocedal, S. J. Wright, Numerical Optimization, section 17.3).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any, NamedTuple

import numpy as np
from scipy.sparse import csr_array

from clothfit.base.arrays import Array, Flags, Indices
from clothfit.control.keyframes import Key, left_of
from clothfit.derivative import adjoint
from clothfit.engine.rollout import rollout
from clothfit.engine.system import IMPLICIT, System, build
from clothfit.scene.cloth import Cloth
from clothfit.scene.forces import Forces
from clothfit.scene.scene import Scene

STIFF, STIFF_HARD = 1e4, 1e6
"""Gain at a key relative to m/h², and at a hard one: the share of a miss that is left is its inverse."""

SLOW = 0.5
"""Largest rate of springs over explicit steps, relative to the inverse of a step, so that they are stable."""

SOLVE_TOLERANCE, FINEST = 1e-6, 1e-11
"""Of the linear systems, relative: errors of effort and gradient below those that a descent sees, until it comes to its
last digits.
"""

HUGE = 1e100
"""The effort of motions that diverge."""

EXCESS = 1e4
"""Weight of the squared excess of a force over its bound, relative to that of the squared force."""


@dataclass(frozen=True, eq=False)
class Wish:
    """A key that is no spring: a penalty on what is left of it."""

    key: Key
    multiplier: Array  # (m, 3), N² s/m

    def left(self, x: Array) -> Array:
        """What is left of it at positions x (T + 1, n, 3): (m, 3), m."""
        return left_of(self.key, x)


def neighbours(cloth: Cloth, pushed: Flags) -> csr_array:
    """The matrix (L, n), 1/m, of differences along the L springs between vertices with forces, over their lengths."""
    kept = pushed[cloth.springs].all(axis=1)
    springs, length = cloth.springs[kept], cloth.lengths[kept]
    rows = np.arange(len(springs)).repeat(2)
    values = np.stack([-1.0 / length, 1.0 / length], axis=1).reshape(-1)
    return csr_array((values, (rows, springs.reshape(-1))), shape=(len(springs), len(pushed)))


@dataclass(frozen=True)
class Costs:
    """What counts beside the effort."""

    smooth: float = 0.0  # s: the effort of a change of the forces in this time counts as theirs
    most: float = np.inf  # N, on a vertex
    even: float = 0.0  # m: that of a difference between neighbours that far apart counts as theirs


class Task(NamedTuple):
    """What is asked of one cloth."""

    scene: Scene
    cloth: int  # counted from 0
    keys: Sequence[Key]
    pushed: Flags  # (n,), the vertices with forces
    costs: Costs = Costs()


class ClosedLoop:
    """The effort of one cloth up to its last key, for forces f (T, n, 3), N, 0 where they are not `unknown`."""

    def __init__(self, task: Task, path: Array, rate: float) -> None:
        """`path` (T + 1, n, 3), m; `rate`: of the springs, 1/s."""
        scene, cloth, _, pushed, _ = task
        self.scene, self.cloth, self.keys, self.pushed, self.costs = task
        self.steps, self.h, mass = len(path) - 1, scene.delta, scene.cloths[cloth].mass
        self.late = scene.method >= IMPLICIT  # whether springs pull from where a step ends, or from where it begins
        self.rate, self.path = rate if self.late else min(rate, SLOW / scene.delta), path
        self.gain = np.tile(np.where(pushed, self.rate**2 * mass, 0.0), (self.steps, 1))
        self.places = path[1:].copy()
        self.unknown = np.tile(pushed, (self.steps, 1))  # (T, n): where springs hold a key, they alone act
        self.wishes = list(self.held(mass))
        self.system = self.built()
        self.penalty, self.evaluations, self.tolerance = 0.0, 0, SOLVE_TOLERANCE
        self.x, self.u = path, np.zeros_like(self.places)
        self.steepest = 0.0  # `slope` where the search began; 0: not yet

    def held(self, mass: Array) -> list[Wish]:
        """Make springs of the keys that can be; returns the others."""
        left = []
        for key in self.keys:
            own = np.zeros(0, bool) if key.share is not None else self.pushed[key.vertices] & self.late
            if key.share is not None or not own.all():
                rest = key
                if key.share is None:
                    rest = replace(key, vertices=key.vertices[~own], positions=key.positions[~own])
                left.append(Wish(rest, np.zeros_like(rest.positions)))
            if own.any():
                stiff = (STIFF_HARD if key.hard else STIFF) * mass / self.h**2
                self.hold(key.step, key.vertices[own], key.positions[own], stiff)
                if key.velocities is not None and key.step > 1:
                    before = key.positions[own] - self.h * key.velocities[own]
                    self.hold(key.step - 1, key.vertices[own], before, stiff)
        return left

    def hold(self, step: int, vertices: Indices, positions: Array, stiff: Array) -> None:
        """Let springs of that stiffness (n,), N/m, pull vertices to positions in one step."""
        self.gain[step - 1, vertices] = stiff[vertices]
        self.places[step - 1, vertices] = positions
        self.unknown[step - 1, vertices] = False

    def built(self) -> System:
        """The system with these springs, and no forces yet."""
        own, times = self.scene.vertices(self.cloth), self.h * np.arange(self.steps, dtype=float)
        shape = self.steps, sum(self.scene.vertex_counts)
        gain, places = np.zeros(shape), np.zeros((*shape, 3))
        gain[:, own], places[:, own] = self.gain, self.places
        springs = Forces(times, np.zeros((*shape, 3)), gain, places, pulls=True)
        return build(self.scene.with_forces(springs), self.cloth, steps=self.steps)

    def total(self, f: Array, x: Array) -> Array:
        """The forces u (T, n, 3), N, with which x (T + 1, n, 3) needs no springs."""
        pulled = self.gain[:, :, None] * (self.places - (x[1:] if self.late else x[:-1]))
        return np.asarray(np.where(self.pushed[:, None], f + pulled, 0.0))

    def __call__(self, f: Array) -> tuple[float, Array]:
        """Effort and penalties, N² s, and their gradient by f (T, n, 3)."""
        assert self.system.inputs is not None
        self.evaluations += 1
        self.system.inputs.force[: self.steps] = f
        motion, good = rollout(self.system, self.steps, self.tolerance)
        if good < self.steps:
            return HUGE, np.zeros_like(f)
        x = self.x = motion.x
        u = self.u = self.total(f, x)
        value, by_force = self.priced(u)
        by_position = np.zeros_like(x)
        pulled = by_position[1:] if self.late else by_position[:-1]
        pulled -= self.gain[:, :, None] * by_force
        value += self.add_penalties(x, by_position)
        grad = adjoint.gradient(self.system, motion, by_position, self.tolerance, ("force",)).force[: self.steps]
        gradient = np.where(self.unknown[:, :, None], grad + by_force, 0.0)
        if not (np.isfinite(value) and np.isfinite(gradient).all()):
            return HUGE, np.zeros_like(f)
        return value, gradient

    def priced(self, u: Array) -> tuple[float, Array]:
        """What forces u (T, n, 3) cost, N² s, and its gradient by them."""
        h, own = self.h, self.costs
        value, gradient = h * float((u * u).sum()), 2.0 * h * u
        if own.smooth > 0.0:
            weight = own.smooth**2 / h
            change = np.diff(u, axis=0)
            value += weight * float((change * change).sum())
            gradient[1:] += 2.0 * weight * change
            gradient[:-1] -= 2.0 * weight * change
        if own.even > 0.0:
            uneven = (self.net @ u.transpose(1, 0, 2).reshape(u.shape[1], -1)).reshape(-1, len(u), 3)
            value += h * own.even**2 * float((uneven * u.transpose(1, 0, 2)).sum())
            gradient += 2.0 * h * own.even**2 * uneven.transpose(1, 0, 2)
        if np.isfinite(own.most):
            size = np.sqrt((u * u).sum(axis=2, keepdims=True))
            over = np.maximum(size - own.most, 0.0)
            value += EXCESS * h * float((over * over).sum())
            gradient += 2.0 * EXCESS * h * over * u / np.maximum(size, own.most)
        return value, gradient

    @cached_property
    def net(self) -> csr_array:
        """The Laplacian (n, n), 1/m², of the springs between vertices with forces."""
        own = neighbours(self.scene.cloths[self.cloth], self.pushed)
        return csr_array(own.T @ own)

    def add_penalties(self, x: Array, by_position: Array) -> float:
        """The penalties at x (T + 1, n, 3), N² s; their gradient is added to by_position."""
        value = 0.0
        for wish in self.wishes:
            key, left = wish.key, wish.left(x)
            weight = self.penalty * key.weight
            value += weight * float((left * left).sum()) + float((wish.multiplier * left).sum())
            bar = 2.0 * weight * left + wish.multiplier
            by_position[key.step, key.vertices] += bar if key.share is None else key.share[:, None] * bar
        return value

    def insist(self) -> None:
        """Raise the multipliers by what is left now."""
        self.wishes = [
            replace(wish, multiplier=wish.multiplier + 2.0 * self.penalty * wish.key.weight * wish.left(self.x))
            for wish in self.wishes
        ]

    @property
    def way(self) -> dict[str, Any]:
        """What a loop with other steps, or a search that goes on, takes over from this one."""
        left = np.concatenate([np.zeros(0), *(wish.multiplier.reshape(-1) for wish in self.wishes)])
        return {"multipliers": left, "penalty": self.penalty, "steepest": self.steepest}

    def resume(self, multipliers: Array, penalty: float, steepest: float) -> None:
        """Take the multipliers (M,) of all wishes, one after another, the penalty and the first slope over."""
        self.penalty, self.steepest = penalty, steepest
        parts = np.split(multipliers, np.cumsum([wish.multiplier.size for wish in self.wishes], dtype=int))
        pairs = zip(self.wishes, parts, strict=False)  # after the last nothing is left
        self.wishes = [replace(wish, multiplier=own.reshape(-1, 3)) for wish, own in pairs]

    def slope(self, gradient: Array) -> float:
        """The norm of a gradient by √(2 h) f, which does not depend on the length of steps."""
        return float(np.linalg.norm(gradient) / np.sqrt(2.0 * self.h))

    @property
    def missed(self) -> float:
        """Root mean square, m, of what is left of the keys that are penalties."""
        left = [wish.left(self.x) for wish in self.wishes]
        return float(np.sqrt(np.mean(np.concatenate(left) ** 2) * 3.0)) if left else 0.0

    @property
    def effort(self) -> float:
        """Σ |u|² h, N² s."""
        return self.h * float((self.u * self.u).sum())
