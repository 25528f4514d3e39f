"""The one decorator of all compiled functions.

Compiled code is kept on disk by `cache`. `error_model="numpy"`: a division by zero gives inf or NaN, which the
per-step check notices, instead of a branch at every division. No fast-math flag: fusing a·b + c into one rounding
(`contract`) would gain a sixth, but which products are fused depends on what is inlined where, and that differs
between code just compiled and the same code from the cache; without it, repeated runs agree to the last bit.
With NUMBA_DISABLE_JIT=1 the same functions run as plain Python.

Most kernels are only called by kernels. The code that makes a function callable from Python, which takes a structure
of thirty arrays apart, is then a third of what there is to compile. So each kernel is two functions for numba: one
that other kernels call, without that code, and one for calls from Python, compiled only when there is such a call.

The compiler calls back into Python, and an exception from there is lost: the function then counts as compiled, without
any code. So Ctrl-C waits for the next of the passes that a compilation consists of.
"""

from __future__ import annotations

import functools
from collections.abc import Callable
from typing import Any, TypeVar, overload

import numba
from numba.core import event

from clothfit.base.interrupts import postponed
from clothfit.kernels.cache import KernelCache

F = TypeVar("F", bound=Callable[..., object])
FLAGS: dict[str, Any] = {"error_model": "numpy", "no_cfunc_wrapper": True}  # nothing calls by a C function pointer


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
    compile_lazily: Any = numba.njit  # its types know neither of these flags
    outer: Any = compile_lazily(**FLAGS, nogil=nogil)(function)
    if outer is not function:  # as it is with NUMBA_DISABLE_JIT
        inner: Any = compile_lazily(**FLAGS, no_cpython_wrapper=True)(function)
        inner._cache, outer._cache = KernelCache(function, "inner"), KernelCache(function)
        outer._compile_for_args = interruptible(outer._compile_for_args)
        outer.get_call_template, outer.get_overload = inner.get_call_template, inner.get_overload  # for kernels
    made: F = outer
    return made


def interruptible(compile_for_args: Callable[..., object]) -> Callable[..., object]:
    """The same function, which numba calls to compile or load, where Ctrl-C comes only at the start of a pass."""

    def compile_between_requests(*arguments: object, **keywords: object) -> object:
        with postponed() as look, event.install_listener("numba:run_pass", _Passes(look)):
            return compile_for_args(*arguments, **keywords)

    return compile_between_requests


class _Passes(event.Listener):
    """Calls a function at the start of every pass of the compiler."""

    def __init__(self, call: Callable[[], None]) -> None:
        self.call = call

    def on_start(self, event: object) -> None:
        self.call()

    def on_end(self, event: object) -> None:
        """Do nothing."""
