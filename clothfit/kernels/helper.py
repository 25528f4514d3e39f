"""A second process that compiles along, where there is a second processor.

Most of a compilation is Python's work, of which a process does one thing at a time, and most of the code of an entry is
that of the kernels it calls, which are kept one by one (`cache`). So when an entry is compiled, a helper is told of it:
it infers the types of the same functions, but takes the calls of each in the reverse order (`backward`), so that the
two begin at both ends and meet. Neither waits for the other: at worst both compile the kernel at which they meet. Only
the program itself translates the entry, with all that it calls, to machine code.

What the entry calls `apart` is needed when it runs. The helper compiles that as a whole, last to first, while the
program goes on from first to last; here one waits where the other has begun.

The helper ends with the program. Where none can be started, or it fails, everything is compiled here.
"""

from __future__ import annotations

import atexit
import os
import pickle
import subprocess
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from functools import partial
from typing import Any

from clothfit.kernels import once, parallel
from clothfit.kernels.dependencies import reached

ALONE = "CLOTHFIT_COMPILE_ALONE"
"""Environment variable with which no helper is started: where other processes of the program compile as well."""

MANY = 40
"""Kernels of an entry from which a helper pays: it takes a second to start."""

SERVE = "from clothfit.kernels import backward; backward.serve()"

_helpers: list[subprocess.Popen[bytes]] = []


tell: Callable[[Callable[..., object], Any], object] | None = None
"""What is told of each kernel that an entry calls apart, with its types of arguments, while the entry is compiled."""


@contextmanager
def along(function: Callable[..., object], signature: Any, called_by_python: bool) -> Iterator[None]:
    """Within the block, in which an entry is compiled for a signature, a helper compiles along."""
    global tell
    if once.alone or os.environ.get(ALONE) or len(reached(function)) < MANY or parallel.processors() < 2:
        yield
        return
    once.alone = _requested(function, signature, False)
    tell = partial(_requested, whole=True) if called_by_python else None
    try:
        yield
    finally:
        once.alone, tell = False, None


@contextmanager
def without_requests() -> Iterator[None]:
    """Within the block no helper is told: what is called there may never be needed."""
    global tell
    before, tell = tell, None
    try:
        yield
    finally:
        tell = before


def _requested(function: Callable[..., object], kinds: Any, whole: bool) -> bool:
    """Whether a helper has been told of a function: to compile it as a whole, or what it calls."""
    job = pickle.dumps((function.__module__, function.__qualname__, kinds, whole))
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
