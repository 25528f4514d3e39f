"""What numba makes of a kernel, when that is first called.

The compiler calls back into Python, and an exception from there is lost: the function then counts as compiled, without
any code. So Ctrl-C waits for the next of the passes that a compilation consists of.
"""

from __future__ import annotations

import inspect
from collections.abc import Callable
from contextlib import ExitStack
from functools import partial
from typing import Any

import numba
from llvmlite.binding import ffi
from numba.core import event, types
from numba.core.compiler_lock import global_compiler_lock
from numba.core.errors import TypingError
from numba.core.imputils import lower_builtin
from numba.core.sigutils import normalize_signature
from numba.core.typing.templates import make_concrete_template, signature

import clothfit.kernels.records  # noqa: F401  so numba knows of them
from clothfit.base.interrupts import postponed
from clothfit.kernels import apart, helper
from clothfit.kernels.cache import KernelCache
from clothfit.kernels.linking import ForKernels, ForPython

FLAGS: dict[str, Any] = {"error_model": "numpy", "no_cfunc_wrapper": True}  # nothing calls by a C function pointer

for _pair in list(getattr(ffi.lib._lock, "_cblist", ())):  # numba notes each call of LLVM twice, a twelfth of the time
    ffi.unregister_lock_callback(*_pair)


def for_python(function: Callable[..., object], nogil: bool) -> Any:
    """numba's function for calls from Python."""
    made = compiled_lazily(function, "", pipeline_class=ForPython, nogil=nogil)
    made._compile_for_args = interruptible(made._compile_for_args)
    return made


def calling(own: Any) -> Callable[..., object]:
    """A function of the same name that does no more than call a kernel that is compiled `apart`."""
    function = own.py_func
    names, scope = ", ".join(inspect.signature(function).parameters), {"called": own, "__name__": function.__module__}
    exec(f"def {function.__name__}({names}): return called({names})", scope)
    made: Any = scope[function.__name__]
    made.__qualname__ = function.__qualname__
    return made  # type: ignore[no-any-return]


def for_kernels(function: Callable[..., object], result: object = ...) -> Any:
    """numba's function for calls from kernels: linked into them, or, where what it returns is said by an example,
    called through a pointer (`apart`).
    """
    if result is ...:
        made = compiled_lazily(function, "inner", pipeline_class=ForKernels, no_cpython_wrapper=True)
    else:
        made = compiled_lazily(function, "apart", pipeline_class=ForPython, no_cpython_wrapper=True)
        _replace(made, numba.typeof(result), partial(apart.call, function))
    made.get_call_template = _of_wide_types(made.get_call_template)
    return made


def for_kernels_of_part(function: Callable[..., object], result: object, absent: object, rows: bool) -> Any:
    """The same for a kernel of a part (`kernel.OfPart`): where that is not there, there is `absent` and no call."""
    kind = numba.typeof(absent)
    if result is not ... and numba.typeof(result) != kind:
        raise TypeError(f"{function.__name__} returns {numba.typeof(result)}, and {kind} without the part")

    def constant(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        return context.get_constant_generic(builder, kind, absent)

    def where_there_are_rows(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        return apart.call_with_rows(function, absent, context, builder, signature, arguments)

    made = for_kernels(function, result)
    if rows:
        _replace(made, kind, where_there_are_rows)
    _replace(made, kind, constant, lambda args: args[0] == types.none)
    return made


def for_kernels_of_kind(kernels: dict[type, Any]) -> Any:
    """The same for one that is several kernels (`kernel.OfKind`): calls are those of the one for this class."""
    made = numba.njit(next(iter(kernels.values())).py_func)

    def own(args: tuple[Any, ...]) -> Any:
        return kernels[args[0].instance_class].inner

    made.get_call_template = lambda args, kws: own(args).get_call_template(args, kws)
    made.get_overload = lambda args: own(args).get_overload(args)
    return made


def _replace(made: Any, kind: Any, write: Any, where: Callable[[Any], bool] = lambda args: True) -> None:
    """Let calls with some types of arguments be what `write` writes, of this type; nothing is compiled for them."""
    template, overload = made.get_call_template, made.get_overload

    def written(*arguments: Any) -> Any:
        return write(*arguments)

    def get_call_template(args: tuple[Any, ...], kws: dict[str, Any]) -> object:
        if not where(args):
            return template(args, kws)
        if kws or len(args) != len(inspect.signature(made.py_func).parameters):
            raise TypingError(f"{made.py_func.__name__} wants all its arguments, by their places")
        known = make_concrete_template(made.py_func.__name__, written, [signature(kind, *args)])
        return known, inspect.signature(made.py_func), args, kws

    lower_builtin(written, types.VarArg(types.Any))(written)
    made.get_call_template = get_call_template
    made.get_overload = lambda args: written if where(args) else overload(args)


def address(made: Any, kinds: tuple[Any, ...], result: object) -> int:
    """Where the machine code of such a function is for arguments of these types, compiled now where it is not yet.

    Raises TypeError where what it returns has not the type of `result`, which its callers count on.
    """
    interruptible(made.compile)(kinds)
    code = made.overloads[kinds]
    if code.signature.return_type != numba.typeof(result):
        raise TypeError(f"{made.py_func.__name__} returns {code.signature.return_type}, not {numba.typeof(result)}")
    found: int = code.library.get_pointer_to_function(code.fndesc.llvm_func_name)
    return found


def _of_wide_types(template: Callable[..., object]) -> Callable[..., object]:
    """The method by which numba finds, or compiles, what a kernel calls: the same code for flags and integers that are
    known and for those that are known later, and for short and long ones. Each would be compiled apart, with all that
    it calls in turn.
    """

    def wide(own: Any) -> Any:
        plain = types.unliteral(own) if isinstance(own, types.BooleanLiteral | types.IntegerLiteral) else own
        return types.int64 if plain == types.int32 else plain

    def of_wide_types(args: tuple[Any, ...], kws: dict[str, Any]) -> object:
        return template(tuple(map(wide, args)), {name: wide(own) for name, own in kws.items()})

    return of_wide_types


def compiled_lazily(function: Callable[..., object], variant: str, **flags: Any) -> Any:
    """numba's function, which compiles when it is called, and keeps what it has compiled."""
    compile_lazily: Any = numba.njit  # its types know neither of these flags
    made = compile_lazily(**FLAGS, **flags)(function)
    made._cache = KernelCache(function, variant)
    made._compilation_chain_init_hook = _no_extensions
    made.compile = _once(made, made.compile)
    return made


def _once(made: Any, compile_now: Callable[[Any], object]) -> Callable[[Any], object]:
    """The method by which numba compiles a function for a signature, in one process at a time."""

    def compile_once(signature: Any) -> object:
        with global_compiler_lock, ExitStack() as stack:
            waiting = event.trigger_event("numba:compile", data={"dispatcher": made, "args": (), "return_type": None})

            def poll() -> None:
                if not announced:
                    announced.append(stack.enter_context(waiting))
                with event.trigger_event("numba:run_pass", data={"name": "waiting"}):  # where Ctrl-C is heard
                    pass

            announced: list[object] = []
            if tuple(normalize_signature(signature)[0]) not in made.overloads:
                stack.enter_context(made._cache.alone(signature, made.targetctx.codegen(), poll))
                if not made._cache.linked and not made._cache.holds(signature, made.targetctx.codegen()):
                    stack.enter_context(helper.along(made.py_func, signature, not made._cache.variant))
            return compile_now(signature)

    return compile_once


def _no_extensions() -> None:
    """Look for no extensions of numba among all installed packages: no kernel has values of their types."""


def interruptible(compile_for_args: Callable[..., object]) -> Callable[..., object]:
    """The same function, which numba calls to compile or load, where Ctrl-C comes only at the start of a pass."""

    def compile_between_requests(*arguments: object, **keywords: object) -> object:
        with postponed() as poll, event.install_listener("numba:run_pass", _Passes(poll)):
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
