"""What the process does that compiles along (`helper`): it infers types from the last line of a function back."""

from __future__ import annotations

import importlib
import os
import pickle
import sys
import threading
from collections.abc import Callable
from contextlib import suppress
from typing import Any

from numba.core.typeinfer import ConstraintNetwork

from clothfit.kernels import once
from clothfit.kernels.compiling import compiled_lazily
from clothfit.kernels.linking import Enough, Inferred


def from_the_end() -> None:
    """Let numba infer the types of a function from its last line back, as far as they are known, and so compile what it
    calls last first.
    """
    forward = ConstraintNetwork.propagate

    def backward(self: Any, inference: Any) -> Any:
        self.constraints.reverse()
        try:
            return forward(self, inference)
        finally:
            self.constraints.reverse()

    ConstraintNetwork.propagate = backward  # type: ignore[method-assign]


def infer(function: Callable[..., object], signature: Any) -> None:
    """Infer the types of a function that Python calls, and so compile all that it calls, but not itself."""
    made = compiled_lazily(function, "", pipeline_class=Inferred)
    with suppress(Enough):
        made.compile(signature)


def serve() -> None:
    """Compile along with the program that has started this process, until that ends."""
    once.alone = True
    from_the_end()
    jobs: list[bytes] = []
    there = threading.Condition()
    threading.Thread(target=_listen, args=(jobs, there), daemon=True).start()
    while True:
        with there:
            there.wait_for(lambda: jobs)
            module, name, signature = pickle.loads(jobs.pop())  # the newest: earlier ones are over
            jobs.clear()
        with suppress(Exception):  # what it cannot do, the program does
            infer(getattr(importlib.import_module(module), name).py_func, signature)


def _listen(jobs: list[bytes], there: threading.Condition) -> None:
    """Collect jobs from standard input; when that ends, so does the process, whatever it does."""
    while len(size := sys.stdin.buffer.read(8)) == 8:
        job = sys.stdin.buffer.read(int.from_bytes(size, "little"))
        with there:
            jobs.append(job)
            there.notify()
    os._exit(0)
