"""What commands print: messages on standard error, results that are text on standard output, and only these there.

A result goes to standard error where standard output holds data: the summary of --json, a motion, a scene.

Colour only on a terminal, and not where NO_COLOR is set.
"""

from __future__ import annotations

import os
import sys
import time
from collections.abc import Iterator, Sequence
from contextlib import contextmanager, suppress
from dataclasses import dataclass, field
from typing import TextIO

from clothfit.base.messages import harmless, spelled

COMPILING = "compiling for this machine, as at the first use of each kind of scene …"
ERASED = "\x1b[K"  # what is left of a line, on a terminal
_listening: list[object] = []  # to compilations


@dataclass
class Console:
    """Speaks to the user as loudly as asked."""

    quiet: bool = False
    verbose: bool = False
    data: bool = False  # whether standard output holds data
    began: float = field(default_factory=time.perf_counter)

    @property
    def animated(self) -> bool:
        """Whether standard error is a terminal that wants colour and movement."""
        return sys.stderr.isatty() and not os.environ.get("NO_COLOR") and os.environ.get("TERM") != "dumb"

    def say(self, *messages: str, of: str = "") -> None:
        """Print messages, unless quiet; each begins with what they are `of`, where that is said."""
        for message in messages if not self.quiet else ():
            self._print(f"{of}: {message}" if of else message)

    def detail(self, message: str) -> None:
        """Print a message with the time since the start, with --verbose only."""
        if self.verbose:
            self._print(f"[{time.perf_counter() - self.began:7.2f} s] {message}")

    def result(self, *texts: str, of: str = "") -> None:
        """Print what the command was asked for, each a line or more, unless quiet. Raises OSError."""
        if self.data:
            self.say(*texts, of=of)
        elif not self.quiet:
            for text in texts:
                print(spelled(harmless(f"{of}: {text}" if of else text), sys.stdout.encoding), flush=True)

    def _print(self, message: str) -> None:
        try:
            print(spelled(harmless(message), sys.stderr.encoding), file=sys.stderr, flush=True)
        except OSError:  # whoever read the messages has left; the work goes on
            self.quiet, self.verbose = True, False
            with suppress(OSError):
                os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stderr.fileno())

    def warn(self, *messages: str, of: str = "") -> None:
        """Print warnings."""
        self.say(*messages, of=f"warning: {of}" if of else "warning")

    def table(self, rows: Sequence[Sequence[str]]) -> None:
        """Print a result, rows of equal length in columns; the first row is the header. Raises OSError."""
        widths = [max(len(row[i]) for row in rows) for i in range(len(rows[0]))]
        lines = ["  ".join(cell.ljust(width) for cell, width in zip(row, widths, strict=True)) for row in rows]
        self.result("\n".join(line.rstrip() for line in lines))

    def announce_compilation(self, message: str = COMPILING) -> None:
        """Say so, once, when the first use of the program makes it compile, and how far that is, as it takes seconds
        and looks like hanging. Say also when what is compiled cannot be kept.
        """
        from numba.core import event  # here, as numba takes half a second to import

        from clothfit.kernels import cache as kernel_cache
        from clothfit.kernels.progress import Compilations

        kernel_cache.warn = self.warn
        if _listening:  # an earlier command's, in the same process
            event.unregister("numba:compile", _listening.pop())
        _listening.append(Compilations(lambda: self.say(message), self._compiled, self._erase))
        event.register("numba:compile", _listening[0])

    def _compiled(self, done: int, needed: int) -> None:
        """Say how far a compilation is: on a terminal always in the same line."""
        text = f"compiled {done} of {needed} functions"
        if not self._overwrites:
            self.say(text)
        elif not self.quiet:
            print(f"\r{text}", end=ERASED, file=sys.stderr, flush=True)

    def _erase(self) -> None:
        if self._overwrites and not self.quiet:
            print("\r", end=ERASED, file=sys.stderr, flush=True)

    @property
    def _overwrites(self) -> bool:
        """Whether a line may be written again: not where a live display has the terminal."""
        return self.animated and sys.stderr is sys.__stderr__


# ---- Standard output for results alone, whatever a library prints.
#
# LAPACK and other libraries in C print to descriptor 1. So the results go to a copy of that descriptor, and descriptor
# 1 itself leads to standard error, for this process and those that it starts.

OUTPUT, ERRORS = 1, 2  # descriptors


@contextmanager
def results_apart() -> Iterator[None]:
    """Within the block, what is not written through `sys.stdout` goes to standard error.

    Does nothing where `sys.stdout` is not descriptor 1, as in a test that captures it.
    """
    stream, before = sys.stdout, sys.__stdout__
    if not _is_output(stream):
        yield
        return
    stream.flush()
    with open(os.dup(OUTPUT), "w", encoding=stream.encoding, errors=stream.errors) as results:
        os.dup2(ERRORS, OUTPUT)
        sys.stdout = sys.__stdout__ = results  # type: ignore[misc]  # the second is asked for a terminal's width
        try:
            yield
        finally:
            sys.stdout, sys.__stdout__ = stream, before  # type: ignore[misc]
            os.dup2(results.fileno(), OUTPUT)
            with suppress(OSError):  # whoever read it has left; the exit code says so
                results.flush()


def _is_output(stream: TextIO) -> bool:
    try:
        return stream.fileno() == OUTPUT
    except (OSError, ValueError):  # a stream of a test, or closed
        return False
