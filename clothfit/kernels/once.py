"""Several processes that need the same kernel at once: one compiles it, the others wait and load it.

Who compiles holds a lock on a file in the folder of the compiled code (`flock`), which the system takes away when the
process ends, however that is. No kernel calls itself through others, so no two processes wait for each other; and who
has waited for long compiles by itself, which is never wrong. Where there are no such locks, as on Windows, or nothing
can be written, all compile.
"""

from __future__ import annotations

import os
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress

from clothfit.kernels.trusted import NO_LINK, Folder

try:
    import fcntl
except ImportError:  # Windows
    fcntl = None  # type: ignore[assignment]

LONGEST = 120.0  # s to wait: several times what the largest kernel takes
PAUSE = 0.02  # s between two looks

alone = False
"""Whether not to wait for others: they compile the same on purpose, from the other end (`helper`)."""


@contextmanager
def locked(folder: Folder, name: str, poll: Callable[[], None]) -> Iterator[None]:
    """Hold the lock of a name in a folder within the block, where that is possible; `poll`, which may raise, is called
    again and again while another process holds it.
    """
    own = f".{name}.lock"
    until = time.monotonic() + LONGEST
    while (lock := _tried(folder, own)) is None and not alone and time.monotonic() < until:
        poll()
        time.sleep(PAUSE)
    try:
        yield
    finally:
        if lock:
            with suppress(OSError):
                os.unlink(folder.place(own), dir_fd=folder.number)  # before others get it: they look for it anew
            os.close(lock)


def _tried(folder: Folder, name: str) -> int | None:
    """The descriptor of a file that is locked now, 0 where there can be none, None where another process has it."""
    if fcntl is None:
        return 0
    try:
        flags = os.O_RDWR | os.O_CREAT | os.O_CLOEXEC | NO_LINK
        number = os.open(folder.place(name), flags, 0o666, dir_fd=folder.number)
    except OSError:
        return 0
    try:
        fcntl.flock(number, fcntl.LOCK_EX | fcntl.LOCK_NB)
        if os.path.samestat(os.fstat(number), os.stat(folder.place(name), dir_fd=folder.number)):
            return number
    except (BlockingIOError, FileNotFoundError):  # the file may have been that of who is done
        pass
    except OSError:
        os.close(number)
        return 0
    os.close(number)
    return None
