"""Derivatives of a whole motion: the reverse sweep (gradient) and the forward sweep (tangent).

Both walk through a Rollout step by step and know no physics: a step's transpose and tangent do the work. For a cost
G(x₁ … x_T) the reverse sweep gives ∂G/∂m and ∂G/∂k of every vertex and spring at the price of about one more
simulation; the forward sweep gives the change of all positions along one direction in them. They are each other's
transpose.
"""

from __future__ import annotations

import numpy as np

from clothfit import guess
from clothfit.arrays import Array, Elements
from clothfit.kernel import kernel
from clothfit.rollout import Rollout, velocity
from clothfit.step import implicit, transition
from clothfit.system import System
from clothfit.vectors import add, copy


def gradient(system: System, memory: Rollout, by_position: Array, tolerance: float) -> Elements:
    """∂G/∂m (n,) and ∂G/∂k (S,) from by_position = ∂G/∂x (T + 1, n, 3), along a finished rollout."""
    grad = Elements(np.zeros_like(system.vertex.mass), np.zeros_like(system.springs.stiffness))
    sweep_back(system, memory, np.ascontiguousarray(by_position), tolerance, implicit.workspace(system), grad)
    return grad


def tangent(system: System, memory: Rollout, direction: Elements, tolerance: float) -> Array:
    """Change of all positions (T + 1, n, 3) for the change `direction` of masses (n,) and stiffnesses (S,)."""
    dx = np.zeros_like(memory.x)
    sweep_forward(system, memory, direction, tolerance, implicit.workspace(system), dx)
    return dx


@kernel
def sweep_back(system, memory, by_position, tolerance, work, grad):
    x, w, used, _ = memory
    steps = len(w)
    x_bar, v_bar = np.zeros_like(x[0]), np.zeros_like(x[0])
    for t in range(steps - 1, -1, -1):
        add(1.0, by_position[t + 1], x_bar)
        v = velocity(memory, t)
        guess.advance(work.past, steps - 1 - t, work.solution)
        transition.pullback(system, x[t], v, w[t], used[t], tolerance, work, x_bar, v_bar, grad)


@kernel
def sweep_forward(system, memory, direction, tolerance, work, change):
    x, w, used, _ = memory
    dx, dv = np.zeros_like(x[0]), np.zeros_like(x[0])
    for t in range(len(w)):
        v = velocity(memory, t)
        guess.advance(work.past, t, work.solution)
        transition.pushforward(system, x[t], v, w[t], used[t], tolerance, work, dx, dv, direction)
        copy(dx, change[t + 1])
