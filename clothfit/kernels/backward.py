"""What the process does that compiles along (`helper`): it infers types from the last line of a function back."""

from __future__ import annotations

import importlib
import os
import pickle
import sys
import threading
from collections.abc import Callable
from contextlib import suppress
from typing import Any, TypeAlias

from numba.core import event
from numba.core.typeinfer import ConstraintNetwork

from clothfit.kernels import once
from clothfit.kernels.compiling import compiled_lazily
from clothfit.kernels.linking import AllKnown, Inferred

Job: TypeAlias = tuple[str, str, Any, bool]
"""Module and name of a kernel, its types of arguments, and whether to compile it as a whole, or what it calls."""


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
    with suppress(AllKnown):
        made.compile(signature)


def compile_whole(kernel: Any, kinds: tuple[Any, ...]) -> None:
    """Compile a kernel that is called apart, unless the program is at it."""
    once.alone = False
    try:
        with suppress(AllKnown), event.install_listener("numba:run_pass", _Waiting()):
            kernel.address(kinds)
    finally:
        once.alone = True


class _Waiting(event.Listener):
    """Ends a compilation that another process has begun."""

    def on_start(self, event: Any) -> None:
        if event.data["name"] == "waiting":
            raise AllKnown

    def on_end(self, event: object) -> None:
        """Do nothing."""


def serve() -> None:
    """Compile along with the program that has started this process, until that ends."""
    once.alone = True
    from_the_end()
    jobs: list[Job] = []
    there = threading.Condition()
    threading.Thread(target=_listen, args=(jobs, there), daemon=True).start()
    while True:
        with there:
            there.wait_for(lambda: jobs)
            place = max((k for k, job in enumerate(jobs) if not job[3]), default=len(jobs) - 1)
            module, name, kinds, whole = jobs.pop(place)
        with suppress(Exception):  # what it cannot do, the program does
            kernel = getattr(importlib.import_module(module), name)
            if whole:
                compile_whole(kernel, kinds)
            else:
                infer(kernel.py_func, kinds)


def _listen(jobs: list[Job], there: threading.Condition) -> None:
    """Collect jobs from standard input; when that ends, so does the process, whatever it does. Of entries only the
    newest counts: earlier ones are over.
    """
    while len(size := sys.stdin.buffer.read(8)) == 8:
        job: Job = pickle.loads(sys.stdin.buffer.read(int.from_bytes(size, "little")))
        with there:
            if not job[3]:
                jobs[:] = [each for each in jobs if each[3]]
            jobs.append(job)
            there.notify()
    os._exit(0)
