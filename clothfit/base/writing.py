"""Files that appear whole or not at all.

The data goes to a new file in the same folder, is forced to the disk, and then takes the final name in one step.
Whatever happens before that step, what was there stays. Devices and pipes (`/dev/stdout`) have no such
step and are written directly. What a killed process left of its new file, a later one takes away (`temporary`).
"""

from __future__ import annotations

import io
import os
import stat
from collections.abc import Callable
from contextlib import suppress
from typing import IO, TypeAlias

from clothfit.base import temporary
from clothfit.base.errors import InvalidInput

Data: TypeAlias = bytes | Callable[[IO[bytes]], object]
"""What to write: bytes, or a function that writes them to a file, so that they need not be in memory."""


def write_atomically(path: str | os.PathLike[str], data: Data) -> None:
    """Write a file whole, keeping the permission bits of the one it replaces; a link stays and its target is replaced.

    Raises InvalidInput when it cannot be written; then, and on an interrupt, no trace is left.
    """
    check_writable(path)
    try:
        mode = _mode(path)
        if mode is None or stat.S_ISREG(mode):
            _replace(os.path.realpath(path), data, mode)
        else:
            with open(path, "wb") as device:
                put(data, device)
    except OSError as error:
        raise _refusal(path, error.strerror or str(error)) from error


def check_writable(path: str | os.PathLike[str]) -> None:
    """Check, before long work, that a file can be written there. Raises InvalidInput with the reason."""
    try:
        reason = _obstacle(path)
    except (OSError, ValueError) as error:  # a loop of links, a name too long, a null character
        reason = getattr(error, "strerror", None) or str(error)
    if reason:
        raise _refusal(path, reason)


def _obstacle(path: str | os.PathLike[str]) -> str | None:
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
        os.stat(folder)  # "permission denied" passes on
    except FileNotFoundError:
        return f"the folder {folder} does not exist"
    return None if os.access(folder, os.W_OK | os.X_OK) else f"the folder {folder} is not writable"


def put(data: Data, stream: IO[bytes]) -> None:
    """Write to what cannot be sought, as an archive that is written must be."""
    if isinstance(data, bytes):
        stream.write(data)
        return
    buffer = io.BytesIO()
    data(buffer)
    stream.write(buffer.getbuffer())


def _replace(path: str, data: Data, mode: int | None) -> None:
    file = temporary.create(os.path.dirname(path))
    try:
        with file:
            file.write(data) if isinstance(data, bytes) else data(file)
            file.flush()
            os.fsync(file.fileno())
            if mode is not None:
                os.chmod(file.name, mode & 0o777)
            os.replace(file.name, path)  # while it is open, as it is locked so long
    except BaseException:  # an interrupt as well
        with suppress(OSError):
            os.unlink(file.name)
        raise


def _mode(path: str | os.PathLike[str]) -> int | None:
    """Give type and permissions of a file, links followed; None when there is none."""
    try:
        return os.stat(path).st_mode
    except FileNotFoundError:
        return None


def _refusal(path: str | os.PathLike[str], reason: str) -> InvalidInput:
    return InvalidInput(f"cannot write {os.fspath(path)}: {reason}")
