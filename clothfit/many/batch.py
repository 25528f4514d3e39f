"""Many jobs, whatever becomes of each: on processes of this machine or on a cluster, in any order, all to an end.

A job is made when there is room for it, so that not all files are in memory at once. One whose process dies is begun
once more when all others are done, alone, so that nothing but itself can be to blame. The first request to end
(Ctrl-C) lets the jobs that run end with their best so far, a second one ends them at once.
"""

from __future__ import annotations

import queue
import signal
import threading
import time
from collections import deque
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from typing import Any, Protocol

from clothfit.base.errors import InvalidInput
from clothfit.base.interrupts import REQUESTS, SAME_REQUEST
from clothfit.many.job import FAULT, INTERRUPTED, NOT_STARTED, Died, Job, Lost, Outcome, failed

TICK = 0.25  # s: how often to look whether the pool is still there

PREPARATION, REQUEST, NO_EVENT = -1, -2, -3
"""What may end or come instead of a job."""

CUT_SHORT = Outcome(None, INTERRUPTED, "ended at once, by a second request; nothing is written")


class Pool(Protocol):
    """Where jobs are done; they are known by numbers. `done` is called with one, from another thread, at its end."""

    retried_alone: bool  # whether a job whose process died is worth another try

    @property
    def width(self) -> int:
        """Jobs at a time."""

    def prepare(self, done: Callable[[int], None]) -> bool:
        """Begin what must be done before all jobs, as number PREPARATION; whether there is anything."""

    def submit(self, number: int, job: Job, done: Callable[[int], None]) -> None:
        """Begin a job."""

    def outcome(self, number: int) -> Outcome:
        """What became of a job that is done. Raises Died, Lost."""

    def check(self) -> None:
        """Raise Lost when no job will end any more."""

    def interrupt(self) -> None:
        """Let the jobs that run end with their best so far."""

    def close(self, kill: bool = False) -> None:
        """Give back what was taken; with `kill` jobs that run end at once."""


class Batch:
    """The way through many jobs."""

    def __init__(
        self, pool: Pool, jobs: Sequence[Callable[[], Job]], tell: Callable[[int, Outcome | None], None]
    ) -> None:
        """`jobs` make each job when its turn comes, and may raise. `tell` is called with each number once, with its
        outcome, and before that with None when its process has died and it will be begun once more.
        """
        self.pool, self.jobs, self.tell = pool, jobs, tell
        self.waiting = deque(range(len(jobs)))
        self.alone: deque[int] = deque()
        self.running: set[int] = set()
        self.died: set[int] = set()
        self.stopping = False
        self._last_request = -SAME_REQUEST
        self._events: queue.SimpleQueue[int] = queue.SimpleQueue()

    def run(self) -> None:
        """Do all jobs."""
        with _requests_to(lambda: self._events.put(REQUEST)):
            if len(self.jobs) > 1 and self.pool.prepare(self._events.put):
                self.running.add(PREPARATION)
            while self.waiting or self.alone or self.running:
                self._begin()
                if self.running:
                    self._heed()

    def _begin(self) -> None:
        """Begin what there is room for."""
        if PREPARATION in self.running:
            return
        while self.waiting and len(self.running) < self.pool.width:
            self._submit(self.waiting.popleft())
        if self.alone and not self.running:
            self._submit(self.alone.popleft())

    def _submit(self, number: int) -> None:
        try:
            job = self.jobs[number]()
        except Exception as error:  # noqa: BLE001  a file that cannot be read is this job's fate, not that of others
            self.tell(number, failed(error))
            return
        self.running.add(number)
        self.pool.submit(number, job, self._events.put)

    def _heed(self) -> None:
        """Wait for something to happen, and act on it."""
        try:
            event = self._events.get(timeout=TICK)
        except queue.Empty:
            event = NO_EVENT
        if event == REQUEST:
            self._request()
        elif event == NO_EVENT:
            self._look()
        elif event in self.running:
            self.running.discard(event)
            self._end(event)

    def _end(self, number: int) -> None:
        """A job has ended."""
        try:
            outcome = self.pool.outcome(number)
        except Lost as error:
            self.running.add(number)
            self._give_up(Outcome(None, InvalidInput.exit_code, str(error)))
            return
        except Died as error:
            again = number in self.died
            self.died.add(number)
            if self.pool.retried_alone and not again and not self.stopping and number != PREPARATION:
                self.alone.append(number)
                self.tell(number, None)
                return
            code = INTERRUPTED if self.stopping else FAULT
            outcome = Outcome(None, code, f"{error}{', and again when it was alone' if again else ''}")
        if number != PREPARATION:
            self.tell(number, outcome)

    def _look(self) -> None:
        """Give up where the pool is gone."""
        try:
            self.pool.check()
        except Lost as error:
            self._give_up(Outcome(None, InvalidInput.exit_code, str(error)))

    def _request(self) -> None:
        """Somebody wants an end."""
        before, self._last_request = self._last_request, time.monotonic()
        if self._last_request - before <= SAME_REQUEST:
            return
        if self.stopping or PREPARATION in self.running:
            self.pool.close(kill=True)
            self._give_up(CUT_SHORT)
            return
        self.stopping = True
        self._drop(NOT_STARTED)
        self.pool.interrupt()

    def _drop(self, outcome: Outcome) -> None:
        """Do not begin what waits."""
        while self.waiting:
            self.tell(self.waiting.popleft(), outcome)
        while self.alone:
            self.tell(self.alone.popleft(), Outcome(None, INTERRUPTED, "its process died; there was no second try"))

    def _give_up(self, outcome: Outcome) -> None:
        """All that is not done ends so."""
        for number in sorted(self.running - {PREPARATION}):
            self.tell(number, outcome)
        self.running.clear()
        self._drop(NOT_STARTED if outcome == CUT_SHORT else outcome)


@contextmanager
def _requests_to(note: Callable[[], None]) -> Iterator[None]:
    """Have requests to end noted instead of raised, where they would be raised."""
    before: dict[signal.Signals, Any] = {}
    if threading.current_thread() is threading.main_thread():
        before = {kind: signal.getsignal(kind) for kind in REQUESTS if callable(signal.getsignal(kind))}
    for kind in before:
        signal.signal(kind, lambda number, frame: note())
    try:
        yield
    finally:
        for kind, handler in before.items():
            signal.signal(kind, handler)
