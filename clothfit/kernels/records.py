"""Records: NamedTuples of many arrays that kernels pass to each other as a pointer.

numba passes a tuple as its parts, an array being seven of them: a System is some three hundred arguments, which every
call takes apart and every function puts together again. Most of the code of a simulation, before it is optimised, was
that. A class with the mark `kernel.record` is one pointer instead, to memory where the function that Python calls
writes the parts; a kernel reads from there what it uses. A record within a record lies in the same memory.

No kernel makes or changes a record, and the arrays in one live as long as the call: no references are counted.
"""

from __future__ import annotations

from typing import Any

from llvmlite import ir
from numba.core import types
from numba.core.datamodel.models import DataModel
from numba.core.datamodel.registry import register_default
from numba.core.extending import NativeValue, typeof_impl, unbox
from numba.core.imputils import impl_ret_borrowed, lower_builtin, lower_getattr_generic

from clothfit.kernels import unboxing
from clothfit.kernels.unboxing import ALIGNED, RecordType, layout

POINTER = ir.IntType(8).as_pointer()


@register_default(RecordType)
class RecordModel(DataModel):
    """A pointer, whatever it is needed for."""

    def get_value_type(self) -> ir.Type:
        """Its type in LLVM."""
        return POINTER

    def _same(self, builder: Any, value: Any) -> Any:
        return value

    as_data = as_argument = as_return = from_data = from_return = _same

    def from_argument(self, builder: Any, value: Any) -> Any:
        """The pointer that a function got. Nothing else writes there meanwhile: what LLVM has read it may keep."""
        value.add_attribute("noalias")
        return value


def _place(context: Any, builder: Any, kind: RecordType, pointer: Any, index: int) -> Any:
    """A pointer to a field of a record."""
    begin = ir.Constant(ir.IntType(64), layout(context, kind)[0][index])
    place, inner = builder.gep(pointer, [begin], inbounds=True), kind.types[index]
    if isinstance(inner, RecordType):
        return place
    return builder.bitcast(place, context.get_value_type(inner).as_pointer())


def _field(context: Any, builder: Any, kind: RecordType, pointer: Any, index: int) -> Any:
    place, inner = _place(context, builder, kind, pointer, index), kind.types[index]
    if isinstance(inner, RecordType):
        return place
    return impl_ret_borrowed(context, builder, inner, builder.load(place))


@lower_getattr_generic(RecordType)
def _by_name(context: Any, builder: Any, kind: RecordType, pointer: Any, name: str) -> Any:
    return _field(context, builder, kind, pointer, kind.fields.index(name))


@lower_builtin("static_getitem", RecordType, types.IntegerLiteral)
def _by_number(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
    kind, place = signature.args
    return _field(context, builder, kind, arguments[0], place.literal_value)


@unbox(RecordType)
def _from_python(kind: RecordType, value: Any, c: Any) -> NativeValue:
    """Memory on the stack of the function that Python calls, with the parts of a record."""
    with c.builder.goto_entry_block():  # numba's own way would fill it with zeros, byte by byte
        memory = c.builder.alloca(ir.ArrayType(ir.IntType(8), layout(c.context, kind)[1]))
    memory.align = ALIGNED
    pointer = c.builder.bitcast(memory, POINTER)
    return NativeValue(pointer, is_error=unboxing.call(c, kind, value, pointer))


@typeof_impl.register(tuple)
def _typeof(value: Any, purpose: Any) -> Any:
    """The type of a tuple: numba's own, but for records."""
    kinds = tuple(typeof_impl(each, purpose) for each in value)
    if None in kinds:
        return None
    record = getattr(type(value), "goes_as_pointer", False)
    return RecordType(kinds, type(value)) if record else types.BaseTuple.from_types(kinds, type(value))
