"""The one decorator of all compiled functions.

`cache`: compiled once per installation. `error_model="numpy"`: a division by zero gives inf or NaN, which the
per-step check notices, instead of a branch at every division. No fast-math flag: fusing a·b + c into one rounding
(`contract`) would gain a sixth, but which products are fused depends on what is inlined where, and that differs
between code just compiled and the same code from the cache; without it, repeated runs agree to the last bit.
With NUMBA_DISABLE_JIT=1 the same functions run as plain Python.

numba notices a change in the file of a compiled function, but not in the files of the functions it calls: after an
upgrade or an edit, old physics would go on running from the cache. So the cache has a folder of its own for
every state of the sources.
"""

from __future__ import annotations

import functools
import hashlib
import os
import shutil
import time
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path
from typing import Any, TypeVar, overload

import numba

F = TypeVar("F", bound=Callable[..., object])
PACKAGE = Path(__file__).resolve().parent
PREFIX = "kernels-"
OLD = 24 * 3600.0  # s; younger caches of other sources may be in use by a program that runs now
TYPES = ("arrays.py", "system.py", "stencil.py")  # files with types and constants that kernels use, but no kernel
config: Any = numba.config  # numba has no types


def sources() -> list[Path]:
    """The files that compiled code depends on: those with kernels, and the constants and types kernels use."""
    files = [path for path in sorted(PACKAGE.rglob("*.py")) if "cli" not in path.relative_to(PACKAGE).parts]
    return [path for path in files if path.name in TYPES or b"kernel" in path.read_bytes()]


def cache_folder() -> Path:
    """Where compiled code of these sources is kept: where NUMBA_CACHE_DIR says, in the package, or with the user."""
    digest = hashlib.sha256()
    for path in sources():
        digest.update(path.read_bytes())
    own = PACKAGE / "__pycache__"
    if config.CACHE_DIR:
        base = Path(config.CACHE_DIR)
    elif os.access(own if own.exists() else PACKAGE, os.W_OK):
        base = own
    else:
        home = os.environ.get("XDG_CACHE_HOME") or os.environ.get("LOCALAPPDATA") or os.path.expanduser("~/.cache")
        base = Path(home) / "clothfit"
    folder = base / f"{PREFIX}{digest.hexdigest()[:16]}"
    if base == own and not folder.exists():
        for other in own.glob(f"{PREFIX}*"):
            with suppress(OSError):  # another process may be faster
                if time.time() - other.stat().st_mtime > OLD:
                    shutil.rmtree(other, ignore_errors=True)
    return folder


FOLDER = str(cache_folder())


@overload
def kernel(function: F) -> F: ...


@overload
def kernel(*, nogil: bool) -> Callable[[F], F]: ...


def kernel(function: F | None = None, *, nogil: bool = False) -> F | Callable[[F], F]:
    """Compile `function` on first call, with the flags that the module docstring explains.

    `nogil`: other threads of Python may run meanwhile.
    """
    if function is None:
        return functools.partial(kernel, nogil=nogil)
    compile_lazily: Any = numba.njit(cache=True, error_model="numpy", nogil=nogil)
    before = config.CACHE_DIR
    config.CACHE_DIR = FOLDER  # read while decorating, and only then
    try:
        compiled: F = compile_lazily(function)
    finally:
        config.CACHE_DIR = before
    return compiled
