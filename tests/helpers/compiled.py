"""The compiled code that this process uses, for other processes."""

import shutil
from pathlib import Path

from clothfit.kernels.cache import KernelCache


def copied(base: Path, *without: str) -> Path:
    """Copy all code that is kept to another base, without the files that fit these patterns; returns the folder there.

    Files that other processes are writing, which begin with a dot, are left out.
    """
    kept = KernelCache.used
    assert kept is not None
    return shutil.copytree(kept, base / kept.name, ignore=shutil.ignore_patterns(".*", *without))
