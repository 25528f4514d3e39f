"""Requests to end that come while a result is written."""

from __future__ import annotations

import signal
import time
from collections.abc import Iterator
from contextlib import contextmanager

from clothfit.base.interrupts import REQUESTS, SAME_REQUEST, handle


@contextmanager
def uninterrupted() -> Iterator[None]:
    """Let interrupts wait: for the short time in which a result is written and told.

    Where that takes long, as nobody reads from a pipe, one that comes a moment after another ends it.
    """
    first: list[float] = []

    def wait(number: int, frame: object) -> None:
        first.append(time.monotonic())
        if first[-1] - first[0] > SAME_REQUEST:
            raise KeyboardInterrupt

    before = [(kind, signal.getsignal(kind)) for kind in REQUESTS]
    handle(wait)
    try:
        yield
    finally:
        for kind, handler in before:
            signal.signal(kind, handler)
