"""The lanes of compiled kernels: what numba makes of each function is written here as LLVM instructions.

Every function takes numba's typing context first and gives a signature and what writes the code; none of it runs
when a kernel does. Reference: the LLVM language manual, vector types, `llvm.fma`.
"""

from __future__ import annotations

import os
import platform
from collections.abc import Callable
from typing import Any

from llvmlite import ir
from numba.core import cgutils, types
from numba.extending import intrinsic, models, register_model

DOUBLE, INDEX = ir.DoubleType(), ir.IntType(32)
QUAD, PAIR = ir.VectorType(DOUBLE, 4), ir.VectorType(DOUBLE, 2)
SINGLES = ir.VectorType(ir.FloatType(), 4)
ALIGNED = 8  # bytes: the rows of NumPy's arrays promise no more
Code = tuple[Any, Callable[..., Any]]


class Lanes(types.Type):
    """numba's name for four float64 in a register."""

    def __init__(self) -> None:
        super().__init__(name="Lanes")


LANES = Lanes()


@register_model(Lanes)
class LanesModel(models.PrimitiveModel):
    """How numba keeps them: as one LLVM vector."""

    def __init__(self, manager: Any, kind: Any) -> None:
        super().__init__(manager, kind, QUAD)


def place(context: Any, builder: Any, kind: Any, array: Any, i: Any, j: Any, *, columns: int | None = None) -> Any:
    """Address of a[i, j] in an array (n, m) whose rows lie behind one another; `columns`, m where it is known, save a
    multiplication.
    """
    a = context.make_array(kind)(context, builder, array)
    m = cgutils.unpack_tuple(builder, a.shape)[1] if columns is None else i.type(columns)
    return builder.gep(a.data, [builder.add(builder.mul(i, m), j)])


def read(builder: Any, address: Any, kind: Any) -> Any:
    return builder.load(builder.bitcast(address, kind.as_pointer()), align=ALIGNED)


def write(builder: Any, value: Any, address: Any) -> None:
    builder.store(value, builder.bitcast(address, value.type.as_pointer()), align=ALIGNED)


def shuffled(builder: Any, a: Any, b: Any, lanes: list[int]) -> Any:
    """The named lanes of a (0 …) and, behind them, b."""
    return builder.shuffle_vector(a, b, ir.Constant(ir.VectorType(INDEX, len(lanes)), lanes))


def undefined(kind: Any) -> Any:
    return ir.Constant(kind, ir.Undefined)


def is_single(kind: Any) -> bool:
    """Whether an array's numbers are of single precision."""
    return bool(kind.dtype == types.float32)


def loads(columns: int | None = None, whole: bool = False) -> Any:
    """A function that reads a[i, j …], where `whole` a[i], of an array with so many columns where they are given."""

    def read_lanes(context: Any, builder: Any, kind: Any, values: Any) -> Any:
        address = place(context, builder, kind, *values, columns=columns)
        if is_single(kind):
            singles = builder.load(builder.bitcast(address, SINGLES.as_pointer()), align=ALIGNED // 2)
            return builder.fpext(singles, QUAD)
        return read(builder, address, QUAD)

    @intrinsic
    def load(_context: Any, a: Any, i: Any, j: Any) -> Code:
        def code(context: Any, builder: Any, signature: Any, values: Any) -> Any:
            return read_lanes(context, builder, signature.args[0], values)

        return LANES(a, types.intp, types.intp), code

    @intrinsic
    def load_row(_context: Any, a: Any, i: Any) -> Code:
        def code(context: Any, builder: Any, signature: Any, values: Any) -> Any:
            return read_lanes(context, builder, signature.args[0], [*values, values[1].type(0)])

        return LANES(a, types.intp), code

    return load_row if whole else load


def stores(columns: int | None = None, whole: bool = False) -> Any:
    """A function that writes a[i, j …], where `whole` a[i]."""

    def write_lanes(context: Any, builder: Any, kind: Any, v: Any, values: Any) -> Any:
        address = place(context, builder, kind, *values, columns=columns)
        if is_single(kind):
            singles = builder.fptrunc(v, SINGLES)
            builder.store(singles, builder.bitcast(address, SINGLES.as_pointer()), align=ALIGNED // 2)
        else:
            write(builder, v, address)
        return context.get_dummy_value()

    @intrinsic
    def store(_context: Any, v: Any, a: Any, i: Any, j: Any) -> Code:
        def code(context: Any, builder: Any, signature: Any, values: Any) -> Any:
            return write_lanes(context, builder, signature.args[1], values[0], values[1:])

        return types.void(LANES, a, types.intp, types.intp), code

    @intrinsic
    def store_row(_context: Any, v: Any, a: Any, i: Any) -> Code:
        def code(context: Any, builder: Any, signature: Any, values: Any) -> Any:
            return write_lanes(context, builder, signature.args[1], values[0], [*values[1:], values[2].type(0)])

        return types.void(LANES, a, types.intp), code

    return store_row if whole else store


load, load4, column = loads(), loads(4, whole=True), loads(8)
store, store4, store_column = stores(), stores(4, whole=True), stores(8)


@intrinsic
def load3(_context: Any, a: Any, i: Any) -> Code:
    def code(context: Any, builder: Any, signature: Any, values: Any) -> Any:
        array, i = values
        start = place(context, builder, signature.args[0], array, i, ir.Constant(i.type, 0))
        low = read(builder, start, PAIR)
        last = read(builder, builder.gep(start, [INDEX(2)]), DOUBLE)
        high = builder.insert_element(ir.Constant(PAIR, [0.0, 0.0]), last, INDEX(0))
        return shuffled(builder, low, high, [0, 1, 2, 3])

    return LANES(a, types.intp), code


@intrinsic
def store3(_context: Any, v: Any, a: Any, i: Any) -> Code:
    def code(context: Any, builder: Any, signature: Any, values: Any) -> Any:
        v, array, i = values
        start = place(context, builder, signature.args[1], array, i, ir.Constant(i.type, 0))
        write(builder, shuffled(builder, v, undefined(QUAD), [0, 1]), start)
        write(builder, builder.extract_element(v, INDEX(2)), builder.gep(start, [INDEX(2)]))
        return context.get_dummy_value()

    return types.void(LANES, a, types.intp), code


@intrinsic
def splat(_context: Any, x: Any) -> Code:
    def code(_target: Any, builder: Any, _signature: Any, values: Any) -> Any:
        one = builder.insert_element(undefined(QUAD), values[0], INDEX(0))
        return shuffled(builder, one, undefined(QUAD), [0, 0, 0, 0])

    return LANES(types.float64), code


@intrinsic
def pack(_context: Any, x: Any, y: Any, z: Any, w: Any) -> Code:
    def code(_target: Any, builder: Any, _signature: Any, values: Any) -> Any:
        v = undefined(QUAD)
        for lane, value in enumerate(values):
            v = builder.insert_element(v, value, INDEX(lane))
        return v

    return LANES(*[types.float64] * 4), code


def reordered(lanes: list[int]) -> Any:
    """A function of the named lanes of its argument."""

    @intrinsic
    def take(_context: Any, v: Any) -> Code:
        return LANES(LANES), lambda _t, builder, _s, values: shuffled(builder, values[0], undefined(QUAD), lanes)

    return take


spread0, spread1, spread2 = (reordered([lane] * 4) for lane in range(3))
turn = reordered([1, 2, 0, 3])
xyzz, xxxy, zyyz, zxyy = (reordered(["xyz".index(c) for c in lanes]) for lanes in ("xyzz", "xxxy", "zyyz", "zxyy"))


def extracted(lane: int) -> Any:
    """A function of one lane of its argument."""

    @intrinsic
    def take(_context: Any, v: Any) -> Code:
        return types.float64(LANES), lambda _t, builder, _s, values: builder.extract_element(values[0], INDEX(lane))

    return take


lane0, lane1, lane2 = (extracted(lane) for lane in range(3))


def combined(operation: str) -> Any:
    """A function that does one instruction lane by lane."""

    @intrinsic
    def apply(_context: Any, a: Any, b: Any) -> Code:
        return LANES(LANES, LANES), lambda _t, builder, _s, values: getattr(builder, operation)(*values)

    return apply


add, sub, mul, div = (combined(operation) for operation in ("fadd", "fsub", "fmul", "fdiv"))


@intrinsic
def root(_context: Any, a: Any) -> Code:
    def code(_context: Any, builder: Any, _signature: Any, values: Any) -> Any:
        kind = ir.FunctionType(QUAD, [QUAD])
        return builder.call(cgutils.get_or_insert_function(builder.module, kind, "llvm.sqrt.v4f64"), values)

    return LANES(LANES), code


@intrinsic
def where_less(_context: Any, a: Any, b: Any, p: Any, q: Any) -> Code:
    def code(_context: Any, builder: Any, _signature: Any, values: Any) -> Any:
        a, b, p, q = values
        return builder.select(builder.fcmp_ordered("<", a, b), p, q)

    return LANES(LANES, LANES, LANES, LANES), code


@intrinsic
def fma(_context: Any, a: Any, b: Any, c: Any) -> Code:
    def code(_target: Any, builder: Any, _signature: Any, values: Any) -> Any:
        name = "llvm.fma.v4f64"
        called = cgutils.get_or_insert_function(builder.module, ir.FunctionType(QUAD, [QUAD] * 3), name)
        return builder.call(called, values)

    return LANES(LANES, LANES, LANES), code


def summed(count: int) -> Any:
    """A function that adds so many lanes of its argument, from the first on."""

    @intrinsic
    def take(_context: Any, v: Any) -> Code:
        def code(_context: Any, builder: Any, _signature: Any, values: Any) -> Any:
            first, *others = (builder.extract_element(values[0], INDEX(lane)) for lane in range(count))
            for other in others:
                first = builder.fadd(first, other)
            return first

        return types.float64(LANES), code

    return take


sum3, sum4 = summed(3), summed(4)


@intrinsic
def clear3(_context: Any, v: Any) -> Code:
    def code(_target: Any, builder: Any, _signature: Any, values: Any) -> Any:
        return shuffled(builder, values[0], ir.Constant(QUAD, [0.0] * 4), [0, 1, 2, 7])

    return LANES(LANES), code


@intrinsic
def index(_context: Any, a: Any, i: Any) -> Code:
    def code(context: Any, builder: Any, signature: Any, values: Any) -> Any:
        array, i = values
        start = context.make_array(signature.args[0])(context, builder, array).data
        return builder.sext(builder.load(builder.gep(start, [i])), i.type)

    return types.intp(a, types.intp), code


@intrinsic
def prefetch(_context: Any, a: Any, i: Any) -> Code:
    def code(context: Any, builder: Any, signature: Any, values: Any) -> Any:
        address = place(context, builder, signature.args[0], values[0], values[1], values[1].type(0), columns=8)
        byte = ir.IntType(8).as_pointer()
        kind = ir.FunctionType(ir.VoidType(), [byte, INDEX, INDEX, INDEX])
        called = cgutils.get_or_insert_function(builder.module, kind, "llvm.prefetch.p0")
        to_write, near, data = INDEX(1), INDEX(3), INDEX(1)
        builder.call(called, [builder.bitcast(address, byte), to_write, near, data])
        return context.get_dummy_value()

    return types.void(a, types.intp), code


@intrinsic
def read_shared(_context: Any, a: Any, i: Any) -> Code:
    def code(context: Any, builder: Any, signature: Any, values: Any) -> Any:
        array, i = values
        start = context.make_array(signature.args[0])(context, builder, array).data
        return builder.load_atomic(builder.gep(start, [i]), "acquire", ALIGNED)

    return types.int64(a, types.intp), code


@intrinsic
def write_shared(_context: Any, a: Any, i: Any, value: Any) -> Code:
    def code(context: Any, builder: Any, signature: Any, values: Any) -> Any:
        array, i, value = values
        start = context.make_array(signature.args[0])(context, builder, array).data
        builder.store_atomic(value, builder.gep(start, [i]), "release", ALIGNED)
        return context.get_dummy_value()

    return types.void(a, types.intp, types.int64), code


@intrinsic
def exchange(_context: Any, a: Any, i: Any, expected: Any, value: Any) -> Code:
    def code(context: Any, builder: Any, signature: Any, values: Any) -> Any:
        array, i, expected, value = values
        start = context.make_array(signature.args[0])(context, builder, array).data
        found = builder.cmpxchg(builder.gep(start, [i]), expected, value, "acq_rel", "acquire")
        return builder.extract_value(found, 1)

    return types.boolean(a, types.intp, types.int64, types.int64), code


@intrinsic
def pause(_context: Any, long: Any) -> Code:
    def code(context: Any, builder: Any, _signature: Any, values: Any) -> Any:
        with builder.if_then(values[0]):
            if hasattr(os, "sched_yield"):  # a function of the C library that the process has anyway
                kind = ir.FunctionType(INDEX, [])
                builder.call(cgutils.get_or_insert_function(builder.module, kind, "sched_yield"), [])
        if platform.machine() in ("x86_64", "AMD64"):  # spins without keeping the core's other thread from its work
            kind = ir.FunctionType(ir.VoidType(), [])
            builder.call(cgutils.get_or_insert_function(builder.module, kind, "llvm.x86.sse2.pause"), [])
        return context.get_dummy_value()

    return types.void(types.boolean), code
