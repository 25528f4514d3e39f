"""The one decorator of all compiled functions.

Compiled code is kept on disk by `cache`. `error_model="numpy"`: a division by zero gives inf or NaN, which the
per-step check notices, instead of a branch at every division. No fast-math flag: fusing a·b + c into one rounding
(`contract`) would gain a sixth, but which products are fused depends on what is inlined where, and that differs
between code just compiled and the same code from the cache; without it, repeated runs agree to the last bit.

Most kernels are only called by kernels. The code that makes a function callable from Python, which takes a structure
of thirty arrays apart, is then a third of what there is to compile. So each kernel is two functions for numba: one
that other kernels call, without that code, and one for calls from Python, compiled only when there is such a call.

numba is imported, and told of a function, when that is first called: to read a scene, or to ask for help, must not wait
for a compiler, and of the kernels of a simulation in the cache only those are touched that Python calls.
"""

from __future__ import annotations

import functools
from collections.abc import Callable
from functools import cached_property
from typing import Any, TypeVar, overload

from clothfit.base.errors import NotCompiled

F = TypeVar("F", bound=Callable[..., object])
R = TypeVar("R", bound=type)


def record(own: R) -> R:
    """Mark a NamedTuple that kernels pass to each other as one pointer, not as all of its parts: see `records`. They
    may read its fields by their names, and neither make nor unpack one. An array of it that a kernel returns to Python
    has no owner: keep the record as long as that is used.
    """
    own.goes_as_pointer = True  # type: ignore[attr-defined]
    return own


class Kernel:
    """A function that is compiled when it is first called, by Python or by another one that is being compiled."""

    def __init__(self, function: Callable[..., object], nogil: bool, result: object = ...) -> None:
        functools.update_wrapper(self, function)
        self.py_func, self.nogil, self.result = function, nogil, result

    def __call__(self, *arguments: Any) -> Any:
        """Call the compiled function."""
        try:
            return self.outer(*arguments)
        except NotCompiled:  # without a reason Ctrl-C came before anything else
            raise NotCompiled.reasons.pop() if NotCompiled.reasons else KeyboardInterrupt from None

    @cached_property
    def outer(self) -> Any:
        """numba's function for calls from Python."""
        from clothfit.kernels import compiling

        function = self.py_func if self.result is ... else compiling.calling(self)
        return compiling.for_python(function, self.nogil)

    @cached_property
    def inner(self) -> Any:
        """numba's function for calls from kernels."""
        from clothfit.kernels import compiling

        return compiling.for_kernels(self.py_func, self.result)

    def address(self, kinds: tuple[Any, ...]) -> int:
        """Where the machine code of a kernel that is compiled `apart` is, for arguments of these types."""
        from clothfit.kernels import compiling

        return compiling.address(self.inner, kinds, self.result)

    @property
    def _numba_type_(self) -> Any:
        """What numba takes this object for where a kernel uses it."""
        from numba.core import types

        return types.Dispatcher(self.inner)


class OfPart(Kernel):
    """A kernel whose first argument is a part that a cloth may not have: where that is None, or with `rows` where its
    first array has none, kernels do without the call. So nothing is compiled for a part of type None, nor, if the
    kernel is called `apart`, for one without rows.
    """

    def __init__(
        self, function: Callable[..., object], nogil: bool, absent: object, result: object, rows: bool
    ) -> None:
        super().__init__(function, nogil, result)
        self.absent, self.rows = absent, rows

    def __call__(self, *arguments: Any) -> Any:
        """Call the compiled function, if there is the part."""
        part = arguments[0]
        is_absent = part is None or (self.rows and not len(part[0]))
        return self.absent if is_absent else super().__call__(*arguments)

    @cached_property
    def inner(self) -> Any:
        """numba's function for calls from kernels."""
        from clothfit.kernels import compiling

        return compiling.for_kernels_of_part(self.py_func, self.result, self.absent, self.rows)


class OfKind(Kernel):
    """One name for kernels that do the same for NamedTuples of several classes, their first arguments."""

    def __init__(self, kernels: dict[type, Kernel]) -> None:
        super().__init__(next(iter(kernels.values())).py_func, False)
        self.kernels = kernels

    @cached_property
    def inner(self) -> Any:
        """numba's function for calls from kernels, which alone call it."""
        from clothfit.kernels import compiling

        return compiling.for_kernels_of_kind(self.kernels)


class InPython:
    """numba's `objmode`: what of a kernel runs in the interpreter."""

    def __call__(self, **types: str) -> Any:
        """The context in which the variables get these types."""
        import numba

        return numba.objmode(**types)

    def __getattr__(self, name: str) -> Any:
        import numba

        return numba.typeof(numba.objmode) if name == "_numba_type_" else getattr(numba.objmode, name)


objmode = InPython()


@overload
def kernel(function: F) -> F: ...


@overload
def kernel(
    *, nogil: bool = False, absent: object = ..., empty: object = ..., apart: object = ...
) -> Callable[[F], F]: ...


def kernel(
    function: F | None = None, *, nogil: bool = False, absent: object = ..., empty: object = ..., apart: object = ...
) -> F | Callable[[F], F]:
    """Compile `function` on first call, with the flags that the module docstring explains.

    `nogil`: other threads of Python may run meanwhile. `absent`: what it returns where its first argument is None;
    `empty`: where that is None, or a tuple whose first array has no rows. `apart`: it is compiled once, not into each
    of its callers, and returns what has the type of this.
    """
    if function is None:
        return functools.partial(kernel, nogil=nogil, absent=absent, empty=empty, apart=apart)
    rows = empty is not ...
    if rows and apart is ...:
        raise TypeError(f"{function.__name__}: what has no call without rows is called apart")
    missing = empty if rows else absent
    made: Any = Kernel(function, nogil, apart) if missing is ... else OfPart(function, nogil, missing, apart, rows)
    return made  # type: ignore[no-any-return]
