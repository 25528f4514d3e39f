"""Independent parts of a computation on several threads, one for each processor.

Each part is computed in one order whoever computes it, and the results are handed back in the order of the parts: they
are the same to the last bit with one thread or two. It pays where compiled code lets the interpreter's lock go
(`kernel(nogil=True)`, `kernels.lapack`, NumPy's products).

There is one thread alone where there is one processor, where NUMBA_NUM_THREADS or OMP_NUM_THREADS is 1, and within a
part.
"""

from __future__ import annotations

import os
import threading
from collections.abc import Callable, Sequence
from typing import Generic, TypeVar

from clothfit.base import interrupts

T = TypeVar("T")

_here = threading.local()


def processors() -> int:
    """Processors that may be used."""
    if getattr(_here, "busy", False):
        return 1  # other parts have taken the other processors
    for name in ("NUMBA_NUM_THREADS", "OMP_NUM_THREADS"):
        if os.environ.get(name, "").strip() == "1":
            return 1
    if hasattr(os, "sched_getaffinity"):
        return len(os.sched_getaffinity(0))
    return os.cpu_count() or 1


def together(parts: Sequence[Callable[[], T]]) -> list[T]:
    """The results of all parts. Raises what the first of them raises that fails; where this thread is interrupted the
    others end at their next `interrupts.check`.
    """
    count = min(processors(), len(parts))
    if count < 2:
        return [part() for part in parts]
    shared = Shared(parts)
    threads = [threading.Thread(target=shared.in_thread, name="clothfit-part", daemon=True) for _ in range(count - 1)]
    try:
        for thread in threads:
            thread.start()
        shared.work()
        for thread in threads:
            thread.join()
    finally:  # an interrupt may come anywhere
        shared.over.set()
        for thread in threads:
            if thread.ident is not None:
                thread.join()
    return shared.all()


class Shared(Generic[T]):
    """Parts that several threads take one after the other, in their order, until one fails."""

    def __init__(self, parts: Sequence[Callable[[], T]]) -> None:
        self.parts, self.left, self.lock = parts, iter(range(len(parts))), threading.Lock()
        self.results: dict[int, T] = {}
        self.faults: dict[int, BaseException] = {}
        self.over = threading.Event()  # nobody waits for the results any more

    def work(self, caught: type[BaseException] = Exception) -> None:
        """Take parts while there are any. In the thread that waits for them an interrupt ends that at once."""
        _here.busy = True
        try:
            while (i := self._next()) is not None:
                try:
                    self.results[i] = self.parts[i]()
                except caught as fault:  # parts before it may fail as well
                    self.faults[i] = fault
        finally:
            _here.busy = False

    def in_thread(self) -> None:
        """The same in a thread of its own."""
        with interrupts.abandoned_by(self.over):
            self.work(BaseException)

    def _next(self) -> int | None:
        with self.lock:
            return None if self.faults or self.over.is_set() else next(self.left, None)

    def all(self) -> list[T]:
        """The results. Raises what the first part raised that failed."""
        for i in sorted(self.faults):
            raise self.faults[i]
        return [self.results[i] for i in range(len(self.parts))]


def only_here(function: Callable[[], None] | None) -> Callable[[], None] | None:
    """A function that does nothing in other threads than this one, as to report is for the thread that began."""
    if function is None:
        return None
    mine, call = threading.get_ident(), function

    def heard() -> None:
        if threading.get_ident() == mine:
            call()

    return heard
