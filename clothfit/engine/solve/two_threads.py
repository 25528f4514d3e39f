"""Two threads inside one linear solve: the second waits, spinning, for its share of each phase.

A phase of a solve of a large cloth takes some 50 µs, and to start a thread takes as long. So the second thread runs
one compiled function through a whole series of solves (`cg.serve`): it waits until a phase is posted, does its share
and says so; what it does not come to, the first does. Who does what never changes the arithmetic: each share is
computed in one order and the shares are added in one order, so results are the same to the last bit with one thread
or two.

A second thread is used where there is a second processor, unless NUMBA_NUM_THREADS or OMP_NUM_THREADS is 1.
"""

from __future__ import annotations

import os
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from clothfit.base.arrays import Array, aligned
from clothfit.kernels.cache import config
from clothfit.kernels.kernel import kernel
from clothfit.kernels.lanes.operations import exchange, pause, read_shared, write_shared

SERVES, POSTED, CLAIMED, DONE = 0, 8, 16, 24
"""Places of the flags, a cache line apart: 1 while a second thread serves; how many phases were posted so far, of how
many the second share was begun, and done."""

STOP = -1.0
"""The phase that ends the second thread."""

PATIENCE = 2000
"""Looks at a flag, some 50 µs, before the processor is offered to other threads."""


class Team(NamedTuple):
    """What the two threads tell each other."""

    flags: NDArray[np.int64]  # (32,)
    notes: Array  # (1, 8): the phase that is posted, its parameters, and what the second share adds up to


def team() -> Team:
    """A team of one."""
    return Team(np.zeros(32, np.int64), aligned(1, 8))


@kernel
def post(team, phase):
    """Ask for the second share of a phase, whose parameters are in the notes."""
    team.notes[0, 0] = phase
    write_shared(team.flags, POSTED, read_shared(team.flags, POSTED) + 1)


@kernel
def claim(team):
    """Take the second share of the phase that is posted; False where the other thread has it.

    The first thread asks as well when it is done with its own: where other programs keep the second from its
    processor, nobody waits for it.
    """
    number = read_shared(team.flags, POSTED)
    return exchange(team.flags, CLAIMED, number - 1, number)


@kernel
def done(team):
    """Say that the second share is done."""
    write_shared(team.flags, DONE, read_shared(team.flags, POSTED))


@kernel
def wait(team):
    """The first thread: wait until the second share is done."""
    looks = 0
    while read_shared(team.flags, DONE) != read_shared(team.flags, POSTED):
        looks += 1
        pause(looks > PATIENCE)


@kernel
def next_phase(team):
    """The second thread: wait for a phase whose share nobody has, take it and give the number of the phase."""
    looks = 0
    while read_shared(team.flags, CLAIMED) == read_shared(team.flags, POSTED) or not claim(team):
        looks += 1
        pause(looks > PATIENCE)
    return team.notes[0, 0]


@kernel
def enter(team):
    """The second thread: say that it serves from now on."""
    write_shared(team.flags, SERVES, 1)


@contextmanager
def serving(team: Team, serve: Callable[[], None]) -> Iterator[None]:
    """Within, a second thread runs `serve`, which enters, and returns at STOP; alone where there is no processor."""
    if not processors() > 1:
        yield
        return
    thread = threading.Thread(target=serve, name="clothfit-solve", daemon=True)
    thread.start()
    try:
        while not team.flags[SERVES] and thread.is_alive():
            time.sleep(1e-5)  # until it runs compiled code, which the interpreter's lock would keep it from
        yield
    finally:
        team.notes[0, 0] = STOP
        team.flags[POSTED] += 1
        thread.join()
        team.flags[:] = 0


def processors() -> int:
    """Processors that may be used."""
    if config.DISABLE_JIT:
        return 1  # the interpreter runs one thread at a time
    for name in ("NUMBA_NUM_THREADS", "OMP_NUM_THREADS"):
        if os.environ.get(name, "").strip() == "1":
            return 1
    if hasattr(os, "sched_getaffinity"):
        return len(os.sched_getaffinity(0))
    return os.cpu_count() or 1
