"""How far a compilation is: the functions that are compiled, of those that an entry needs."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable
from typing import Any

from numba.core import event
from numba.core.registry import CPUDispatcher

from clothfit.kernels.cache import KernelCache, stem
from clothfit.kernels.dependencies import reached, types_text

EVERY, SOON = 2.5, 0.5  # s between two reports, and of an entry before the first


class Compilations(event.Listener):
    """Calls `begun` before the first compilation of this process, then `done` with the functions compiled and those
    that are needed, every few seconds while one goes on, and `over` after each entry. `done` is called in another
    thread.
    """

    def __init__(self, begun: Callable[[], None], done: Callable[[int, int], None], over: Callable[[], None]) -> None:
        self.begun, self.done, self.over = begun, done, over
        self.depth, self.announced, self.needed, self.due = 0, False, 0, 0.0
        self.ended = threading.Event()

    def on_start(self, event: Any) -> None:
        """A function, perhaps within that of another one. Calls back into Python, which numba prepares anew in every
        process, are not worth a word.
        """
        if not isinstance(event.data["dispatcher"], CPUDispatcher):
            return
        self.depth += 1
        if not self.announced:
            self.announced, self.due = True, time.monotonic() + EVERY
            self.begun()
        if self.depth == 1:
            self.needed = len(KernelCache.names) + missing(event.data["dispatcher"].py_func, event.data["args"])
            self.ended = threading.Event()
            self.due = max(self.due, time.monotonic() + SOON)  # one after another may take less than EVERY
            threading.Thread(target=self._tick, args=(self.ended,), name="clothfit-progress", daemon=True).start()

    def on_end(self, event: Any) -> None:
        """It is compiled."""
        if isinstance(event.data["dispatcher"], CPUDispatcher):
            self.depth -= 1
            if self.depth == 0:
                self.ended.set()
                self.over()

    def _tick(self, ended: threading.Event) -> None:
        while not ended.wait(self.due - time.monotonic()):
            self.done(min(len(KernelCache.names), self.needed), self.needed)
            self.due = time.monotonic() + EVERY


def missing(function: Callable[..., object], kinds: tuple[Any, ...]) -> int:
    """How many functions an entry needs for arguments of these types that were neither compiled nor loaded yet."""
    there = {name.rsplit("-", 1)[0] for name in KernelCache.names}
    return sum(stem(each) not in there for each in reached(function, "none" in types_text(tuple(kinds))))
