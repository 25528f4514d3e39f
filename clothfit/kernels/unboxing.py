"""Where the parts of a record (`records`) lie in its memory, and how they come there: by one function for all entries.

numba writes code for each array that an entry gets, some thirty instructions; for a record of a hundred arrays that is
more than the entry itself. Here an entry holds a list of instructions instead, each five numbers, and one function,
made anew in each process, follows them. Arrays get no counter of references: those in a record live as long as the
call.
"""

from __future__ import annotations

import hashlib
from collections.abc import Iterator
from functools import cache
from typing import Any

from llvmlite import binding, ir
from numba.core import cgutils, types

END, ENTER, LEAVE, ARRAY, FLOAT, INTEGER, FLAG = range(7)
"""What an instruction is of: its second number is the place in the tuple entered last, its third one that in memory; of
an array follow the number of axes and the bytes of an item.
"""

SIZE = 5
"""Numbers of an instruction."""

DEPTH = 8
"""Tuples within each other, at most."""

NAME = "clothfit_unbox"

ALIGNED = 16
"""Bytes that the place of a part of a record is a multiple of."""

BYTE, INT, LONG, DOUBLE = ir.IntType(8), ir.IntType(32), ir.IntType(64), ir.DoubleType()
POINTER = BYTE.as_pointer()
SIGNATURE = ir.FunctionType(ir.IntType(1), [POINTER, POINTER, INT.as_pointer()])
HEAD = object.__basicsize__
"""Bytes of what every Python object begins with; an array goes on with the address of its data, the number of its axes,
the addresses of its lengths and of its strides (NumPy's PyArrayObject).
"""

SCALARS = {types.float64: FLOAT, types.int64: INTEGER, types.boolean: FLAG}


class RecordType(types.NamedTuple):
    """The type of a record, with those of its fields."""

    def __init__(self, kinds: tuple[Any, ...], own: type) -> None:
        super().__init__(kinds, own)
        # short, as the names of all functions are made of those of their arguments
        self.name = f"{own.__name__}~{hashlib.sha256(self.name.encode()).hexdigest()[:12]}"


@cache
def layout(context: Any, kind: RecordType) -> tuple[list[int], int]:
    """Where each field of a record begins, and how long it is as a whole, in bytes."""
    begins, end = [], 0
    for each in kind.types:
        begins.append(end)
        if isinstance(each, RecordType):
            size = layout(context, each)[1]
        else:
            size = context.get_abi_sizeof(context.get_value_type(each))
        end += -(-size // ALIGNED) * ALIGNED
    return begins, end


def instructions(
    context: Any, kind: Any, begins: list[int], at: int = 0, depth: int = 1
) -> Iterator[tuple[int, ...]]:
    """The instructions for the parts of a tuple type, which begin in memory so far behind `at`.

    Raises TypeError for parts of other types, and for more than DEPTH tuples within each other.
    """
    if depth > DEPTH:
        raise TypeError(f"more than {DEPTH} tuples within each other: {kind}")
    for place, (part, begin) in enumerate(zip(kind.types, begins, strict=True)):
        if isinstance(part, types.Array):
            size = context.get_abi_sizeof(context.get_data_type(part.dtype))
            yield ARRAY, place, at + begin, part.ndim, size
        elif isinstance(part, types.BaseTuple):
            yield ENTER, place, 0, 0, 0
            yield from instructions(context, part, places(context, part), at + begin, depth + 1)
            yield LEAVE, 0, 0, 0, 0
        elif part != types.none:
            if part not in SCALARS:
                raise TypeError(f"part {place} of {kind}: a record holds no {part}")
            yield SCALARS[part], place, at + begin, 0, 0


def places(context: Any, kind: Any) -> list[int]:
    """Where in memory the parts of a tuple type begin, in bytes."""
    if isinstance(kind, RecordType):
        return layout(context, kind)[0]
    value = context.get_value_type(kind)
    if isinstance(value, ir.ArrayType):
        return [place * context.get_abi_sizeof(value.element) for place in range(value.count)]
    return [value.get_element_offset(context.target_data, place) for place in range(len(kind.types))]


def call(c: Any, kind: Any, value: Any, memory: Any) -> Any:
    """Write the call that fills the memory of a record from a Python object; returns whether it failed."""
    listed = [*instructions(c.context, kind, places(c.context, kind)), (END, 0, 0, 0, 0)]
    numbers = ir.Constant(ir.ArrayType(INT, SIZE * len(listed)), [each for row in listed for each in row])
    program = c.builder.bitcast(cgutils.global_constant(c.builder.module, ".record", numbers), INT.as_pointer())
    function = cgutils.get_or_insert_function(c.builder.module, SIGNATURE, NAME)
    return c.builder.call(function, [c.builder.bitcast(value, POINTER), memory, program])


def _made() -> Any:
    """What keeps the machine code of the function that follows instructions, and its name is known by."""
    module = ir.Module(NAME)
    _write(ir.Function(module, SIGNATURE, NAME))
    binding.initialize_native_target()
    binding.initialize_native_asmprinter()
    target = binding.Target.from_default_triple().create_target_machine(opt=0, jit=True)
    engine = binding.create_mcjit_compiler(binding.parse_assembly(str(module)), target)
    binding.add_symbol(NAME, engine.get_function_address(NAME))
    return engine


def _write(function: ir.Function) -> None:
    builder = ir.IRBuilder(function.append_basic_block("entry"))
    value, memory, program = function.args
    outer = cgutils.alloca_once(builder, ir.ArrayType(POINTER, DEPTH))
    depth, at = cgutils.alloca_once_value(builder, LONG(0)), cgutils.alloca_once_value(builder, LONG(0))

    def entered() -> Any:
        return builder.gep(outer, [LONG(0), builder.load(depth)])

    def python(name: str, result: ir.Type, *kinds: ir.Type) -> Any:
        return cgutils.get_or_insert_function(function.module, ir.FunctionType(result, kinds), name)

    builder.store(value, entered())
    loop = function.append_basic_block("loop")
    builder.branch(loop)
    builder.position_at_end(loop)
    numbers = [builder.load(builder.gep(program, [builder.add(builder.load(at), LONG(k))])) for k in range(SIZE)]
    builder.store(builder.add(builder.load(at), LONG(SIZE)), at)
    place = builder.gep(memory, [builder.sext(numbers[2], LONG)])
    cases = [function.append_basic_block(f"case{k}") for k in range(7)]
    choice = builder.switch(numbers[0], cases[END])
    for k in range(1, 7):
        choice.add_case(INT(k), cases[k])

    def part() -> Any:
        get = python("PyTuple_GetItem", POINTER, POINTER, LONG)
        return builder.call(get, [builder.load(entered()), builder.sext(numbers[1], LONG)])

    def put(result: Any, where: Any, behind: int = 0) -> None:
        to = builder.gep(where, [LONG(behind)])
        builder.store(result, builder.bitcast(to, result.type.as_pointer()))

    def get(own: Any, behind: int, kind: ir.Type) -> Any:
        return builder.load(builder.bitcast(builder.gep(own, [LONG(HEAD + behind)]), kind.as_pointer()))

    builder.position_at_end(cases[END])
    builder.ret(cgutils.is_not_null(builder, builder.call(python("PyErr_Occurred", POINTER), [])))
    builder.position_at_end(cases[ENTER])
    inner = part()
    builder.store(builder.add(builder.load(depth), LONG(1)), depth)
    builder.store(inner, entered())
    builder.branch(loop)
    builder.position_at_end(cases[LEAVE])
    builder.store(builder.sub(builder.load(depth), LONG(1)), depth)
    builder.branch(loop)
    builder.position_at_end(cases[FLOAT])
    put(builder.call(python("PyFloat_AsDouble", DOUBLE, POINTER), [part()]), place)
    builder.branch(loop)
    builder.position_at_end(cases[INTEGER])
    put(builder.call(python("PyLong_AsLongLong", LONG, POINTER), [part()]), place)
    builder.branch(loop)
    builder.position_at_end(cases[FLAG])
    put(builder.trunc(builder.call(python("PyObject_IsTrue", INT, POINTER), [part()]), BYTE), place)
    builder.branch(loop)
    builder.position_at_end(cases[ARRAY])
    array, axes = part(), builder.sext(numbers[3], LONG)
    count = cgutils.alloca_once_value(builder, LONG(1))
    put(POINTER(None), place)  # no counter
    put(array, place, 8)
    put(builder.sext(numbers[4], LONG), place, 24)
    put(get(array, 0, POINTER), place, 32)
    builder.store(LONG(1), count)
    lengths, strides = get(array, 16, LONG.as_pointer()), get(array, 24, LONG.as_pointer())
    shape = builder.bitcast(builder.gep(place, [LONG(40)]), LONG.as_pointer())
    with cgutils.for_range(builder, axes) as axis:
        length = builder.load(builder.gep(lengths, [axis.index]))
        builder.store(builder.mul(builder.load(count), length), count)
        builder.store(length, builder.gep(shape, [axis.index]))
        stride = builder.load(builder.gep(strides, [axis.index]))
        builder.store(stride, builder.gep(shape, [builder.add(axes, axis.index)]))
    put(builder.load(count), place, 16)
    builder.branch(loop)


_kept = _made()
