"""Derivatives of a whole motion: the reverse sweep (gradient) and the forward sweep (tangent).

Both walk through a Rollout step by step and know no physics: a step's transpose and tangent do the work. For a cost
G(x₁ … x_T) the reverse sweep gives its gradient by every mass and stiffness, and by the other kinds of `Elements` that
are asked for, at the price of about one more simulation; the forward sweep gives the change of all positions along one
direction in them. They are each other's transpose.
"""

from __future__ import annotations

from collections.abc import Collection

import numpy as np

from clothfit import cg, guess, interrupts
from clothfit.arrays import Array, Elements
from clothfit.kernel import kernel
from clothfit.rollout import Rollout, stretches, velocity
from clothfit.step import implicit, transition
from clothfit.system import System, zeros
from clothfit.vectors import add, copy, hold_fixed


def gradient(
    system: System, memory: Rollout, by_position: Array, tolerance: float, kinds: Collection[str] = ()
) -> Elements:
    """The gradient of G from by_position = ∂G/∂x (T + 1, n, 3), along a finished rollout.

    By masses (n,), stiffnesses (S,) and the `kinds`, names of fields of Elements; the other fields stay empty.
    """
    grad = zeros(system, kinds)
    by_position, work = np.ascontiguousarray(by_position), implicit.workspace(system)
    x_bar, v_bar = np.zeros_like(system.x0), np.zeros_like(system.x0)
    with cg.helped(work.A, work.cg):
        for first, last in reversed(list(stretches(len(memory.w), len(system.x0)))):
            sweep_back(system, memory, by_position, tolerance, work, first, last, x_bar, v_bar, grad)
            interrupts.check()
    if "velocity" in kinds:
        hold_fixed(system.vertex.free, v_bar)
        grad = grad._replace(velocity=v_bar)
    return grad


def tangent(system: System, memory: Rollout, direction: Elements, tolerance: float) -> Array:
    """Change of all positions (T + 1, n, 3) for the change `direction`; its empty fields do not change."""
    change, work = np.zeros_like(memory.x), implicit.workspace(system)
    dx, dv = np.zeros_like(system.x0), np.zeros_like(system.x0)
    if len(direction.velocity) > 0:
        copy(direction.velocity, dv)
        hold_fixed(system.vertex.free, dv)
    with cg.helped(work.A, work.cg):
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
        v = velocity(system, memory, t)
        guess.advance(work.past, len(w) - 1 - t, work.solution)
        transition.pullback(system, x[t], v, w[t], used[t], tolerance, work, x_bar, v_bar, grad)


@kernel
def sweep_forward(system, memory, direction, tolerance, work, first, last, dx, dv, change):
    """Carry dx, dv (n, 3), the change of the state before step `first`, to after step last − 1; keep all dx."""
    x, w, used, _ = memory
    for t in range(first, last):
        v = velocity(system, memory, t)
        guess.advance(work.past, t, work.solution)
        transition.pushforward(system, x[t], v, w[t], used[t], tolerance, work, dx, dv, direction)
        copy(dx, change[t + 1])
