"""Doing something again when files are saved: the newest version counts, however many come at once.

A version is what a file holds, not when it was written. An editor may write a file in several goes, or put another one
in its place; so a change counts when the file has been still for a moment, or after a while where it never is. Files
are looked at now and then, which works on all systems and shared folders.
"""

from __future__ import annotations

import hashlib
import os
import time
from collections.abc import Callable, Sequence
from pathlib import Path

OFTEN = 0.1
"""Seconds between two looks."""

STILL, LONGEST = 0.3, 3.0
"""Seconds for which a file that changes must be still, and after which a change counts anyhow."""

Stamp = tuple[tuple[int, int, int] | None, ...]


class Watch:
    """Some files, and what they held when `next` gave them last."""

    def __init__(self, paths: Sequence[str]) -> None:
        self.paths = list(paths)
        self._known = b""
        self._looked: Stamp = ()
        self._since = self._first = 0.0  # when they changed last, and first since they were given

    def changed(self) -> bool:
        """Whether the files hold something else than what was given last, and are still; to be asked often."""
        now, stamp = time.monotonic(), self._stamp()
        if stamp != self._looked:
            self._first = self._first or now
            self._looked, self._since = stamp, now
        if not self._first or (now < self._since + STILL and now < self._first + LONGEST):
            return False
        self._first = 0.0
        return self._content() != self._known

    def given(self) -> None:
        """Count what the files hold now as given."""
        self._looked, self._known, self._first = self._stamp(), self._content(), 0.0

    def next(self, look: Callable[[], None] = lambda: None) -> None:
        """Wait until the files have changed; `look` is called now and then, and may raise."""
        while not self.changed():
            look()
            time.sleep(OFTEN)

    def _stamp(self) -> Stamp:
        """What the system knows of each file: time, size and number; None where it is missing."""
        found: list[tuple[int, int, int] | None] = []
        for path in self.paths:
            try:
                own = os.stat(path)
                found.append((own.st_mtime_ns, own.st_size, own.st_ino))
            except OSError:
                found.append(None)
        return tuple(found)

    def _content(self) -> bytes:
        """A digest of what the files hold; of one that cannot be read, of nothing."""
        digest = hashlib.sha256()
        for path in self.paths:
            try:
                digest.update(hashlib.sha256(Path(path).read_bytes()).digest())
            except OSError:
                digest.update(b"missing")
        return digest.digest()
