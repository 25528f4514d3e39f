"""Requests to end that arrive while compiled code runs.

Python calls the handler of a signal only when compiled code returns, or calls back into Python; an exception that the
handler raises in such a call can get lost there. So a handler also leaves a note here, which is read after every
stretch of steps. Whoever handles signals calls `request`, as the command line does.
"""

from __future__ import annotations

import signal
from collections.abc import Callable, Iterator
from contextlib import contextmanager

REQUESTS = [getattr(signal, name) for name in ("SIGINT", "SIGTERM", "SIGHUP") if hasattr(signal, name)]
"""Signals that ask to end: Ctrl-C, a polite kill, a terminal that is closed."""

SAME_REQUEST = 1.0
"""Seconds: requests within it are one."""

_requested = False


def handle(handler: Callable[[int, object], object]) -> None:
    """Install a handler of requests. A program that `nohup` started does not hear that its terminal is closed."""
    for kind in REQUESTS:
        if kind in (signal.SIGINT, signal.SIGTERM) or signal.getsignal(kind) is not signal.SIG_IGN:
            signal.signal(kind, handler)


def request() -> None:
    """Note that the program should end."""
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
    """Raise KeyboardInterrupt where compiled code that was interrupted in a call into Python ends as a SystemError."""
    try:
        yield
    except SystemError:
        check()
        raise
