"""Step after step in one compiled loop, keeping what the derivatives need.

A Rollout is the memory of one cloth's motion: positions after every step and the velocities of every iteration in it.
States are kept, matrices are not: they are assembled again, which takes a tenth of the memory and little time.
"""

from __future__ import annotations

import os
from collections.abc import Callable, Iterator, Sequence
from itertools import pairwise
from typing import NamedTuple

import numpy as np

from clothfit import cg, guess, interrupts
from clothfit.arrays import Array, Indices
from clothfit.errors import InvalidInput
from clothfit.kernel import kernel
from clothfit.step import implicit, transition
from clothfit.system import IMPLICIT, System
from clothfit.vectors import copy

FAR = 1e12
"""A vertex farther than this many metres from the origin (sum of its coordinates) counts as diverged."""


STRETCH = 20_000
"""Vertices × steps between two looks for an interrupt: about 10 ms."""


class Rollout(NamedTuple):
    """T steps of one cloth with n vertices and up to N iterations per step."""

    x: Array  # (T + 1, n, 3), positions, m; x[0] the start
    w: Array  # (T, N, n, 3), velocities of the iterations of each step, m/s
    used: Indices  # (T,), iterations of each step; w[t, used[t] − 1] is the velocity after step t
    solves: Indices  # (T, 2), CG iterations and direct solves of each step


def rollout(
    system: System,
    steps: int,
    tolerance: float,
    marks: Sequence[int] = (),
    enough: Callable[[Array], bool] = lambda x: False,
) -> tuple[Rollout, int]:
    """Simulate `steps` steps; linear systems are solved to `tolerance`, relative.

    After each number of steps in `marks`, ascending, `enough` is asked with the positions so far, (steps + 1, n, 3),
    whether to stop.

    Returns the rollout and how many of its steps are good: fewer than `steps` when the motion diverged or was enough.
    """
    n = len(system.x0)
    check_memory(steps + 1, n, system.newton_iterations)
    iterations = system.newton_iterations if system.method == IMPLICIT else 1
    memory = Rollout(
        np.empty((steps + 1, n, 3)),
        np.zeros((steps, iterations, n, 3)),
        np.ones(steps, np.int32),
        np.zeros((steps, 2), np.int32),
    )
    memory.x[0] = system.x0
    work = implicit.workspace(system)
    with cg.helped(work.A, work.cg):
        for begin, end in pairwise(sorted({0, *(mark for mark in marks if mark < steps), steps})):
            for first, last in stretches(end - begin, n):
                good = run(system, tolerance, work, memory, begin + first, begin + last)
                interrupts.check()
                if good < begin + last:
                    return memory, good
            if enough(memory.x[: end + 1]):
                return memory, end
    return memory, steps


def stretches(steps: int, n: int) -> Iterator[tuple[int, int]]:
    """Split the steps of a cloth of n vertices into runs, from first to below last, short enough to be interrupted."""
    length = max(1, STRETCH // n)
    for first in range(0, steps, length):
        yield first, min(first + length, steps)


def check_memory(frames: int, vertices: int, iterations: int) -> None:
    """Raise InvalidInput, with the figure, when a motion cannot be kept in this machine's memory."""
    needed = 24 * (1 + iterations) * frames * vertices
    memory = os.sysconf("SC_PHYS_PAGES") * os.sysconf("SC_PAGE_SIZE") if hasattr(os, "sysconf") else 2**40
    if needed > memory:
        raise InvalidInput(
            f"{frames} frames of {vertices} vertices take {needed / 1e9:.3g} GB, "
            f"this machine has {memory / 1e9:.3g} GB; use fewer frames (--steps, optimizationIterations)"
        )


@kernel
def velocity(system, memory, t):
    """Velocity (n, 3) before step t."""
    if t == 0:
        return system.v0
    return memory.w[t - 1, memory.used[t - 1] - 1]


@kernel
def run(system, tolerance, work, memory, start, stop):
    """Fill `memory` from step `start` to below `stop`; returns the number of good steps since the beginning."""
    x, w, used, solves = memory
    first = work.solution
    for t in range(start, stop):
        v = velocity(system, memory, t)
        copy(v, first)
        guess.advance(work.past, t, first)
        result = transition.step(system, x[t], v, first, tolerance, work, w[t], x[t + 1])
        used[t], solves[t, 0], solves[t, 1] = result
        if not finite(x[t + 1]):
            return t
    return stop


@kernel
def finite(x):
    """Whether all coordinates are numbers of a sensible size."""
    for i in range(len(x)):
        size = abs(x[i, 0]) + abs(x[i, 1]) + abs(x[i, 2])
        if not size < FAR:  # so that NaN counts as well
            return False
    return True
