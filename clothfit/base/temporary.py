"""New files on their way to a final name, and what killed processes left of theirs.

A process that is killed while it writes leaves its new file behind, under a name of its own and never under a final
one. Whoever writes holds a lock on the file, which the system gives up when the process ends, however it ends. So a
file of this kind whose lock can be had has no writer any more, and is taken away. Locks are only trusted on the machine
that made the file, whose name is part of the file's.
"""

from __future__ import annotations

import hashlib
import os
import platform
import re
import secrets
from contextlib import suppress
from typing import IO

try:
    import fcntl
except ImportError:  # Windows: nothing is locked, and nothing taken away
    fcntl = None  # type: ignore[assignment]

_swept: set[str] = set()  # folders, each once in the life of a process


def create(folder: str) -> IO[bytes]:
    """Open a new file in a folder, locked until it is closed, with the permissions that the umask says.

    What killed processes left there is taken away first. Raises OSError.
    """
    if folder not in _swept:
        _swept.add(folder)
        sweep(folder)
    while True:
        file = open(os.path.join(folder, f"{prefix()}{secrets.token_hex(8)}.tmp"), "xb")  # noqa: SIM115
        lock(file.fileno(), wait=True)
        if os.fstat(file.fileno()).st_nlink or fcntl is None:
            return file
        file.close()  # another process took it for left behind, in the moment before it was locked


def sweep(folder: str) -> None:
    """Take away what killed processes of this machine left in a folder; where that fails, it stays."""
    with suppress(OSError):
        for name in os.listdir(folder):
            if re.fullmatch(re.escape(prefix()) + r"[0-9a-f]{16}\.tmp", name):
                remove_stale(os.path.join(folder, name))


def remove_stale(path: str) -> None:
    """Take a file away unless somebody writes it."""
    with suppress(OSError), open(path, "r+b") as file:
        if lock(file.fileno(), wait=False):
            os.unlink(path)


def lock(number: int, wait: bool) -> bool:
    """Lock an open file until it is closed; whether that was possible."""
    if fcntl is None:
        return False
    try:
        fcntl.flock(number, fcntl.LOCK_EX | (0 if wait else fcntl.LOCK_NB))
    except OSError:  # somebody has it, or the file system knows no locks
        return False
    return True


def prefix() -> str:
    """How the names of these files begin on this machine."""
    return f".clothfit-{hashlib.sha256(platform.node().encode()).hexdigest()[:8]}-"
