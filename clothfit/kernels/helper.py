"""A second process that compiles along, where there is a second processor.

Most of a compilation is Python's work, of which a process does one thing at a time, and most of the code of an entry is
that of the kernels it calls, which are kept one by one (`cache`). So when an entry is compiled, a helper is told of it:
it infers the types of the same functions, but takes the calls of each in the reverse order, so that the two begin at
both ends and meet. Neither waits for the other: at worst both compile the kernel at which they meet. Only the program
itself translates the entry, with all that it calls, to machine code.

The helper ends with the program. Where none can be started, or it fails, everything is compiled here.
"""

from __future__ import annotations

import atexit
import importlib
import os
import pickle
import subprocess
import sys
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from typing import Any

from clothfit.kernels import once, parallel
from clothfit.kernels.dependencies import reached

ALONE = "CLOTHFIT_COMPILE_ALONE"
"""Environment variable with which no helper is started: where other processes of the program compile as well."""

MANY = 40
"""Kernels of an entry from which a helper pays: it takes a second to start."""

SERVE = "from clothfit.kernels import helper; helper.serve()"

_helpers: list[subprocess.Popen[bytes]] = []


@contextmanager
def along(function: Callable[..., object], signature: Any) -> Iterator[None]:
    """Within the block, in which an entry is compiled for a signature, a helper compiles along."""
    if once.alone or os.environ.get(ALONE) or len(reached(function)) < MANY or parallel.processors() < 2:
        yield
        return
    once.alone = _told(pickle.dumps((function.__module__, function.__qualname__, signature)))
    try:
        yield
    finally:
        once.alone = False


def _told(job: bytes) -> bool:
    """Whether a helper has been told of a job."""
    try:
        if not _helpers:
            _helpers.append(_started())
        pipe = _helpers[0].stdin
        assert pipe is not None
        pipe.write(len(job).to_bytes(8, "little") + job)
        pipe.flush()
    except OSError:  # it cannot be started, or has ended
        return False
    return True


def _started() -> subprocess.Popen[bytes]:
    none = subprocess.DEVNULL
    made = subprocess.Popen([sys.executable, "-c", SERVE], stdin=subprocess.PIPE, stdout=none, stderr=none)
    atexit.register(made.kill)
    return made


def serve() -> None:
    """Compile along with the program that has started this process, until that ends."""
    from clothfit.kernels import compiling

    once.alone = True
    compiling.from_the_end()
    jobs: list[bytes] = []
    there = threading.Condition()
    threading.Thread(target=_listen, args=(jobs, there), daemon=True).start()
    while True:
        with there:
            there.wait_for(lambda: jobs)
            module, name, signature = pickle.loads(jobs.pop())  # the newest: earlier ones are over
            jobs.clear()
        with suppress(Exception):  # what it cannot do, the program does
            compiling.infer(getattr(importlib.import_module(module), name).py_func, signature)


def _listen(jobs: list[bytes], there: threading.Condition) -> None:
    """Collect jobs from standard input; when that ends, so does the process, whatever it does."""
    while len(size := sys.stdin.buffer.read(8)) == 8:
        job = sys.stdin.buffer.read(int.from_bytes(size, "little"))
        with there:
            jobs.append(job)
            there.notify()
    os._exit(0)
