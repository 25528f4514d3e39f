"""From the forces that hold a cloth on the first path to those of the least effort: L-BFGS in the closed loop."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import TypeAlias

import numpy as np

from clothfit.base import interrupts
from clothfit.base.arrays import Array
from clothfit.base.memory import free
from clothfit.control.closed_loop import FINEST, ClosedLoop
from clothfit.optimise.scipy_methods import lbfgs
from clothfit.optimise.status import Status, Stop

Report: TypeAlias = Callable[[float, float, int], object]
"""Gets the effort, N² s, what is missed of the keys that are penalties, m, and the evaluations so far."""

MOST_PAIRS, LEAST_PAIRS = 10, 5
"""Steps that L-BFGS remembers, as memory allows."""

ROUND = 100
"""Evaluations between two looks at the multipliers."""

STALL, GAIN, PATIENT_GAIN = 100, 5e-4, 1e-12
"""A descent ends where so many evaluations lower the effort by less than this share; one with a budget of time by less
than the second.
"""

OPTIMAL = 1e-6
"""Slope, relative to that where the search began, at which a descent has converged."""

NEAR, NEAR_HARD = 2e-4, 5e-7
"""m: what may be left of a key that is a penalty, an ordinary and a hard one."""


NEARER, PATIENCE = 0.95, 4
"""A descent with multipliers ends after so many rounds in a row that leave more than this share of the misses."""

PENALTIES = 4.0**8
"""How much penalties may grow."""


@dataclass
class Best:
    """The best forces so far."""

    f: Array  # (T, n, 3), N
    x: Array  # (T + 1, n, 3), m, where they lead
    u: Array  # (T, n, 3), N, with which it needs no springs
    value: float
    gradient: float  # its `ClosedLoop.slope`


class Descent:
    """A descent of a closed loop from forces f (T, n, 3), N."""

    def __init__(
        self, loop: ClosedLoop, f: Array, report: Report, limit: float = np.inf, patient: bool = False,
        keep: Callable[[Descent], object] | None = None,
    ) -> None:  # fmt: skip
        """`limit`: evaluations, at most; `patient`: whether it may take all the time there is; `keep` gets the descent
        after each evaluation.
        """
        self.loop, self.report, self.left, self.keep = loop, report, limit, keep
        self.gain = PATIENT_GAIN if patient and not loop.wishes else GAIN
        self.values: list[float] = []
        with interrupts.grace(np.inf):  # there is always a result
            value, gradient = loop(f)
        size = loop.slope(gradient)
        loop.steepest = loop.steepest or size
        self.best = Best(f, loop.x, loop.u, value, size)

    def run(self) -> Status:
        """Descend until it has converged or no longer gets better; a deadline or an interrupt leaves the best."""
        try:
            return self.rounds() if self.loop.wishes else self.alone()
        except interrupts.OutOfTime:
            return Status.LIMIT
        except KeyboardInterrupt:
            return Status.INTERRUPTED

    def alone(self) -> Status:
        """Descend where no key is a penalty: where the search finds nothing better, again with finer motions and a new
        memory, as long as that lowers the gradient.
        """
        while True:
            before = self.best.gradient
            status = self.round()
            if status is not None:
                return status
            if self.loop.tolerance <= FINEST and self.best.gradient > 0.5 * before:
                return Status.STALLED
            self.loop.tolerance = FINEST
            self.restart()

    def rounds(self) -> Status:
        """Descend with multipliers until the keys that are penalties are met, or come no nearer."""
        loop, before, idle, most = self.loop, np.inf, 0, PENALTIES * self.loop.penalty
        near = NEAR_HARD if any(wish.key.hard for wish in loop.wishes) else NEAR
        while True:
            status = self.round()
            loop.x, loop.u = self.best.x, self.best.u
            missed = loop.missed
            if status is Status.LIMIT or (missed <= near and status is not None):
                return status
            idle = 0 if missed < NEARER * before else idle + 1
            if idle == PATIENCE:
                return Status.STALLED
            loop.insist()
            if missed > 0.25 * before:
                loop.penalty = min(4.0 * loop.penalty, most)
            before = min(before, missed)
            self.restart()

    def restart(self) -> None:
        """Values before and after a change of the multipliers cannot be compared."""
        value, gradient = self.loop(self.best.f)
        size = self.loop.slope(gradient)
        self.loop.steepest = max(self.loop.steepest, size)  # larger penalties are steeper
        self.best = Best(self.best.f, self.loop.x, self.loop.u, value, size)
        self.values = [value]

    def round(self) -> Status | None:
        """Some evaluations; how the descent ended, if it has."""
        unknown, shape = self.loop.unknown, self.best.f.shape
        room = int(0.2 * free() / (16.0 * 3.0 * max(int(unknown.sum()), 1)))
        pairs = int(np.clip(room, LEAST_PAIRS, MOST_PAIRS))
        scale = np.sqrt(2.0 * self.loop.h)

        def cost(z: Array) -> tuple[float, Array]:
            f = np.zeros(shape)
            f[unknown] = z.reshape(-1, 3) / scale
            value, gradient = self.evaluate(f)
            return value, gradient[unknown].reshape(-1) / scale

        start: Array = self.best.f[unknown].reshape(-1) * scale
        limit: int = 10**9 if not self.loop.wishes else 2 * ROUND
        try:
            lbfgs(cost, start, recent=pairs, limit=limit)
        except Stop as stop:
            return stop.status
        return None

    def evaluate(self, f: Array) -> tuple[float, Array]:
        """Value and gradient, noting the best. Raises Stop where the descent has ended."""
        interrupts.check()
        value, gradient = self.loop(f)
        size = self.loop.slope(gradient)
        if value < self.best.value:
            self.best = Best(f, self.loop.x, self.loop.u, value, size)
            interrupts.hold()
        self.values.append(self.best.value)
        self.report(self.loop.effort, self.loop.missed, self.loop.evaluations)
        if self.keep:
            self.keep(self)
        self.left -= 1
        if self.left <= 0:
            raise Stop(Status.LIMIT)
        if self.best.gradient <= OPTIMAL * self.loop.steepest:
            raise Stop(Status.CONVERGED)
        if len(self.values) > STALL and self.values[-1 - STALL] - self.best.value <= self.gain * abs(self.best.value):
            raise Stop(Status.STALLED)
        return value, gradient
