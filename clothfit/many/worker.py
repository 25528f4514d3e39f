"""What a worker process does with jobs and with requests to end.

A request (Ctrl-C reaches the whole group of processes, and the parent passes requests on) ends the running job with its
best result so far; later jobs are not begun. A worker whose parent has ended ends too: its result would be lost.
"""

from __future__ import annotations

import os
import signal
import threading
import time

from clothfit.base import interrupts
from clothfit.base.interrupts import REQUESTS
from clothfit.many.job import NOT_STARTED, Job, Outcome, run

WATCH = 1.0  # s between checks for the parent

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
