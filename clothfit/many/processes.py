"""Worker processes on this machine, each of which does one job at a time (joblib's loky).

Each slot is an executor with a single process: when a process dies, its job is known and the other processes are not
affected. Processes get one thread for dense algebra and compiled loops, so that they do not compete for cores, and
receive requests to end only when they are ready for them.

A request (Ctrl-C reaches the whole group of processes, and the parent passes requests on) ends a process's job with its
best result so far; later jobs are not begun. A process whose parent has ended ends too: its result would be lost.
"""

from __future__ import annotations

import logging
import os
import signal
import threading
import time
from collections.abc import Callable, Iterator
from concurrent.futures import Future
from contextlib import contextmanager, suppress
from functools import partial
from typing import Any

from clothfit.base import interrupts
from clothfit.base.interrupts import REQUESTS
from clothfit.derivative import adjoint
from clothfit.kernels.cache import is_kept
from clothfit.many.job import FAULT, NOT_STARTED, PREPARATION, Died, Job, Outcome, run

LIBRARIES = ("OMP_NUM", "OPENBLAS_NUM", "MKL_NUM", "BLIS_NUM", "VECLIB_MAXIMUM", "NUMBA_NUM", "NUMEXPR_NUM")
ONE_THREAD = {f"{name}_THREADS": "1" for name in LIBRARIES}

WATCH = 1.0  # s between checks for the parent

DIED = "the process that fitted it died, out of memory or killed"

_stopped = False
_running = False


def prepare(parent: int) -> None:
    """Make a new process ready; `parent` is the id of the process that started it.

    Requests were blocked until now, so that none could interrupt Python while it loads.
    """
    interrupts.handle(_request)
    threading.Thread(target=_watch, args=(parent,), daemon=True).start()
    if hasattr(signal, "pthread_sigmask"):
        signal.pthread_sigmask(signal.SIG_UNBLOCK, REQUESTS)


def work(job: Job) -> Outcome:
    """Do a job, unless a request to end came before."""
    global _running
    outcome = NOT_STARTED
    if _stopped:
        return outcome
    interrupts.clear()
    try:
        _running = True
        outcome = run(job)
        _running = False
    except KeyboardInterrupt:  # just before the job or after it
        pass
    return outcome


def _request(number: int, frame: object) -> None:
    """Interrupt the running job once; later requests must not interrupt the sending of its result."""
    global _stopped, _running
    _stopped = True
    if _running:
        _running = False
        interrupts.request()
        raise KeyboardInterrupt


def _watch(parent: int) -> None:
    while os.getppid() == parent:
        time.sleep(WATCH)
    os._exit(1)


def is_cold() -> bool:
    """Whether a fit would have to compile first."""
    return not is_kept(adjoint.sweep_back)


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
            from clothfit.many.warmup import warm  # here, as a process that does a job needs none of its imports

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
            outcome: Outcome = future.result()
        except BrokenProcessPool:
            executor.shutdown(wait=False)
            raise Died(DIED) from None
        except Exception as error:  # noqa: BLE001  job or result could not be sent
            outcome = Outcome(None, FAULT, f"a fault of the program: {type(error).__name__}: {error}")
        self._idle.append(executor)
        return outcome

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
