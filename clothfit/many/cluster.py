"""Jobs on a Dask cluster: the client's side, and what its workers run.

Scene and targets travel inside the job. The scheduler keeps the job and gives it to another worker when one dies; the
client gets the result and writes it. So workers need no files, and losing one costs only time. A worker does one job
at a time, however many threads it has: a fit is one thread's work.
"""

from __future__ import annotations

import logging
import re
import socket
import threading
import time
import uuid
import warnings
from collections.abc import Callable
from contextlib import suppress
from typing import Any

from clothfit.base import interrupts
from clothfit.base.errors import InvalidInput
from clothfit.base.version import __version__
from clothfit.many.job import FAULT, NOT_STARTED, Died, Job, Lost, Outcome, run

CONNECT = 4.0  # s to wait for the scheduler
GONE = 5.0  # s of silence after which the scheduler counts as lost

REFRESH = 2.0  # s between counts of the workers
AHEAD = 2  # jobs that the scheduler holds per worker, so that no worker waits for its next job

_turn = threading.Lock()
_stopped: set[str] = set()
_current = ""


def work(job: Job, batch: str) -> Outcome:
    """Do a job on a worker, unless its batch was asked to end."""
    global _current
    with _turn:
        interrupts.clear()
        _current = batch
        try:
            return NOT_STARTED if batch in _stopped else run(job)
        finally:
            _current = ""
            interrupts.clear()


def stop(batch: str) -> None:
    """End a worker's job of a batch with the best so far."""
    _stopped.add(batch)
    if _current == batch:
        interrupts.request()


def probe(address: str) -> None:
    """Raise InvalidInput when no scheduler listens at an address, sooner than Dask's client would."""
    parts = re.fullmatch(r"(?:tcp|tls)://(.+):(\d{1,5})/?", address)
    if not parts:
        raise InvalidInput(f"--cluster: {address} is no address of a scheduler; one looks like tcp://host:8786")
    try:
        socket.create_connection((parts[1].strip("[]"), int(parts[2])), CONNECT).close()
    except (OSError, OverflowError) as error:
        reason = getattr(error, "strerror", None) or error
        raise InvalidInput(f"--cluster: no scheduler answers at {address} ({reason})") from None


class Cluster:
    """The workers of a Dask scheduler."""

    retried_alone = False  # the scheduler has tried again, on several workers

    def __init__(self, address: str) -> None:
        """`address`: tcp://host:port. Raises InvalidInput if no scheduler is there or a worker lacks this version."""
        try:
            from distributed import Client
        except ImportError:
            raise InvalidInput("--cluster needs the package distributed: install clothfit[cluster]") from None
        for name in [name for name in logging.root.manager.loggerDict if name.startswith("distributed")]:
            logging.getLogger(name).setLevel(logging.CRITICAL)  # outcomes of jobs report what matters
        self.address, self.batch = address, uuid.uuid4().hex
        probe(address)
        try:
            self._client: Any = Client(address, timeout=CONNECT, set_as_default=False)
        except (OSError, ValueError, TypeError, RuntimeError) as error:
            reason = str(error).split("\n")[0] or type(error).__name__
            raise InvalidInput(f"--cluster: no scheduler answers at {address} ({reason})") from None
        self._futures: dict[int, Any] = {}
        self._results: dict[int, Outcome | BaseException] = {}
        self._seen, self._counted, self._workers = time.monotonic(), -REFRESH, 0
        try:
            self._check_versions()
        except BaseException:
            self.close()
            raise

    @property
    def width(self) -> int:
        """Jobs that the scheduler gets at a time."""
        if time.monotonic() - self._counted > REFRESH and self._client.status == "running":
            self._counted = time.monotonic()
            with suppress(Exception):  # the scheduler may be ending; `check` will notice
                self._workers = len(self._client.nthreads())
        return max(1, AHEAD * self._workers)

    def prepare(self, done: Callable[[int], None]) -> bool:
        """Nothing must precede the jobs."""
        return False

    def submit(self, number: int, job: Job, done: Callable[[int], None]) -> None:
        """Begin a job."""

        def ended(future: Any) -> None:
            try:
                self._results[number] = future.result()
            except BaseException as error:  # noqa: BLE001  `outcome` reports it
                self._results[number] = error
            done(number)

        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # Dask warns of large jobs, but must hold them
            future = self._client.submit(work, job, self.batch, key=f"clothfit-{self.batch}-{number}", pure=False)
        self._futures[number] = future
        future.add_done_callback(ended)

    def outcome(self, number: int) -> Outcome:
        """The outcome of a job that has ended. Raises Died, Lost."""
        from distributed import CancelledError, KilledWorker

        found = self._results.pop(number)
        self._futures.pop(number).release()
        if isinstance(found, KilledWorker):
            raise Died("every worker that fitted it died, out of memory or killed")
        if isinstance(found, CancelledError):
            raise Lost(self._gone)
        if isinstance(found, ModuleNotFoundError):
            return Outcome(None, InvalidInput.exit_code, f"a worker of the cluster lacks something: {found}")
        if isinstance(found, BaseException):
            return Outcome(None, FAULT, f"a fault of the program: {type(found).__name__}: {found}")
        return found

    def check(self) -> None:
        """Raise Lost when the scheduler has been silent too long."""
        if self._client.status == "running":
            self._seen = time.monotonic()
        elif time.monotonic() - self._seen > GONE:
            raise Lost(self._gone)

    def interrupt(self) -> None:
        """Let running jobs end with their best so far."""
        with suppress(Exception):  # `check` notices a lost scheduler
            self._client.run(stop, self.batch, on_error="ignore")

    def close(self, kill: bool = False) -> None:
        """Leave the cluster; with `kill` its jobs are cancelled."""
        with suppress(Exception):  # the scheduler may be lost
            if kill and self._client.status == "running":
                self.interrupt()
                self._client.cancel(list(self._futures.values()), force=True)
        with suppress(Exception):
            self._client.close(timeout=2.0)

    @property
    def _gone(self) -> str:
        return f"the scheduler at {self.address} was lost"

    def _check_versions(self) -> None:
        """Raise InvalidInput when a worker has another version of this program, or none."""
        found = self._client.run(eval, "__import__('clothfit').__version__", on_error="return")
        for worker, version in found.items():
            if version != __version__:
                has = "no clothfit" if isinstance(version, BaseException) else f"clothfit {version}"
                raise InvalidInput(f"--cluster: the worker {worker} has {has}; install {__version__}, as here")
