"""The one decorator of all compiled functions.

Compiled code is kept, see `kernel_cache`. `error_model="numpy"`: a division by zero gives inf or NaN, which the
per-step check notices, instead of a branch at every division. No fast-math flag: fusing a·b + c into one rounding
(`contract`) would gain a sixth, but which products are fused depends on what is inlined where, and that differs
between code just compiled and the same code from the cache; without it, repeated runs agree to the last bit.
With NUMBA_DISABLE_JIT=1 the same functions run as plain Python.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, TypeVar

import numba

from clothfit.kernel_cache import KernelCache

F = TypeVar("F", bound=Callable[..., object])


def kernel(function: F) -> F:
    """Compile `function` on first call, with the flags that the module docstring explains."""
    compiled: Any = numba.njit(error_model="numpy")(function)
    if compiled is not function:  # as it is with NUMBA_DISABLE_JIT
        compiled._cache = KernelCache(function)
    made: F = compiled
    return made
