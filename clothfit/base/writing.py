"""Files that appear whole or not at all.

The data go to a new file in the same folder, are forced to the disk, and the file then takes the final name in one
step. Whatever happens before that step, the old file stays. Devices and pipes (`/dev/stdout`) have no such step and are
written directly. A process that is killed while it writes leaves its new file behind, under a temporary name. A writer
locks its file, and the system releases the lock when the process ends, however it ends. So a temporary file without a
lock has no writer any more, and a later process removes it. Locks are trusted only on the machine that made the file,
which its name encodes.
"""

from __future__ import annotations

import hashlib
import io
import os
import platform
import re
import secrets
import stat
import sys
from collections.abc import Callable
from contextlib import suppress
from typing import IO, TypeAlias

from clothfit.base.errors import InvalidInput

try:
    import fcntl
except ImportError:  # Windows: nothing is locked, and nothing removed
    fcntl = None  # type: ignore[assignment]

Data: TypeAlias = bytes | Callable[[IO[bytes]], object]
"""What to write: bytes, or a function that writes them to a file, so that they need not be in memory."""

OUTPUT = ("/dev/stdout", "/dev/fd/1", "/proc/self/fd/1")
"""Names of standard output."""

_swept: set[str] = set()  # folders; each is swept once in the life of a process


def write_atomically(path: str | os.PathLike[str], data: Data) -> None:
    """Write a file whole, keeping the permission bits of the one it replaces; a link stays and its target is replaced.

    Raises InvalidInput when the file cannot be written; then, and on an interrupt, no trace is left.
    """
    check_writable(path)
    try:
        if is_output(path):
            sys.stdout.flush()
            put(data, sys.stdout.buffer)
            sys.stdout.buffer.flush()
            return
        mode = _mode(path)
        if mode is None or stat.S_ISREG(mode):
            _replace(os.path.realpath(path), data, mode)
        else:
            with open(path, "wb") as device:
                put(data, device)
    except OSError as error:
        raise _refusal(path, error.strerror or str(error)) from error


def check_writable(path: str | os.PathLike[str]) -> None:
    """Check, before long work, that a file can be written. Raises InvalidInput with the reason."""
    try:
        reason = _obstacle(path)
    except (OSError, ValueError) as error:  # a loop of links, a name too long, a null character
        reason = getattr(error, "strerror", None) or str(error)
    if reason:
        raise _refusal(path, reason)


def is_output(path: str | os.PathLike[str]) -> bool:
    """Whether a path is a name of standard output, which is a file that only `sys.stdout` knows: the program gives its
    descriptor to others.
    """
    return os.fspath(path) in OUTPUT and hasattr(sys.stdout, "buffer")


def _obstacle(path: str | os.PathLike[str]) -> str | None:
    if is_output(path):
        return None
    mode = _mode(path)
    if mode is not None and stat.S_ISDIR(mode):
        return "it is a folder"
    if not os.path.basename(path):
        return "it does not name a file"
    if mode is not None and not os.access(path, os.W_OK):
        return "the file is there and is not writable"
    if mode is not None and not stat.S_ISREG(mode):
        return None
    folder = os.path.dirname(os.path.realpath(path))
    try:
        os.stat(folder)  # the caller handles "permission denied"
    except FileNotFoundError:
        return f"the folder {folder} does not exist"
    return None if os.access(folder, os.W_OK | os.X_OK) else f"the folder {folder} is not writable"


def put(data: Data, stream: IO[bytes]) -> None:
    """Write to a stream that may not be seekable, though writing an archive needs that."""
    if isinstance(data, bytes):
        stream.write(data)
        return
    buffer = io.BytesIO()
    data(buffer)
    stream.write(buffer.getbuffer())


def _replace(path: str, data: Data, mode: int | None) -> None:
    file = create(os.path.dirname(path))
    try:
        with file:
            file.write(data) if isinstance(data, bytes) else data(file)
            file.flush()
            os.fsync(file.fileno())
            if mode is not None:
                os.chmod(file.name, mode & 0o777)
            os.replace(file.name, path)  # while it is open, and so locked
    except BaseException:  # an interrupt as well
        with suppress(OSError):
            os.unlink(file.name)
        raise


def _mode(path: str | os.PathLike[str]) -> int | None:
    """The type and permissions of a file, links followed; None when there is no file."""
    try:
        return os.stat(path).st_mode
    except FileNotFoundError:
        return None


def _refusal(path: str | os.PathLike[str], reason: str) -> InvalidInput:
    return InvalidInput(f"cannot write {os.fspath(path)}: {reason}")


def create(folder: str) -> IO[bytes]:
    """Open a new file in a folder, locked until it is closed, with the permissions of the umask.

    First removes what killed processes left there. Raises OSError.
    """
    if folder not in _swept:
        _swept.add(folder)
        sweep(folder)
    while True:
        file = open(os.path.join(folder, f"{prefix()}{secrets.token_hex(8)}.tmp"), "xb")  # noqa: SIM115
        lock(file.fileno(), wait=True)
        if os.fstat(file.fileno()).st_nlink or fcntl is None:
            return file
        file.close()  # another process removed it in the moment before it was locked


def sweep(folder: str) -> None:
    """Remove what killed processes of this machine left in a folder; what cannot be removed stays."""
    with suppress(OSError):
        for name in os.listdir(folder):
            if re.fullmatch(re.escape(prefix()) + r"[0-9a-f]{16}\.tmp", name):
                path = os.path.join(folder, name)
                with suppress(OSError), open(path, "r+b") as file:
                    if lock(file.fileno(), wait=False):  # else a process is writing it
                        os.unlink(path)


def lock(number: int, wait: bool) -> bool:
    """Lock an open file until it is closed; returns whether that was possible."""
    if fcntl is None:
        return False
    try:
        fcntl.flock(number, fcntl.LOCK_EX | (0 if wait else fcntl.LOCK_NB))
    except OSError:  # another process has the lock, or the file system has no locks
        return False
    return True


def prefix() -> str:
    """The beginning of the names of temporary files on this machine."""
    return f".clothfit-{hashlib.sha256(platform.node().encode()).hexdigest()[:8]}-"
