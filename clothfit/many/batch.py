"""Run many jobs to their ends, in any order, on processes of this machine or on a cluster.

A job is made when there is room for it, so that not all files are in memory at once. A job whose process dies is tried
once more, alone, after all others are done, so that no other job can be the cause. After the first request to end
(Ctrl-C) running jobs end with their best so far; a second request ends them at once.
"""

from __future__ import annotations

import queue
import time
from collections import deque
from collections.abc import Callable, Sequence
from typing import TYPE_CHECKING, TypeAlias

from clothfit.base.errors import InvalidInput
from clothfit.base.interrupts import SAME_REQUEST, handled
from clothfit.many.job import FAULT, INTERRUPTED, NOT_STARTED, PREPARATION, Died, Job, Lost, Outcome, failed

if TYPE_CHECKING:
    from clothfit.many.cluster import Cluster
    from clothfit.many.processes import Processes

TICK = 0.25  # s between checks whether the pool still exists

REQUEST, NO_EVENT = -2, -3
"""Events other than the end of a job, which is its number, or of what precedes them all."""

CUT_SHORT = Outcome(None, INTERRUPTED, "ended at once, by a second request; nothing is written")


Pool: TypeAlias = "Processes | Cluster"
"""Where jobs run, `width` at a time. Each has a number; `done` is called with it from another thread when the job ends.
Where `retried_alone`, a job whose process died is tried again.
"""


class Batch:
    """Runs many jobs on a pool."""

    def __init__(
        self, pool: Pool, jobs: Sequence[Callable[[], Job]], report: Callable[[int, Outcome | None], None]
    ) -> None:
        """`jobs` make each job when its turn comes, and may raise.

        `report` is called once with each number and its outcome. Where a process died and its job will be tried again,
        it is called with None before that.
        """
        self.pool, self.jobs, self.report = pool, jobs, report
        self.waiting = deque(range(len(jobs)))
        self.alone: deque[int] = deque()
        self.running: set[int] = set()
        self.died: set[int] = set()
        self.stopping = False
        self._last_request = -SAME_REQUEST
        self._events: queue.SimpleQueue[int] = queue.SimpleQueue()

    def run(self) -> None:
        """Run all jobs."""
        with handled(lambda _: lambda number, frame: self._events.put(REQUEST)):
            if len(self.jobs) > 1 and self.pool.prepare(self._events.put):
                self.running.add(PREPARATION)
            while self.waiting or self.alone or self.running:
                self._begin()
                if self.running:
                    self._handle_event()

    def _begin(self) -> None:
        """Begin as many jobs as there is room for."""
        if PREPARATION in self.running:
            return
        while self.waiting and len(self.running) < self.pool.width:
            self._submit(self.waiting.popleft())
        if self.alone and not self.running:
            self._submit(self.alone.popleft())

    def _submit(self, number: int) -> None:
        try:
            job = self.jobs[number]()
        except Exception as error:  # noqa: BLE001  an unreadable file ends this job, not the others
            self.report(number, failed(error))
            return
        self.running.add(number)
        self.pool.submit(number, job, self._events.put)

    def _handle_event(self) -> None:
        """Wait for an event, and handle it."""
        try:
            event = self._events.get(timeout=TICK)
        except queue.Empty:
            event = NO_EVENT
        if event == REQUEST:
            self._request()
        elif event == NO_EVENT:
            self._check_pool()
        elif event in self.running:
            self.running.discard(event)
            self._end(event)

    def _end(self, number: int) -> None:
        """Report the outcome of a job that has ended, or keep it for another try."""
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
                self.report(number, None)
                return
            code = INTERRUPTED if self.stopping else FAULT
            outcome = Outcome(None, code, f"{error}{', and again when it was alone' if again else ''}")
        if number != PREPARATION:
            self.report(number, outcome)

    def _check_pool(self) -> None:
        """Give up if the pool is gone."""
        try:
            self.pool.check()
        except Lost as error:
            self._give_up(Outcome(None, InvalidInput.exit_code, str(error)))

    def _request(self) -> None:
        """Handle a request to end: the first lets running jobs end, the second ends them at once."""
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
        """Report `outcome` for all waiting jobs and do not begin them."""
        while self.waiting:
            self.report(self.waiting.popleft(), outcome)
        while self.alone:
            self.report(self.alone.popleft(), Outcome(None, INTERRUPTED, "its process died; there was no second try"))

    def _give_up(self, outcome: Outcome) -> None:
        """Report `outcome` for all running and waiting jobs."""
        for number in sorted(self.running - {PREPARATION}):
            self.report(number, outcome)
        self.running.clear()
        self._drop(NOT_STARTED if outcome == CUT_SHORT else outcome)
