"""The clocks of a fit: seconds that pass, seconds of this process's computing, in which other work of the machine does
not count, and nominal seconds. Compilation counts in none, so that the first use of a command ends where all others do,
and takes as long by its own account. Nor does it count towards a deadline (`interrupts.limited`).

Nominal seconds are those that the simulations and their derivatives would take on a common machine, by the work that
they count (`engine.rollout.work_of`). What a fit decides by them it decides again in the next run, whatever else the
machine does then; fits of few values do little else than simulate, and go by them.
"""

from __future__ import annotations

import time
from collections.abc import Callable

from numba.core import event
from numba.core.compiler_lock import global_compiler_lock

from clothfit.base import interrupts
from clothfit.kernels.work import counted

RATE = 5e7
"""Units of work in a nominal second."""

FEW = 16
"""Values up to which a fit goes by nominal seconds."""


class Compilation(event.Listener):
    """Adds up the seconds in which numba compiles, or loads what it has compiled."""

    def __init__(self) -> None:
        self.seconds, self.depth, self.began = 0.0, 0, 0.0  # of computing
        self.passed, self.began_elapsed = 0.0, 0.0

    def on_start(self, event: event.Event) -> None:
        """Compilation of a function begins, perhaps within that of another one."""
        if self.depth == 0:
            self.began, self.began_elapsed = time.process_time(), time.perf_counter()
        self.depth += 1

    def on_end(self, event: event.Event) -> None:
        """It ends."""
        self.depth -= 1
        if self.depth <= 0:
            self.seconds, self.depth = self.seconds + time.process_time() - self.began, 0
            passed = time.perf_counter() - self.began_elapsed
            self.passed += passed
            interrupts.leave_out(passed)


compilation = Compilation()
event.register("numba:compiler_lock", compilation)


def computing() -> float:
    """Seconds of computing so far, without compilation."""
    _look()
    return time.process_time() - compilation.seconds


def nominal() -> float:
    """Nominal seconds so far."""
    return counted.work / RATE


def clock_of(values: int) -> Callable[[], float]:
    """The clock that a fit of so many values goes by."""
    return nominal if values <= FEW else computing


def elapsed() -> float:
    """Seconds since some instant, without compilation."""
    _look()
    return time.perf_counter() - compilation.passed


def _look() -> None:
    if compilation.depth and not global_compiler_lock.is_locked():  # an exception has ended it between two of its lines
        compilation.depth = 0
