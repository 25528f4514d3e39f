"""Standard output for results alone, whatever a library prints.

LAPACK and other libraries in C print to descriptor 1. So the results go to a copy of that descriptor, and descriptor 1
itself leads to standard error, for this process and those that it starts.
"""

from __future__ import annotations

import os
import sys
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from typing import TextIO

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
