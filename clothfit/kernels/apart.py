"""Kernels that are compiled by themselves and called through a pointer, when they are called for the first time.

By default the code of a kernel is linked into that of every entry that calls it, and optimised there anew. A kernel
marked `apart` is an entry itself: compiled once for its types of arguments, and kept on disk as such. Its callers hold
only a slot for its address, empty at first, and what to ask for: so an entry neither waits for code that it does not
come to, nor is compiled again when that changes. What the kernel returns has to be known before it is compiled, so the
mark gives an example of it.
"""

from __future__ import annotations

import ctypes
import importlib
import pickle
import zlib
from typing import Any

from llvmlite import binding, ir
from numba.core import cgutils

from clothfit.base.errors import NotCompiled
from clothfit.kernels import helper

SYMBOL = "clothfit_address_of"
"""What compiled code calls for an address."""

BYTE, LONG = ir.IntType(8), ir.IntType(64)


def _address(place: int, length: int) -> int | None:
    """The address of the code of a kernel, compiled now where it is not yet; None where that failed."""
    try:
        module, name, kinds = pickle.loads(zlib.decompress(ctypes.string_at(place, length)))
        made: int = getattr(importlib.import_module(module), name).address(kinds)
    except BaseException as error:  # noqa: BLE001  raised where Python called the code that asks
        NotCompiled.reasons.append(error)
        return None
    return made


_kept = ctypes.CFUNCTYPE(ctypes.c_void_p, ctypes.c_void_p, ctypes.c_int64)(_address)
binding.add_symbol(SYMBOL, ctypes.cast(_kept, ctypes.c_void_p).value)


def call(function: Any, context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
    """Write the call of a kernel."""
    kept, kinds = context.call_conv, signature.args
    if helper.tell:
        helper.tell(function, kinds)
    what = zlib.compress(pickle.dumps((function.__module__, function.__qualname__, kinds)))
    slot = cgutils.add_global_variable(builder.module, BYTE.as_pointer(), f".apart.{function.__qualname__}")
    slot.initializer, slot.linkage = slot.value_type(None), "internal"
    wanted = cgutils.global_constant(builder.module, f".apart.{function.__qualname__}", cgutils.make_bytearray(what))
    asked = cgutils.get_or_insert_function(
        builder.module, ir.FunctionType(BYTE.as_pointer(), [BYTE.as_pointer(), LONG]), SYMBOL
    )
    with cgutils.if_unlikely(builder, cgutils.is_null(builder, builder.load(slot))):
        found = builder.call(asked, [builder.bitcast(wanted, BYTE.as_pointer()), LONG(len(what))])
        with cgutils.if_unlikely(builder, cgutils.is_null(builder, found)):
            kept.return_user_exc(builder, NotCompiled)
        builder.store(found, slot)
    pointer = kept.get_function_type(signature.return_type, kinds).as_pointer()
    code = builder.bitcast(builder.load(slot), pointer)
    status, result = kept.call_function(builder, code, signature.return_type, kinds, arguments)
    with cgutils.if_unlikely(builder, status.is_error):
        kept.return_status_propagate(builder, status)
    return result


def call_with_rows(function: Any, absent: object, context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
    """Write the call of a kernel if the first array of its first argument, a tuple, has rows; else the result is
    `absent`.
    """
    first = signature.args[0].types[0]
    own = context.make_array(first)(context, builder, builder.extract_value(arguments[0], 0))
    there = cgutils.is_not_null(builder, cgutils.unpack_tuple(builder, own.shape)[0])
    result = cgutils.alloca_once_value(builder, context.get_constant_generic(builder, signature.return_type, absent))
    with builder.if_then(there), helper.without_requests():
        builder.store(call(function, context, builder, signature, arguments), result)
    return builder.load(result)
