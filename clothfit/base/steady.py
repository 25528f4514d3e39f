"""Files that must not change while they are read.

A file that is replaced in one step is read as it was. One that is written over in place, by a program that saves or by
a copy that has not ended, could be read half old and half new, and half a motion may look like a whole one.
"""

from __future__ import annotations

import errno
import os
import stat
from collections.abc import Iterator
from contextlib import contextmanager
from typing import IO

CHANGED = "it changed while it was read; try again"


@contextmanager
def steady(path: str | os.PathLike[str]) -> Iterator[IO[bytes]]:
    """Open a file to read it in the block. Raises OSError, also where it changed meanwhile."""
    with open(path, "rb") as file:
        before = os.fstat(file.fileno())
        yield file
        after = os.fstat(file.fileno())
    changed = (before.st_size, before.st_mtime_ns) != (after.st_size, after.st_mtime_ns)
    if changed and stat.S_ISREG(before.st_mode):
        raise OSError(errno.EBUSY, CHANGED, os.fspath(path))
