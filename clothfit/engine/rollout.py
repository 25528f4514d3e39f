"""Step after step in one compiled loop, keeping what the derivatives need.

A Rollout is the memory of a part of one cloth's motion: positions after every step and the velocities of every
iteration in it. States are kept, matrices are not: they are assembled again, which takes a tenth of the memory and
little time. A `tape` goes through a whole motion part by part.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import NamedTuple

import numpy as np

from clothfit.base import interrupts
from clothfit.base.arrays import Array, Flags, Indices
from clothfit.base.limits import FARTHEST
from clothfit.base.memory import check_memory
from clothfit.engine.solve import guess, linear
from clothfit.engine.step import guard, implicit, transition
from clothfit.engine.system import IMPLICIT, System, clamped
from clothfit.kernels.kernel import kernel
from clothfit.kernels.vectors import copy

STRETCH = 20_000
"""Vertices × steps between two checks for an interrupt: about 10 ms."""


class Rollout(NamedTuple):
    """T steps of one cloth with n vertices and up to N iterations per step: a whole motion, or a part of it."""

    x: Array  # (T + 1, n, 3), positions, m; x[0] before the first of the steps
    w: Array  # (T, N, n, 3), velocities of the iterations of each step, m/s
    used: Indices  # (T,), iterations of each step; w[t, used[t] − 1] is the velocity after step t
    solves: Indices  # (T, 2), CG iterations and direct solves of each step
    clamped: Flags  # (T,), steps taken with the clamped system, as their matrix was not positive definite
    theta: Array  # (T,), part of each step that was taken, 1 unless it was shortened (`step.guard`)
    v: Array  # (n, 3), velocity before the first of the steps, m/s
    first: int = 0  # steps of the motion before it

    @property
    def steps(self) -> int:
        """T."""
        return len(self.w)

    def part(self, begin: int, end: int) -> Rollout:
        """The steps from `begin` to below `end`, counted here; not a copy."""
        v = self.w[begin - 1, self.used[begin - 1] - 1] if begin else self.v
        return Rollout(
            self.x[begin : end + 1],
            self.w[begin:end],
            self.used[begin:end],
            self.solves[begin:end],
            self.clamped[begin:end],
            self.theta[begin:end],
            v,
            self.first + begin,
        )

    def parts(self) -> list[Rollout]:
        """Parts short enough to be interrupted."""
        return [self.part(begin, end) for begin, end in stretches(self.steps, self.x.shape[1])]

    def forward(self) -> Iterator[Rollout]:
        """A motion of one part; see `tape.Tape`."""
        yield self

    def backward(self) -> Iterator[Rollout]:
        """The same."""
        yield self


def empty(system: System, steps: int) -> Rollout:
    """Memory for this many steps from the start."""
    n, iterations = len(system.x0), iterations_of(system)
    x, w = np.empty((steps + 1, n, 3)), np.zeros((steps, iterations, n, 3))
    x[0] = system.x0
    used, solves = np.ones(steps, np.int32), np.zeros((steps, 2), np.int32)
    return Rollout(x, w, used, solves, np.zeros(steps, bool), np.ones(steps), system.v0)


def iterations_of(system: System) -> int:
    """Most iterations N of a step."""
    return system.newton_iterations if system.method == IMPLICIT else 1


def state_bytes(system: System) -> int:
    """Bytes that a Rollout holds of each step."""
    return 24 * len(system.x0) * (1 + iterations_of(system)) + 21


def rollout(system: System, steps: int, tolerance: float) -> tuple[Rollout, int]:
    """Simulate `steps` steps and keep them all; linear systems are solved to `tolerance`, relative.

    Returns the rollout and how many of its steps are good: fewer than `steps` when the motion diverged.
    """
    check_memory(steps + 1, len(system.x0), iterations_of(system))
    whole = empty(system, steps)
    return whole, fill(system, tolerance, implicit.workspace(system), whole)


def fill(system: System, tolerance: float, work: implicit.Workspace, part: Rollout) -> int:
    """Compute the steps of a part whose x[0], v and first are set; returns how many are good."""
    safe = clamped(system)
    with linear.served(work.A, work.solver):
        for begin, end in stretches(part.steps, len(system.x0)):
            done, refused = begin, False
            while done < end:
                if refused:
                    done, failed = run(safe, tolerance, work, part, done, done + 1)
                else:
                    done, failed = run(system, tolerance, work, part, done, end)
                interrupts.check()
                if failed:
                    return int(done)
                refused = not refused and done < end
    return part.steps


def stretches(steps: int, n: int) -> Iterator[tuple[int, int]]:
    """Split the steps of a cloth of n vertices into runs, from first to below last, short enough to be interrupted."""
    length = max(1, STRETCH // n)
    for first in range(0, steps, length):
        yield first, min(first + length, steps)


@kernel
def velocity(part, t):
    """Velocity (n, 3) before step t of a Rollout."""
    if t == 0:
        return part.v
    return part.w[t - 1, part.used[t - 1] - 1]


@kernel
def velocities(part, t):
    """Velocities (N, n, 3) of the iterations of step t, as they were before the step was shortened."""
    w, theta = part.w[t], part.theta[t]
    if theta < 1.0:
        w = w.copy()
        w[part.used[t] - 1] /= theta  # a power of ½: nothing is lost
    return w


@kernel
def run(system, tolerance, work, part, start, stop):
    """Fill a Rollout from its step `start` to below `stop`.

    Returns the number of good steps since its beginning, and whether the next one failed. If it did not fail, and
    `stop` is not reached, the caller must take it with the clamped system; its first guess is ready.
    """
    x, w, used, solves, capped, theta, _, before = part
    first, energy, safe = work.solution, 0.0, system.springs.cap <= 1.0
    t, checked = start, start if guard.applies(system) else stop
    while t < stop:
        v = velocity(part, t)
        now, power = transition.prepare(system, x[t], v, work)  # the energy that step t − 1 led to
        if t > checked and guard.rises(energy, now, system.h * power):
            checked = t
            if shortened(system, part, t - 1, energy):
                continue
        energy = now
        if not safe:
            copy(v, first)
            guess.advance(work.past, before + t, first)
            solves[t] = 0
        used[t], iterations, direct = transition.step(system, x[t], v, first, tolerance, work, w[t], x[t + 1])
        solves[t, 0] += iterations
        solves[t, 1] += direct
        theta[t], capped[t] = 1.0, safe
        if used[t] == 0:
            return t, False
        if not finite(x[t + 1]):
            return t, True
        t += 1
    if checked < stop:
        shortened(system, part, stop - 1, energy)
    return stop, False


@kernel
def shortened(system, part, t, energy):
    """Shorten step t, which began with this energy, J, if it added energy; returns whether it was shortened."""
    x, v = part.x, velocity(part, t + 1)
    if guard.raised(system, energy, x[t], v, x[t + 1]):
        part.theta[t] = guard.shorten(system, energy, x[t], v, x[t + 1])
    return part.theta[t] < 1.0


@kernel
def finite(x):
    """Whether all coordinates are numbers, and not too far away."""
    for i in range(len(x)):
        size = abs(x[i, 0]) + abs(x[i, 1]) + abs(x[i, 2])
        if not size < FARTHEST:  # so that NaN counts as well
            return False
    return True
