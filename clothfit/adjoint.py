"""Derivatives of a whole motion: the reverse sweep (gradient) and the forward sweep (tangent).

Both walk through a Rollout step by step and know no physics: a step's transpose and tangent do the work. For a cost
G(x₁ … x_T) the reverse sweep gives ∂G/∂m and ∂G/∂k of every vertex and spring at the price of about one more
simulation; the forward sweep gives the change of all positions along one direction in them. They are each other's
transpose.
"""

from __future__ import annotations

import numpy as np

from clothfit import guess, interrupts
from clothfit.arrays import Array, Elements
from clothfit.kernel import kernel
from clothfit.rollout import Rollout, stretches, velocity
from clothfit.step import implicit, transition
from clothfit.system import System
from clothfit.vectors import add, copy


def gradient(system: System, memory: Rollout, by_position: Array, tolerance: float) -> Elements:
    """∂G/∂m (n,) and ∂G/∂k (S,) from by_position = ∂G/∂x (T + 1, n, 3), along a finished rollout."""
    grad = Elements(np.zeros_like(system.vertex.mass), np.zeros_like(system.springs.stiffness))
    by_position, work = np.ascontiguousarray(by_position), implicit.workspace(system)
    x_bar, v_bar = np.zeros_like(system.x0), np.zeros_like(system.x0)
    for first, last in reversed(list(stretches(len(memory.w), len(system.x0)))):
        sweep_back(system, memory, by_position, tolerance, work, first, last, x_bar, v_bar, grad)
        interrupts.check()
    return grad


def tangent(system: System, memory: Rollout, direction: Elements, tolerance: float) -> Array:
    """Change of all positions (T + 1, n, 3) for the change `direction` of masses (n,) and stiffnesses (S,)."""
    change, work = np.zeros_like(memory.x), implicit.workspace(system)
    dx, dv = np.zeros_like(system.x0), np.zeros_like(system.x0)
    for first, last in stretches(len(memory.w), len(system.x0)):
        sweep_forward(system, memory, direction, tolerance, work, first, last, dx, dv, change)
        interrupts.check()
    return change


@kernel
def sweep_back(system, memory, by_position, tolerance, work, first, last, x_bar, v_bar, grad):
    """Carry x_bar, v_bar (n, 3), the gradient by the state after step last − 1, to before step `first`."""
    x, w, used, _ = memory
    for t in range(last - 1, first - 1, -1):
        add(1.0, by_position[t + 1], x_bar)
        v = velocity(memory, t)
        guess.advance(work.past, len(w) - 1 - t, work.solution)
        transition.pullback(system, x[t], v, w[t], used[t], tolerance, work, x_bar, v_bar, grad)


@kernel
def sweep_forward(system, memory, direction, tolerance, work, first, last, dx, dv, change):
    """Carry dx, dv (n, 3), the change of the state before step `first`, to after step last − 1; keep all dx."""
    x, w, used, _ = memory
    for t in range(first, last):
        v = velocity(memory, t)
        guess.advance(work.past, t, work.solution)
        transition.pushforward(system, x[t], v, w[t], used[t], tolerance, work, dx, dv, direction)
        copy(dx, change[t + 1])
