"""Steps whose forms are given, such as those of a motion near by.

Which form a step takes depends on its state: one whose matrix is seen to be indefinite is clamped, one that would add
energy is shortened, or, by BDF2, taken by implicit Euler. Where a form switches, the motion jumps. With the forms of
one motion held, the motions of values around it change smoothly with them, and the one itself is the same to the bit.
A step that is held plain is solved also where its matrix is indefinite.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable
from typing import NamedTuple

import numpy as np

from clothfit.base import interrupts
from clothfit.base.arrays import Array, Flags
from clothfit.engine import march, rollout
from clothfit.engine.rollout import Rollout, Taken, run_steps, stretches
from clothfit.engine.solve import guess, linear
from clothfit.engine.step import implicit
from clothfit.engine.system import BDF2, IMPLICIT, System


class Forms(NamedTuple):
    """How the T steps of a motion were taken; see `rollout.Rollout`."""

    clamped: Flags  # (T,)
    euler: Flags  # (T,)
    predicted: Flags  # (T,)
    theta: Array  # (T,)
    more: Array  # (T,), iterations beyond those of the scene

    @property
    def plain(self) -> Flags:
        """Which steps (T,) are whole and those of their method, but for the first one."""
        return np.asarray(~(self.clamped | self.predicted | self.euler) & (self.theta == 1.0) & (self.more == 0))

    def part(self, begin: int, end: int) -> Forms:
        """Those of the steps from `begin` to below `end`."""
        at = slice(begin, end)
        return Forms(self.clamped[at], self.euler[at], self.predicted[at], self.theta[at], self.more[at])

    def equals(self, other: Forms) -> bool:
        """Whether all steps have the same forms."""
        return all(np.array_equal(mine, its) for mine, its in zip(self, other, strict=True))


def forms_of(parts: Iterable[Rollout]) -> Forms:
    """The forms of the steps of a motion, in order."""
    own = [[getattr(part, name).copy() for name in Forms._fields] for part in parts]
    return Forms(*(np.concatenate(each) for each in zip(*own, strict=True)))


def forms_from(system: System, parts: Iterable[Rollout], tolerance: float) -> Forms:
    """The forms that single steps of a system take from the states of another motion."""
    found: list[Rollout] = []
    for part in parts:
        for t in range(part.steps):
            own, ready = part.part(t, t), part.first + t > 0
            if found:
                ready = found[-1].smooth(0)
            step = rollout.empty(system, 1)._replace(
                v=own.v, x_before=own.x_before, v_before=own.v_before, ready=ready, first=part.first + t
            )
            step.x[0] = part.x[t]
            rollout.fill(system, tolerance, implicit.workspace(system), step)
            found.append(step)
    return forms_of(found)


class Single(NamedTuple):
    """T steps that begin in the states of another motion."""

    part: Rollout  # whose states are those
    away: Array  # (T, n, 3), m, how far each step ends from there
    h: Array  # (T,), s, by which the velocity after each step moves its end


def single_steps(system: System, x: Array, seen: Flags, tolerance: float) -> Single | None:
    """The steps that begin where the positions x (T + 1, n, 3) of another motion show it; where it is not `seen`
    (T + 1, n), the motion goes on as it is. None where a step fails.

    Velocities are those that bring the step before, in the form it takes, to where the other motion is.
    """
    steps, work = len(x) - 1, implicit.workspace(system)
    part, away, h = rollout.empty(system, steps), np.zeros((steps, *x.shape[1:])), np.full(steps, system.h)
    with linear.served(work.A, work.solver):
        for t in range(steps):
            if rollout.fill(system, tolerance, work, part.part(t, t + 1)) == 0:
                return None
            h[t] *= 2.0 / 3.0 if system.method == BDF2 and not part.euler[t] else 1.0
            away[t] = np.where(seen[t + 1][:, None], part.x[t + 1] - x[t + 1], 0.0)
            part.x[t + 1] -= away[t]
            part.velocity(t + 1)[seen[t]] -= away[t, seen[t]] / h[t]
    return Single(part, away, h)


def fill(
    system: System, forms: Forms, tolerance: float, work: implicit.Workspace, part: Rollout,
    check: Callable[[], None] = interrupts.check,
) -> int:  # fmt: skip
    """What `rollout.fill` does, each step in the form that is given for it; of a cloth that does not touch itself."""
    taken = Taken(system._replace(guarded=False))
    given = forms.part(part.first, part.first + part.steps)
    plain = given.plain
    with linear.served(work.A, work.solver):
        for begin, end in stretches(part.steps, len(system.x0)):
            t = begin
            while t < end:
                stop = next((step for step in range(t, end) if not plain[step]), end)
                if stop > t:
                    t, ended = run_steps(taken.own, tolerance, work, part, t, stop)
                else:
                    t, ended = one(taken, given, tolerance, work, part, t)
                check()
                if ended != march.DONE:
                    return int(t)
    return part.steps


def one(
    taken: Taken, given: Forms, tolerance: float, work: implicit.Workspace, part: Rollout, t: int
) -> tuple[int, int]:
    """Take step t of a part in its form; returns what `march.run` does."""
    predicted, safe = bool(given.predicted[t]), bool(given.clamped[t])
    form = taken.form(predicted, safe)
    if safe:  # as for a step that was refused
        work.solution[:] = part.velocity(t)
        guess.next_guess(work.past, part.first + t, work.solution)
        part.solves[t] = 0
    euler = form._replace(method=IMPLICIT)
    if form.method == BDF2 and given.euler[t]:
        done, ended = march.run(euler, tolerance, work, part, t, t + 1)
        part.euler[t] = True
    else:
        done, ended = run_steps(form, tolerance, work, part, t, t + 1)
    part.predicted[t] = predicted
    while ended == march.DONE and part.more[t] < given.more[t]:
        if not march.go_on(euler, tolerance, work, part, t):
            break
    if ended == march.DONE and given.theta[t] < 1.0:
        part.theta[t] = given.theta[t]
        part.w[t, part.used[t] - 1] *= given.theta[t]
        part.x[t + 1] = part.x[t] + form.h * part.velocity(t + 1)
    return done, ended
