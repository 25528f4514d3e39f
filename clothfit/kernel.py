"""The one decorator of all compiled functions.

`cache`: compiled once per installation. `error_model="numpy"`: a division by zero gives inf or NaN, which the
per-step check notices, instead of a branch at every division. `contract`: a·b + c may be one rounding instead of
two; unlike the other fast-math flags it keeps NaN, inf and the order of sums, so results stay reproducible.
With NUMBA_DISABLE_JIT=1 the same functions run as plain Python.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, TypeVar

import numba

F = TypeVar("F", bound=Callable[..., object])


def kernel(function: F) -> F:
    """Compile `function` on first call, with the flags that the module docstring explains."""
    compile_lazily: Any = numba.njit(cache=True, error_model="numpy", fastmath={"contract"})
    compiled: F = compile_lazily(function)
    return compiled
