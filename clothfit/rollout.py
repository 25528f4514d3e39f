"""Step after step in one compiled loop, keeping what the derivatives need.

A Rollout is the memory of one cloth's motion: positions after every step and the velocities of every iteration in it.
States are kept, matrices are not: they are assembled again, which takes a tenth of the memory and little time.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from clothfit import guess
from clothfit.arrays import Array, Indices
from clothfit.kernel import kernel
from clothfit.step import implicit, transition
from clothfit.system import IMPLICIT, System
from clothfit.vectors import copy

FAR = 1e12
"""A vertex farther than this many metres from the origin (sum of its coordinates) counts as diverged."""


class Rollout(NamedTuple):
    """T steps of one cloth with n vertices and up to N iterations per step."""

    x: Array  # (T + 1, n, 3), positions, m; x[0] the start
    w: Array  # (T, N, n, 3), velocities of the iterations of each step, m/s
    used: Indices  # (T,), iterations of each step; w[t, used[t] − 1] is the velocity after step t
    solves: Indices  # (T, 2), CG iterations and direct solves of each step


def rollout(system: System, steps: int, tolerance: float) -> tuple[Rollout, int]:
    """Simulate `steps` steps from rest; linear systems are solved to `tolerance`, relative.

    Returns the rollout and how many of its steps are good: fewer than `steps` when the motion diverged.
    """
    n = len(system.x0)
    iterations = system.newton_iterations if system.method == IMPLICIT else 1
    memory = Rollout(
        np.empty((steps + 1, n, 3)),
        np.zeros((steps, iterations, n, 3)),
        np.ones(steps, np.int32),
        np.zeros((steps, 2), np.int32),
    )
    memory.x[0] = system.x0
    return memory, run(system, tolerance, implicit.workspace(system), memory)


@kernel
def velocity(memory, t):
    """Velocity (n, 3) before step t; the cloth starts at rest."""
    if t == 0:
        return np.zeros_like(memory.x[0])
    return memory.w[t - 1, memory.used[t - 1] - 1]


@kernel
def run(system, tolerance, work, memory):
    """Fill `memory`; returns the number of good steps."""
    x, w, used, solves = memory
    first = work.solution
    for t in range(len(w)):
        v = velocity(memory, t)
        copy(v, first)
        guess.advance(work.past, t, first)
        result = transition.step(system, x[t], v, first, tolerance, work, w[t], x[t + 1])
        used[t], solves[t, 0], solves[t, 1] = result
        if not finite(x[t + 1]):
            return t
    return len(w)


@kernel
def finite(x):
    """Whether all coordinates are numbers of a sensible size."""
    for i in range(len(x)):
        size = abs(x[i, 0]) + abs(x[i, 1]) + abs(x[i, 2])
        if not size < FAR:  # so that NaN counts as well
            return False
    return True
