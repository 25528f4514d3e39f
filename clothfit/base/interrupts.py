"""Requests to end, and deadlines, that arrive while compiled code runs.

Python calls the handler of a signal only when compiled code returns or calls back into Python, and an exception that
the handler raises in such a call can get lost. So the handler also calls `request`, and the simulation calls `check`
after every stretch of steps.

Work with a result worth keeping runs in `deferred`. Once it calls `hold`, a signal only records the request, and
KeyboardInterrupt comes from `check` alone: never between two lines that belong together. Whoever catches it calls
`answer`: what is left is short, and nothing raises any more until the block ends.
"""

from __future__ import annotations

import _thread
import signal
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager, nullcontext, suppress
from dataclasses import dataclass
from typing import Any

REQUESTS = [getattr(signal, name) for name in ("SIGINT", "SIGTERM", "SIGHUP") if hasattr(signal, name)]
"""Signals that ask the program to end: Ctrl-C, a polite kill, a closed terminal."""

Handler = Callable[[int, object], object]
"""Of a signal: is called with its number and the frame that it interrupts."""

SAME_REQUEST = 1.0
"""Seconds within which two requests count as one."""


class OutOfTime(Exception):
    """The deadline of what runs has passed (`limited`)."""


@dataclass
class State:
    """What was asked of this process."""

    requested: float | None = None  # when the program was asked to end, s of the monotonic clock
    depth: int = 0  # blocks of `deferred` that are open
    holding: bool = False  # whether there is a result to keep
    answered: bool = False  # whether the result is on its way out
    deadline: float = float("inf")  # s of the monotonic clock, without what is left out
    left_out: float = 0.0  # s that count towards no deadline


_state = State()
_here = threading.local()


def handle(handler: Handler) -> None:
    """Install a handler of requests. A program started by `nohup` goes on ignoring a closed terminal."""
    for kind in REQUESTS:
        if kind in (signal.SIGINT, signal.SIGTERM) or signal.getsignal(kind) is not signal.SIG_IGN:
            signal.signal(kind, handler)


def request() -> None:
    """Record that the program should end."""
    if _state.requested is None:
        _state.requested = time.monotonic()


def ask(number: int = signal.SIGINT) -> None:
    """Send a request to the main thread, from any thread; as a signal where there are any, as that also ends a wait."""
    main = threading.main_thread().ident
    if hasattr(signal, "pthread_kill") and main is not None:
        signal.pthread_kill(main, number)
    else:
        _thread.interrupt_main(signal.Signals(number))


def clear() -> None:
    """Forget a request."""
    _state.requested, _state.answered = None, False


def requested() -> bool:
    """Whether there was a request, answered or not."""
    return _state.requested is not None


def check() -> None:
    """Raise KeyboardInterrupt when there was a request, OutOfTime when the deadline has passed."""
    check_request()
    if now() > _state.deadline:
        raise OutOfTime


def leave_out(seconds: float) -> None:
    """Let all deadlines be later by so many seconds, in which something else was done, such as compiling."""
    _state.left_out += seconds


def now() -> float:
    """Seconds of the clock by which deadlines are kept."""
    return time.monotonic() - _state.left_out


def check_request() -> None:
    """Raise KeyboardInterrupt when there was a request that is not answered yet, and in a thread whose result nobody
    waits for any more.
    """
    over: threading.Event | None = getattr(_here, "over", None)
    if (_state.requested is not None and not _state.answered) or (over is not None and over.is_set()):
        raise KeyboardInterrupt


@contextmanager
def abandoned_by(over: threading.Event) -> Iterator[None]:
    """Let `check` raise KeyboardInterrupt in this thread once it is `over`."""
    _here.over = over
    try:
        yield
    finally:
        _here.over = None


def hold() -> None:
    """Say that there is a result to keep: from now on only `check` raises, up to the end of `deferred`."""
    _state.holding = _state.depth > 0


def answer() -> None:
    """Say that the request is being answered: `check` raises no more KeyboardInterrupt, up to the end of `deferred`."""
    _state.holding = _state.answered = _state.depth > 0


@contextmanager
def handled(make: Callable[[Handler], Handler]) -> Iterator[None]:
    """Within the block, in the main thread, let `make` put another handler of requests in the place of each."""
    before: dict[signal.Signals, Any] = {}
    if threading.current_thread() is threading.main_thread():  # the only one that handles signals
        before = {kind: handler for kind in REQUESTS if callable(handler := signal.getsignal(kind))}
    try:
        for kind, handler in before.items():
            signal.signal(kind, make(handler))
        yield
    finally:
        for kind, handler in before.items():
            signal.signal(kind, handler)


@contextmanager
def deferred() -> Iterator[None]:
    """Let requests wait for the next `check` once there is a result (`hold`).

    A second request, later than `SAME_REQUEST`, to something that does not look raises KeyboardInterrupt there. The end
    of the outermost block forgets the request.
    """
    _state.depth += 1
    try:
        with handled(_waiting) if _state.depth == 1 else nullcontext():
            yield
    finally:
        _state.depth -= 1
        if _state.depth == 0:
            _state.holding = False
            clear()


def _waiting(handler: Handler) -> Handler:
    """What stands for a handler within `deferred`."""

    def wait(number: int, frame: object) -> None:
        if not _state.holding:
            handler(number, frame)
            return
        since = _state.requested
        with suppress(KeyboardInterrupt):  # it may note the request for itself
            handler(number, frame)
        request()
        if since is not None and not _state.answered and time.monotonic() - since > SAME_REQUEST:
            raise KeyboardInterrupt

    return wait


@contextmanager
def postponed() -> Iterator[Callable[[], None]]:
    """Keep requests that arrive within the block, where no exception may come from between two lines, as in a compiler
    that calls back into Python. They are handled where the yielded function is called, which checks as `check_request`
    does, and at the end.
    """
    kept: list[tuple[Handler, int]] = []

    def handle_kept() -> None:
        while kept:
            handler, number = kept.pop(0)
            handler(number, None)

    def poll() -> None:
        handle_kept()
        check_request()

    try:
        with handled(lambda handler: lambda number, frame: kept.append((handler, number))):
            yield poll
    finally:
        handle_kept()


@contextmanager
def limited(seconds: float | None) -> Iterator[None]:
    """Raise OutOfTime from `check` after so many seconds; never later than a deadline around this one."""
    before = _state.deadline
    if seconds is not None:
        _state.deadline = min(before, now() + max(seconds, 0.0))
    try:
        yield
    finally:
        _state.deadline = before


@contextmanager
def grace(seconds: float) -> Iterator[None]:
    """Let what is short run: `check` raises no KeyboardInterrupt within it, and OutOfTime only after so many seconds
    where less is left until the deadline.
    """
    before, answered = _state.deadline, _state.answered
    _state.deadline, _state.answered = max(before, now() + seconds), True
    try:
        yield
    finally:
        _state.deadline, _state.answered = before, answered


@contextmanager
def heard() -> Iterator[None]:
    """Raise KeyboardInterrupt where compiled code, interrupted in a call into Python, raises a SystemError."""
    try:
        yield
    except SystemError:
        check()
        raise
