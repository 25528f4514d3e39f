"""Requests to end that come while a result is written."""

from __future__ import annotations

import signal
import time
from collections.abc import Iterator
from contextlib import contextmanager

from clothfit.base.interrupts import REQUESTS, SAME_REQUEST, handle


@contextmanager
def uninterrupted() -> Iterator[None]:
    """Hold interrupts back for the short time in which a result is written and printed.

    If that takes long, because nobody reads from a pipe, a second interrupt a moment after the first ends it.
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
