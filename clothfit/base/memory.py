"""How much memory is free, and sizes as people write them."""

from __future__ import annotations

import os
import re
from contextlib import suppress
from functools import cache
from pathlib import Path
from typing import Any

from clothfit.base.errors import InvalidInput

BYTES_PER_UNIT = {
    "": 1, "b": 1, "k": 10**3, "kb": 10**3, "m": 10**6, "mb": 10**6, "g": 10**9, "gb": 10**9, "t": 10**12, "tb": 10**12,
    "ki": 2**10, "kib": 2**10, "mi": 2**20, "mib": 2**20, "gi": 2**30, "gib": 2**30, "ti": 2**40, "tib": 2**40,
}  # fmt: skip
"""Bytes by unit, in lower case; as on a disk's label, KB is 1000 bytes and KiB is 1024."""

FIT_SHARE = 0.5
"""The share of the free memory that a fit takes by default."""

LIMITS = (
    ("/sys/fs/cgroup/memory.max", "/sys/fs/cgroup/memory.current"),
    ("/sys/fs/cgroup/memory/memory.limit_in_bytes", "/sys/fs/cgroup/memory/memory.usage_in_bytes"),
)
"""The files with a container's limit and use, in bytes; `memory.stat` beside them has the cached part."""

M_MMAP_THRESHOLD, M_ARENA_MAX = -3, -8
LARGE_BLOCK = 1 << 18
"""Names of glibc's `mallopt`, and the bytes from which a block is mapped by itself."""

ALWAYS_FREE = 16_000_000
"""Bytes that are always free in a process that could load its libraries."""


def parse(size: int | str) -> int:
    """Bytes of a size such as 200MB, 2GiB, 1.5G or a plain number. Raises InvalidInput."""
    match = re.fullmatch(r"\s*([0-9]*\.?[0-9]+(?:e\+?[0-9]+)?)\s*([a-z]*)\s*", str(size), re.IGNORECASE)
    if match is None or match[2].lower() not in BYTES_PER_UNIT:
        raise InvalidInput(f"memory: {size!r} is not a size; give one such as 200MB, 2GiB or 1.5G")
    value = float(match[1]) * BYTES_PER_UNIT[match[2].lower()]
    if not 1 <= value < 2**63:
        raise InvalidInput(f"memory must be between 1 byte and 8 EiB; {size!r} was given")
    return int(value)


def budget(size: int | str | None) -> int:
    """Bytes that a fit may hold: the given `size`, else half of what is free. Raises InvalidInput."""
    return parse(size) if size is not None else int(FIT_SHARE * free())


def free() -> int:
    """Bytes of memory that this process can take now: what the system has left, within the limits of a container and of
    the process (`ulimit -v`).
    """
    found = [available(), allowed(), *(left(Path(most), Path(used)) for most, used in LIMITS)]
    return min(each for each in found if each is not None)


def missing(needed: int) -> int | None:
    """The free bytes, if more are `needed`; else None. ALWAYS_FREE is not looked up, as looking takes as long as some
    steps of a small cloth.
    """
    if needed < ALWAYS_FREE:
        return None
    found = free()
    return found if needed > found else None


def available() -> int:
    """Bytes that the system can give without swapping; if it does not say, all that the machine has."""
    with suppress(OSError, ValueError, IndexError):
        for line in Path("/proc/meminfo").read_text().splitlines():
            if line.startswith("MemAvailable:"):
                return 1024 * int(line.split()[1])
    return physical()


def physical() -> int:
    """Bytes of memory that the machine has; if the system does not say, a terabyte."""
    return os.sysconf("SC_PHYS_PAGES") * os.sysconf("SC_PAGE_SIZE") if hasattr(os, "sysconf") else 2**40


def left(most: Path, used: Path) -> int | None:
    """Bytes that a container has left of its limit; None without a limit."""
    with suppress(OSError, ValueError):  # "max" is no number
        return max(int(most.read_text()) - int(used.read_text()) + cached(used.parent / "memory.stat"), 0)
    return None


def cached(stat: Path) -> int:
    """Bytes that a container uses to cache files, and gives back when they are needed."""
    with suppress(OSError, ValueError, IndexError):
        return next(int(line.split()[1]) for line in stat.read_text().splitlines() if line.startswith("inactive_file "))
    return 0


def allowed() -> int | None:
    """Bytes that this process has left of its address space; None without a limit."""
    with suppress(ImportError, OSError, ValueError, IndexError):
        import resource  # not on Windows

        most = resource.getrlimit(resource.RLIMIT_AS)[0]
        if most != resource.RLIM_INFINITY:
            used = int(Path("/proc/self/statm").read_text().split()[0]) * os.sysconf("SC_PAGE_SIZE")
            return max(most - used, 0)
    return None


def human(size: float) -> str:
    """A number of bytes with its unit."""
    for unit in ("bytes", "kB", "MB"):
        if size < 999.5:
            return f"{size:.3g} {unit}"
        size /= 1000
    return f"{size:.3g} GB"


def check_memory(frames: int, vertices: int, iterations: int) -> None:
    """Raise InvalidInput, with the figure, when a motion with its velocities cannot be kept in the memory that is free;
    0 `iterations`: the positions alone.
    """
    needed = 24 * (1 + iterations) * frames * vertices
    most = missing(needed)
    if most is not None:
        count = str(frames) if frames < 10**15 else f"more than {10**15:.0e}"
        raise InvalidInput(
            f"{count} frames of {vertices} vertices take {human(min(needed, 10**30))}, "
            f"{human(most)} of memory are free; use fewer frames (--steps, --fps, optimizationIterations)"
        )


def tidy() -> None:
    """Let this process give memory back when it is freed: large blocks are mapped one by one, and few arenas are
    used. For programs that run long; on systems without glibc it does nothing.
    """
    library = glibc()
    if library is not None:
        library.mallopt(M_MMAP_THRESHOLD, LARGE_BLOCK)
        library.mallopt(M_ARENA_MAX, 2)


def give_back() -> None:
    """Give freed memory back to the system, where glibc kept it."""
    library = glibc()
    if library is not None:
        library.malloc_trim(0)


@cache
def glibc() -> Any:
    """The C library, where it is glibc; else None."""
    import ctypes

    with suppress(OSError, AttributeError, TypeError):
        library = ctypes.CDLL(None)
        if library.malloc_trim and library.mallopt:
            return library
    return None
