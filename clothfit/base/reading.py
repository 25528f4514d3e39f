"""Reading files from anybody: never more than a limit, whatever the file is.

A device never ends, a pipe has no known length, and a file may be as large as a disk, or grow while it is read. A file
that is replaced in one step is read as it was; one that is overwritten in place could be read half old and half new,
and half a motion may look like a whole one.
"""

from __future__ import annotations

import errno
import os
import stat
from collections.abc import Iterator
from contextlib import contextmanager
from typing import IO, Any

from clothfit.base import memory
from clothfit.base.memory import human

MOST_TEXT = 500_000_000
"""Bytes of a scene: several times those of the largest."""

UNSIZED_CHUNK = 1 << 24
"""Bytes to read at a time from a file of unknown length."""

CHANGED = "it changed while it was read; try again"


def whole(file: IO[Any], most: int | None = None) -> Any:
    """The content of an open file, text or bytes.

    Raises OSError, with a sentence as its `strerror`, when that is more than `most` (default: than fits twice into the
    free memory, as the pieces are copied once), and when the file grew meanwhile: one that is written as fast as it is
    read would never end.
    """
    limit = memory.free() // 2 if most is None else most
    known = _size(file)
    pieces: list[Any] = []
    size = known if known > limit else 0
    while size <= limit:
        piece = file.read(min(max(known + 1, UNSIZED_CHUNK), limit + 1 - size))  # the read takes so much memory at once
        if not isinstance(piece, (str, bytes)):
            raise TypeError(f"the file gave {type(piece).__name__} instead of text or bytes")
        pieces.append(piece)
        if not piece:
            return piece.join(pieces)
        size += len(piece)
        if 0 < known < size <= limit:
            raise OSError(errno.EBUSY, CHANGED)
    why = "for which there is memory" if most is None else "that can be read"
    raise OSError(errno.EFBIG, f"it has more than the {human(limit)} {why}")


def _size(file: IO[Any]) -> int:
    """Bytes of a regular file; 0 where that is not known."""
    try:
        found = os.fstat(file.fileno())
    except (AttributeError, OSError, ValueError):  # a file in memory
        return 0
    return found.st_size if stat.S_ISREG(found.st_mode) else 0


@contextmanager
def unchanged(path: str | os.PathLike[str]) -> Iterator[IO[bytes]]:
    """Open a file to read it in the block. Raises OSError, also when the file changed meanwhile."""
    with open(path, "rb") as file:
        before = os.fstat(file.fileno())
        yield file
        after = os.fstat(file.fileno())
    changed = (before.st_size, before.st_mtime_ns) != (after.st_size, after.st_mtime_ns)
    if changed and stat.S_ISREG(before.st_mode):
        raise OSError(errno.EBUSY, CHANGED, os.fspath(path))
