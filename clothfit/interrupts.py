"""Requests to end that arrive while compiled code runs.

Python calls the handler of a signal only when compiled code returns, or calls back into Python; an exception that the
handler raises in such a call can get lost there. So a handler also leaves a note here, which is read after every
stretch of steps. Whoever handles signals calls `request`, as the command line does.
"""

from __future__ import annotations

_requested = False


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
