"""Processes and clusters that are staged in this one: what they come to, told by the program's own pools and batches.

A job is done here by the code that a worker runs. What dies, is asked to end or answers wrongly is played by an
executor in the place of joblib's, or by a module in the place of Dask's `distributed`.
"""

from __future__ import annotations

import os
import signal
import sys
from concurrent.futures import Future
from types import SimpleNamespace
from typing import Any

from clothfit import __version__
from clothfit.many import job
from helpers.provoked import Case, fit, raising


class Ended(Future):  # type: ignore[type-arg]
    """What a function has given, or raised."""

    def __init__(self, function: Any, *arguments: Any) -> None:
        super().__init__()
        try:
            self.set_result(function(*arguments))
        except Exception as error:  # noqa: BLE001  it is for whoever asks
            self.set_exception(error)

    def release(self) -> None:
        """As Dask's futures have it."""


class Executor:
    """A process that is this one."""

    _processes: Any = None

    def submit(self, function: Any, argument: Any) -> Future[Any]:
        return Ended(function, argument)

    def shutdown(self, **_: Any) -> None:
        """There is nothing to end."""


class Dying(Executor):
    """A process that dies with each of its jobs, or with the first."""

    def __init__(self, always: bool = True) -> None:
        self.always, self.begun = always, 0

    def submit(self, function: Any, argument: Any) -> Future[Any]:
        from joblib.externals.loky.process_executor import BrokenProcessPool

        self.begun += 1
        if self.always or self.begun == 1:
            return Ended(raising(BrokenProcessPool()))
        return self.held(function, argument)

    def held(self, function: Any, argument: Any) -> Future[Any]:
        return super().submit(function, argument)


class Asked(Dying):
    """Somebody asks for an end while a job runs, which ends then; so many times."""

    def __init__(self, times: int, dies: bool) -> None:
        super().__init__(always=False)
        self.times, self.begun = times, 0 if dies else 1
        self.future: Future[Any] = Future()

    def held(self, function: Any, argument: Any) -> Future[Any]:
        self.ask()
        return self.future

    def ask(self) -> None:
        self.times -= 1
        os.kill(os.getpid(), signal.SIGINT)

    @property
    def _processes(self) -> dict[int, Any]:
        """Who is to be told that an end is asked for."""
        if self.times:
            self.ask()
        else:
            self.future.set_result(job.failed(KeyboardInterrupt()))
        return {}


class Killed(Exception):
    """As Dask's KilledWorker."""


class Cancelled(Exception):
    """As Dask's CancelledError."""


def dask(version: str = __version__, error: Exception | None = None) -> Any:
    """The module `distributed`, with a scheduler whose only worker has that version, and fails so with each job."""

    class Client:
        status = "running"

        def __init__(self, *_: Any, **__: Any) -> None:
            """Any address will do."""

        def run(self, *_: Any, **__: Any) -> dict[str, str]:
            return {"tcp://worker:1": version}

        def nthreads(self) -> dict[str, int]:
            return {"tcp://worker:1": 1}

        def submit(self, function: Any, *arguments: Any, **_: Any) -> Ended:
            return Ended(raising(error) if error else function, *arguments)

        def close(self, **_: Any) -> None:
            """There is nothing to leave."""

    return SimpleNamespace(Client=Client, KilledWorker=Killed, CancelledError=Cancelled)


def pooled(executor: Executor, *replaced: tuple[str, Any]) -> Case:
    """A fit from two starts on that process, where something of the program is replaced."""

    def prepare(patch: Any) -> None:
        patch.setattr("clothfit.many.processes.Processes._executor", lambda pool: executor)
        for name, value in replaced:
            patch.setattr(name, value)

    return Case("estimate scene.json --starts 2 --jobs 1", prepare=prepare)


def spread(module: Any, address: str = "tcp://127.0.0.1:1", knocked: bool = True) -> Case:
    """A fit on a cluster with that module; `knocked`: somebody listens at the address."""

    def prepare(patch: Any) -> None:
        patch.setitem(sys.modules, "distributed", module)
        if knocked:
            patch.setattr("clothfit.many.cluster.knock", lambda address: None)

    return Case(fit(f"--cluster {address}").arguments, prepare=prepare)


STAGED: dict[str, Case] = {
    "out of memory; try fewer frames (optimizationIterations)": pooled(
        Executor(), ("clothfit.many.job.fitted", raising(MemoryError()))
    ),
    "a fault of the program: …: …": pooled(
        Executor(), ("clothfit.many.job.fitted", raising(ZeroDivisionError("by 0")))
    ),
    "interrupted before there was a result": pooled(
        Executor(), ("clothfit.many.job.fitted", raising(KeyboardInterrupt()))
    ),
    "this worker has clothfit …, the job comes from …; install one": pooled(
        Executor(), ("clothfit.many.job.__version__", "99.0")
    ),
    "not started": pooled(Executor(), ("clothfit.many.worker._stopped", True)),
    "the process that fitted it died, out of memory or killed": pooled(Dying()),
    "its process died; there was no second try": pooled(Asked(1, dies=True)),
    "ended at once, by a second request; nothing is written": pooled(
        Asked(2, dies=False), ("clothfit.many.batch.SAME_REQUEST", -1.0)
    ),
    "--cluster needs the package distributed: install clothfit[cluster]": spread(None),
    "--cluster: … is no address of a scheduler; one looks like tcp://host:8786": spread(dask(), "here", knocked=False),
    "--cluster: no scheduler answers at … (…)": spread(dask(), knocked=False),
    "--cluster: the worker … has …; install …, as here": spread(dask("0.0.1")),
    "a worker of the cluster lacks something: …": spread(dask(error=ModuleNotFoundError("No module named 'numba'"))),
    "every worker that fitted it died, out of memory or killed": spread(dask(error=Killed())),
    "the scheduler at … was lost": spread(dask(error=Cancelled())),
}
"""By message. Each ends the command with the code of its row."""
