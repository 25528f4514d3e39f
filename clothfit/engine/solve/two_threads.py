"""Two threads inside one linear solve: a worker waits, spinning, for its part of each phase.

A phase of a solve of a large cloth takes some 50 µs, and to start a thread takes as long. So the second thread runs one
compiled function through a whole series of solves (`cg_multigrid.serve`): it waits until a
phase is posted, takes its part, and says when that is done. A part that it does not come to, the first thread takes.
Who takes a part never changes the arithmetic: each is computed in one order and their sums are added in one order, so
results are the same to the last bit with one thread or two.

There is a second thread where there is a second processor to be had (`kernels.parallel`).
"""

from __future__ import annotations

import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from clothfit.base.arrays import Array, aligned
from clothfit.kernels.kernel import kernel
from clothfit.kernels.lanes.operations import exchange, pause, read_shared, write_shared
from clothfit.kernels.parallel import processors

SERVES, POSTED, CLAIMED, DONE = 0, 8, 16, 24
"""Places of the flags, a cache line apart: 1 while a second thread serves; how many phases were posted so far; of how
many the worker's part was begun; of how many it is done."""

STOP = -1.0
"""The phase that ends the second thread."""

SPINS = 2000
"""Looks at a flag, some 50 µs, before the processor is offered to other threads."""


class Worker(NamedTuple):
    """Memory through which the two threads talk."""

    flags: NDArray[np.int64]  # (32,)
    message: Array  # (1, 8): the phase that is posted, its two parameters, and the sum of the worker's part


def worker() -> Worker:
    """Memory for a second thread that does not serve yet."""
    return Worker(np.zeros(32, np.int64), aligned(1, 8))


@kernel
def post(worker, phase):
    """Post a phase, whose parameters are in the message."""
    worker.message[0, 0] = phase
    write_shared(worker.flags, POSTED, read_shared(worker.flags, POSTED) + 1)


@kernel
def claim(worker):
    """Take the worker's part of the phase that is posted; False where the other thread has it.

    The first thread tries as well when it is done with its own part: where other programs keep the second thread from
    its processor, the first does not wait for it.
    """
    number = read_shared(worker.flags, POSTED)
    return exchange(worker.flags, CLAIMED, number - 1, number)


@kernel
def done(worker):
    """Say that the worker's part is done."""
    write_shared(worker.flags, DONE, read_shared(worker.flags, POSTED))


@kernel
def wait(worker):
    """The first thread: wait until the worker's part is done."""
    looks = 0
    while read_shared(worker.flags, DONE) != read_shared(worker.flags, POSTED):
        looks += 1
        pause(looks > SPINS)


@kernel
def next_phase(worker):
    """The second thread: wait for a phase whose part no thread has taken, take it and return the phase."""
    looks = 0
    while read_shared(worker.flags, CLAIMED) == read_shared(worker.flags, POSTED) or not claim(worker):
        looks += 1
        pause(looks > SPINS)
    return worker.message[0, 0]


@kernel
def enter(worker):
    """The second thread: say that it serves from now on."""
    write_shared(worker.flags, SERVES, 1)


@contextmanager
def serving(worker: Worker, serve: Callable[[], None]) -> Iterator[None]:
    """Within the block a second thread runs `serve`, `enter` first and to STOP, where there is a processor for it. A
    block within another has the thread of that: of two, the wrong one could take the STOP that the other waits for.
    """
    if worker.flags[SERVES] or not processors() > 1:
        yield
        return
    thread = threading.Thread(target=serve, name="clothfit-solve", daemon=True)
    thread.start()
    try:
        while not worker.flags[SERVES] and thread.is_alive():
            time.sleep(1e-5)  # until it runs compiled code, which the interpreter's lock would keep it from
        yield
    finally:
        worker.message[0, 0] = STOP
        worker.flags[POSTED] += 1
        thread.join()
        worker.flags[:] = 0
