"""Step after step in one compiled loop, keeping what the derivatives need.

A Rollout is the memory of a part of one cloth's motion: positions after every step and the velocities of every
iteration in it. States are kept, matrices are not: they are assembled again, which takes a tenth of the memory and
little time. A `tape` goes through a whole motion part by part.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from typing import Any, NamedTuple

import numpy as np

from clothfit.base import interrupts
from clothfit.base.arrays import Array, Flags, Indices
from clothfit.base.memory import check_memory
from clothfit.engine import equilibrium, march
from clothfit.engine.forces import contact
from clothfit.engine.inputs.tables import check_steps
from clothfit.engine.solve import linear
from clothfit.engine.step import bdf2, guard, implicit
from clothfit.engine.system import BDF2, IMPLICIT, System, clamped, meets_itself, predictive, rests
from clothfit.kernels.kernel import record

STRETCH = 20_000
"""Vertices × steps between two checks for an interrupt: about 10 ms."""


STEP_WORK, DIRECT_WORK = 7, 500
"""Work of a step beside its solves, and of a direct solve, in iterations of conjugate gradients."""


OF_STEPS = ("w", "used", "solves", "clamped", "theta", "euler", "predicted", "hit", "active", "active_pairs")
"""Fields of a `Rollout` with an item for each step, or None."""


@record
class Rollout(NamedTuple):
    """T steps of one cloth with n vertices and up to N iterations per step: a whole motion, or a part of it."""

    x: Array  # (T + 1, n, 3), positions, m; x[0] before the first of the steps
    w: Array  # (T, N, n, 3), velocities of the iterations of each step, m/s
    used: Indices  # (T,), iterations of each step; w[t, used[t] − 1] is the velocity after step t
    solves: Indices  # (T, 2), CG iterations and direct solves of each step
    clamped: Flags  # (T,), steps taken with the clamped system, as their matrix was not positive definite
    theta: Array  # (T,), part of each step that was taken, 1 unless it was shortened (`step.guard`)
    euler: Flags  # (T,), steps of a BDF2 motion that are implicit Euler steps (`step.bdf2`)
    predicted: Flags  # (T,), steps that knew the contacts they begin, as they would have added energy (`step.guard`)
    hit: Flags  # (T,), implicit Euler steps of a BDF2 motion in which the cloth hits something (`march.hits`)
    guard_state: Array  # (T + 1, 2 + R), of each state: BOUND and the mean POWER that led to it (`step.guard`), loads
    v: Array  # (n, 3), velocity before the first of the steps, m/s
    x_before: Array  # (n, 3), position one step before that, m; any, where nothing was before
    v_before: Array  # (n, 3), the velocity there, m/s
    regular: int  # iterations that a step takes unless it ends badly
    ready: bool = False  # whether the first of the steps can be a BDF2 step
    first: int = 0  # steps of the motion before it
    active: Flags | None = None  # (T, N, C n), contacts that steps only ended in (`forces.contact`); None without any
    active_pairs: Any = None  # (T,) of `contact_steps.ActivePairs`, with self-contact; kernels get a `bare` part

    @property
    def steps(self) -> int:
        """T."""
        return len(self.w)

    def part(self, begin: int, end: int) -> Rollout:
        """The steps from `begin` to below `end`, counted here; not a copy."""
        x_before, v_before = (self.x[begin - 1], self.velocity(begin - 1)) if begin else (self.x_before, self.v_before)
        cut: dict[str, Any] = {name: getattr(self, name)[begin : end + 1] for name in ("x", "guard_state")}
        cut |= {name: None if (own := getattr(self, name)) is None else own[begin:end] for name in OF_STEPS}
        ready = self.smooth(begin - 1) if begin else self.ready
        return Rollout(
            **cut, v=self.velocity(begin), x_before=x_before, v_before=v_before, regular=self.regular, ready=ready,
            first=self.first + begin,
        )  # fmt: skip

    @property
    def more(self) -> Indices:
        """Iterations (T,) of each step beyond those that it takes unless it ends badly."""
        return np.maximum(self.used - self.regular, 0)

    def smooth(self, t: int) -> bool:
        """Whether a BDF2 step may follow step t."""
        return bool(self.theta[t] == 1.0 and not self.predicted[t] and not self.hit[t])

    def bare(self) -> Rollout:
        """The same as kernels take it."""
        return self._replace(active_pairs=None)

    def velocity(self, t: int) -> Array:
        """Velocity (n, 3) before step t, m/s."""
        return self.w[t - 1, self.used[t - 1] - 1] if t else self.v

    def parts(self) -> list[Rollout]:
        """Parts short enough to be interrupted."""
        return [self.part(begin, end) for begin, end in stretches(self.steps, self.x.shape[1])]

    def forward(self) -> Iterator[Rollout]:
        """A motion of one part; see `tape.Tape`."""
        yield self

    def backward(self) -> Iterator[Rollout]:
        """The same."""
        yield self


def work_of(part: Rollout) -> int:
    """What the steps of a part have taken, in iterations of conjugate gradients of one vertex, of which a core does
    some 50 million in a second: it does not depend on what else the machine does.
    """
    iterations, direct = part.solves.sum(axis=0).tolist()
    return int(part.x.shape[1] * (iterations + DIRECT_WORK * direct + STEP_WORK * part.steps))


class Taken:
    """The systems that the steps of a motion are taken with, each made when it is first needed."""

    def __init__(self, system: System) -> None:
        self.own, self.made = system, {(False, False): system}

    def form(self, knows: bool, safe: bool) -> System:
        """That of steps that know contacts early, and whose matrix is clamped."""
        if (knows, safe) not in self.made:
            form = predictive(self.own) if knows else self.own
            self.made[knows, safe] = clamped(form) if safe else form
        return self.made[knows, safe]

    def at(self, part: Rollout, t: int) -> System:
        """That of step t of a part."""
        return self.form(bool(part.predicted[t]), bool(part.clamped[t]))


def forms(system: System) -> tuple[System, ...]:
    """The systems with which the steps of a motion are taken."""
    return bdf2.forms(system) if system.method == BDF2 else (system,)


def empty(system: System, steps: int) -> Rollout:
    """Memory for this many steps from the start."""
    n, iterations = len(system.x0), iterations_of(system)
    x, w = np.empty((steps + 1, n, 3)), np.zeros((steps, iterations, n, 3))
    x[0] = system.x0
    used, solves = np.ones(steps, np.int32), np.zeros((steps, 2), np.int32)
    flags, guard_state = np.zeros((4, steps), bool), np.tile(guard.start(system), (steps + 1, 1))
    start = system.v0, system.x0, system.v0, system.newton_iterations
    made = Rollout(x, w, used, solves, flags[0], np.ones(steps), flags[1], flags[2], flags[3], guard_state, *start)
    if system.colliders is not None:
        made = made._replace(active=np.zeros((steps, *system.colliders.on.shape), bool))
    return made._replace(active_pairs=np.empty(steps, object)) if meets_itself(system) else made


def iterations_of(system: System) -> int:
    """Most iterations N of a step."""
    if system.colliders is not None:
        return int(system.colliders.on.shape[0])
    return system.newton_iterations if system.method in (IMPLICIT, BDF2) else 1


def state_bytes(system: System) -> int:
    """Bytes that a Rollout holds of each step; few take more iterations but at meshes, and what none writes is none."""
    colliders, iterations, met = system.colliders, iterations_of(system), 0
    if colliders is not None:
        iterations = min(iterations, system.newton_iterations + len(colliders.bodies.moves))
        met = (iterations + 8) * colliders.on.shape[1]
    return 24 * len(system.x0) * (1 + iterations) + 31 + met


def rollout(system: System, steps: int, tolerance: float, load: float | Array = -1.0) -> tuple[Rollout, int]:
    """Simulate `steps` steps and keep them all; linear systems are solved to `tolerance`, relative. `load` (R,) is what
    pressed vertices at colliders before the start, N, where that is known.

    Returns the rollout and how many of its steps are good: fewer than `steps` when the motion diverged.
    """
    check_steps(system.inputs, steps)
    check_memory(steps + 1, len(system.x0), iterations_of(system))
    whole = empty(system, steps)
    whole.guard_state[0, contact.BESIDE :] = load
    return whole, fill(system, tolerance, implicit.workspace(system), whole)


def fill(
    system: System, tolerance: float, work: implicit.Workspace, part: Rollout,
    check: Callable[[], None] = interrupts.check,
) -> int:  # fmt: skip
    """Compute the steps of a part whose x[0], v and first are set; returns how many are good. `check` is called now and
    then, and may raise.
    """
    if rests(system):
        return fill_at_rest(system, part)
    taken = Taken(system)
    if meets_itself(system):
        from clothfit.engine import contact_steps  # which few scenes need

        return contact_steps.fill(taken, tolerance, work, part, check)
    with linear.served(work.A, work.solver):
        for begin, end in stretches(part.steps, len(system.x0)):
            done, ended = begin, march.DONE
            while done < end:
                if ended == march.REFUSED:
                    done, ended = run_steps(taken.form(False, True), tolerance, work, part, done, done + 1)
                else:
                    done, ended = run_steps(system, tolerance, work, part, done, end)
                if ended == march.CONTACTS:
                    done, ended = retake(taken, tolerance, work, part, done)
                if ended == march.GAINS:
                    from clothfit.engine import contact_steps  # which few scenes need

                    contact_steps.mend(taken, tolerance, work, part, done - 1)
                check()
                if ended == march.FAILED:
                    return int(done)
    return part.steps


def fill_at_rest(system: System, part: Rollout) -> int:
    """Write the shape at rest that is found from x[0] to all states of a part; returns how many steps are good."""
    part.x[:], found, solves = equilibrium.shape_from(system, part.x[0])
    part.w[:] = 0.0
    part.used[:], part.solves[:], part.theta[:] = 1, [DIRECT_WORK * solves, 0], 1.0
    for flags in (part.clamped, part.euler, part.predicted, part.hit):
        flags[:] = False
    return part.steps if found else 0


def run_steps(
    system: System, tolerance: float, work: implicit.Workspace, part: Rollout, start: int, stop: int
) -> tuple[int, int]:
    """Run steps of a part with the method of the system; see `march.run`."""
    if system.method == BDF2:
        done, ended = march.run_bdf2(*bdf2.forms(system), tolerance, work, part, start, stop)
    elif system.method == IMPLICIT:
        done, ended = march.run(system, tolerance, work, part, start, stop)
    else:
        done, ended = march.run_explicit(system, part, start, stop)
    return done, ended


def retake(taken: Taken, tolerance: float, work: implicit.Workspace, part: Rollout, t: int) -> tuple[int, int]:
    """Take step t of a part anew with early contacts; returns what `march.run` does."""
    ended = march.retake(taken.form(True, False), tolerance, work, part, t)
    if ended == march.REFUSED:
        ended = march.retake(taken.form(True, True), tolerance, work, part, t)
    return (t + 1 if ended == march.DONE else t), ended


def stretches(steps: int, n: int) -> Iterator[tuple[int, int]]:
    """Split the steps of a cloth of n vertices into runs, from first to below last, short enough to be interrupted."""
    length = max(1, STRETCH // n)
    for first in range(0, steps, length):
        yield first, min(first + length, steps)
