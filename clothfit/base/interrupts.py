"""Requests to end that arrive while compiled code runs.

Python calls the handler of a signal only when compiled code returns or calls back into Python, and an exception that
the handler raises in such a call can get lost. So the handler also calls `request`, and the simulation calls `check`
after every stretch of steps.
"""

from __future__ import annotations

import signal
from collections.abc import Callable, Iterator
from contextlib import contextmanager

REQUESTS = [getattr(signal, name) for name in ("SIGINT", "SIGTERM", "SIGHUP") if hasattr(signal, name)]
"""Signals that ask the program to end: Ctrl-C, a polite kill, a closed terminal."""

SAME_REQUEST = 1.0
"""Seconds within which two requests count as one."""

_requested = False


def handle(handler: Callable[[int, object], object]) -> None:
    """Install a handler of requests. A program started by `nohup` goes on ignoring a closed terminal."""
    for kind in REQUESTS:
        if kind in (signal.SIGINT, signal.SIGTERM) or signal.getsignal(kind) is not signal.SIG_IGN:
            signal.signal(kind, handler)


def request() -> None:
    """Record that the program should end."""
    global _requested
    _requested = True


def clear() -> None:
    """Forget a request."""
    global _requested
    _requested = False


def check() -> None:
    """Raise KeyboardInterrupt when there was a request."""
    if _requested:
        raise KeyboardInterrupt


@contextmanager
def heard() -> Iterator[None]:
    """Raise KeyboardInterrupt where compiled code, interrupted in a call into Python, raises a SystemError."""
    try:
        yield
    except SystemError:
        check()
        raise
