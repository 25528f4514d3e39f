"""A cloth on a basis: its state is q and p (r,), positions x₀ + T + U q and velocities Ṫ + U p of the free vertices,
with T what carries them (`carrier`).

Here is what no step changes, and the matrix and the copies at a state, for a cubature; `march` takes the steps. They
are those of the scene's method, projected: implicit Euler with all its Newton iterations, or BDF2 whose inner step
begins at the extrapolated state, as `engine.step.bdf2` has it. Steps are never shortened (`engine.step.guard`).
"""

from __future__ import annotations

from copy import copy
from typing import Protocol

import numpy as np

from clothfit.base.arrays import Array
from clothfit.base.errors import InvalidInput
from clothfit.engine.system import BDF2, IMPLICIT, System, meets_itself
from clothfit.subspace import carrier
from clothfit.subspace.physics import samples


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
        weighted = self.basis * system.vertex.mass[:, None, None]
        self.mass = np.asfortranarray(weighted.reshape(-1, self.r).T @ self.basis.reshape(-1, self.r))  # Uᵀ M U
        self.weight = np.ascontiguousarray(weighted.sum(axis=0).T)  # Uᵀ M 1, (r, 3)
        self.alpha = system.vertex.damping
        copies, points = len(self.layout.point), len(self.layout.constant)
        self.A = samples.blocks(self.layout)
        self.b, self.y, self.u = (np.zeros((copies, 3)) for _ in range(3))
        self.at_points, self.both = np.zeros((points, 3)), np.zeros((2, 3 * points))
        self.up, self.down = (np.empty((3 * copies, self.r)) for _ in range(2))  # filled as far as needed

    def under(self, system: System) -> Reduced:
        """The same cloth under other inputs over time, with the same pins; it shares memory with this one."""
        other = copy(self)
        other.system = system
        other.path, other.held, other.v_held = carrier.paths(system)
        other.own = self.own._replace(inputs=system.inputs)
        return other

    def velocities(self, p: Array, pins: Array) -> Array:
        """The velocities (copies, 3) for coordinates' p (r,) and those of the pins and their mean (P + 1, 3)."""
        points, out = self.at_points, np.zeros_like(self.b)
        np.dot(self.layout.rows, p, out=points.reshape(-1))
        if len(self.layout.pinned):
            samples.add_pins(self.layout, pins, points)
        samples.spread(self.layout, points, out)
        return out

    def linearise(self, q: Array, p: Array, t: int, cap: float = np.inf) -> None:
        """Write the blocks A and b of the copies for an implicit Euler step t from a state q, p (r,), with springs that
        push sideways up to `cap` times as much as they pull.
        """
        points, lay = self.at_points, self.layout
        x, v, _ = self.places(t)
        for out, pins in ((self.y, x - self.held), (self.u, v)):
            points[:] = 0.0
            if len(lay.pinned):
                samples.add_pins(lay, pins, points)
            samples.spread(lay, points, out)
        np.dot(lay.rows, q, out=self.both[0])
        np.dot(lay.rows, p, out=self.both[1])
        forces = self.own._replace(springs=self.own.springs._replace(cap=cap, bend=0.0))
        samples.linearise(forces, lay, self.both, self.h, self.y, self.u, self.A, self.b)

    def matrix(self) -> Array:
        """The projected matrix (r, r) of what is linearised."""
        more, less = samples.factors(self.layout, self.A, self.up, self.down)
        up, down = self.up[:more], self.down[:less]
        A = (1.0 + self.h * self.alpha) * self.mass + up.T @ up  # NumPy computes one half of a square
        if less:
            A -= down.T @ down
        return np.asarray(A)

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


def check(system: System) -> None:
    """Raise InvalidInput for what subspaces do not have."""
    if system.method not in (IMPLICIT, BDF2):
        raise InvalidInput("a subspace needs implicit steps: integrationMethod 2 or 3")
    if meets_itself(system):
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
