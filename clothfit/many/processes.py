"""Worker processes on this machine, each of which does one job at a time (joblib's loky).

Each slot is an executor with a single process: when a process dies, its job is known and the other processes are not
affected. Processes get one thread for dense algebra and compiled loops, so that they do not compete for cores, and
receive requests to end only when they are ready for them.
"""

from __future__ import annotations

import logging
import os
import signal
from collections.abc import Callable, Iterator
from concurrent.futures import Future
from contextlib import contextmanager, suppress
from functools import partial
from typing import Any

from clothfit.base.interrupts import REQUESTS
from clothfit.kernels.cache import is_cold
from clothfit.many.batch import PREPARATION
from clothfit.many.job import FAULT, Died, Job, Outcome
from clothfit.many.warmup import warm
from clothfit.many.worker import prepare, work

LIBRARIES = ("OMP_NUM", "OPENBLAS_NUM", "MKL_NUM", "BLIS_NUM", "VECLIB_MAXIMUM", "NUMBA_NUM", "NUMEXPR_NUM")
ONE_THREAD = {f"{name}_THREADS": "1" for name in LIBRARIES}

DIED = "the process that fitted it died, out of memory or killed"


def usable_cores() -> int:
    """Cores that this program may use."""
    from joblib import cpu_count

    return int(cpu_count())


class Processes:
    """A pool of processes."""

    retried_alone = True

    def __init__(self, width: int) -> None:
        """`width`: jobs at a time."""
        self.width = width
        self._idle: list[Any] = []
        self._busy: dict[int, Any] = {}
        self._results: dict[int, Future[Any]] = {}

    def prepare(self, done: Callable[[int], None]) -> bool:
        """Let one process compile what all need, unless that has been done on this machine."""
        missing = self.width > 1 and is_cold()
        if missing:
            self._begin(PREPARATION, warm, None, done)
        return missing

    def submit(self, number: int, job: Job, done: Callable[[int], None]) -> None:
        """Begin a job."""
        self._begin(number, work, job, done)

    def _begin(self, number: int, function: Callable[..., object], argument: object, done: Any) -> None:
        executor = self._busy[number] = self._idle.pop() if self._idle else self._executor()
        with _requests_held():
            future = executor.submit(function, argument)
        self._results[number] = future
        future.add_done_callback(lambda _: done(number))

    def outcome(self, number: int) -> Outcome:
        """The outcome of a job that has ended. Raises Died."""
        from joblib.externals.loky.process_executor import BrokenProcessPool

        executor, future = self._busy.pop(number), self._results.pop(number)
        try:
            found: Outcome = future.result()
        except BrokenProcessPool:
            executor.shutdown(wait=False)
            raise Died(DIED) from None
        except Exception as error:  # noqa: BLE001  job or result could not be sent
            found = Outcome(None, FAULT, f"a fault of the program: {type(error).__name__}: {error}")
        self._idle.append(executor)
        return found

    def check(self) -> None:
        """Do nothing: the executor notices when its process dies."""

    def interrupt(self) -> None:
        """Let running jobs end with their best so far."""
        for executor in self._busy.values():
            for pid in list(executor._processes or {}):
                with suppress(OSError):  # it has just ended
                    os.kill(pid, signal.SIGINT)

    def close(self, kill: bool = False) -> None:
        """End the processes."""
        for executor in (*self._idle, *self._busy.values()):
            executor.shutdown(wait=True, kill_workers=kill)
        self._idle.clear()
        self._busy.clear()

    def _executor(self) -> Any:
        from multiprocessing import resource_tracker

        from joblib.externals.loky.process_executor import ProcessPoolExecutor

        resource_tracker.ensure_running()  # started later, it would unblock the requests
        logging.getLogger("concurrent.futures").setLevel(logging.CRITICAL)
        start = partial(prepare, os.getpid())
        return ProcessPoolExecutor(max_workers=1, timeout=None, initializer=start, env=ONE_THREAD)


@contextmanager
def _requests_held() -> Iterator[None]:
    """Block requests to end; processes started within the block inherit that."""
    if not hasattr(signal, "pthread_sigmask"):
        yield
        return
    before = signal.pthread_sigmask(signal.SIG_BLOCK, REQUESTS)
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)
