"""The lanes of compiled kernels: what numba makes of each function is written here as LLVM instructions. First four of
double precision, then of single precision four, eight or sixteen: a half, a whole and two registers of AVX2.

None of what stands here runs when a kernel does. Reference: the LLVM language manual, vector types, `llvm.fma`.
"""

from __future__ import annotations

import inspect
import os
import platform
from collections.abc import Callable
from typing import Any, NamedTuple

from llvmlite import ir
from numba.core import cgutils, types
from numba.extending import intrinsic, models, register_model

DOUBLE, SINGLE, INDEX = ir.DoubleType(), ir.FloatType(), ir.IntType(32)
QUAD, PAIR = ir.VectorType(DOUBLE, 4), ir.VectorType(DOUBLE, 2)
ALIGNED = 8  # bytes: the rows of NumPy's arrays promise no more


class Lanes(types.Type):
    """numba's name for so many numbers in registers."""

    def __init__(self, name: str, vector: Any) -> None:
        super().__init__(name=name)
        self.vector = vector


@register_model(Lanes)
class LanesModel(models.PrimitiveModel):
    """How numba keeps them: as one LLVM vector."""

    def __init__(self, manager: Any, kind: Any) -> None:
        super().__init__(manager, kind, kind.vector)


LANES = Lanes("Lanes", QUAD)


class At(NamedTuple):
    """Where code is written: numba's context, LLVM's builder, and the types of the arguments."""

    context: Any
    builder: Any
    kinds: Any


def written(result: Any, *kinds: Any) -> Callable[[Callable[..., Any]], Any]:
    """A decorator that makes numba's function of arguments of these types, None for that of an array, from one that
    writes its code and returns LLVM's value of the result: of an `At` and LLVM's values of the arguments.
    """
    names = [inspect.Parameter(f"_{k}", inspect.Parameter.POSITIONAL_ONLY) for k in range(len(kinds) + 1)]

    def of(write: Callable[..., Any]) -> Any:
        def typed(_context: Any, *own: Any) -> Any:
            def code(context: Any, builder: Any, signature: Any, values: Any) -> Any:
                made = write(At(context, builder, signature.args), *values)
                return context.get_dummy_value() if made is None else made

            return result(*(kind or each for kind, each in zip(kinds, own, strict=True))), code

        made: Any = typed
        made.__signature__ = inspect.Signature(names)  # numba would pack arguments behind a star into a tuple
        return intrinsic(made)

    return of


def place(at: At, kind: Any, array: Any, i: Any, j: Any, columns: int | None = None) -> Any:
    """Address of a[i, j] in an array (n, m) whose rows lie behind one another; `columns`, m where it is known, save a
    multiplication.
    """
    a = at.context.make_array(kind)(at.context, at.builder, array)
    m = cgutils.unpack_tuple(at.builder, a.shape)[1] if columns is None else i.type(columns)
    return at.builder.gep(a.data, [at.builder.add(at.builder.mul(i, m), j)])


def element(at: At, array: Any, i: Any, argument: int = 0) -> Any:
    """Address of a[i] of this argument."""
    return at.builder.gep(at.context.make_array(at.kinds[argument])(at.context, at.builder, array).data, [i])


def read(builder: Any, address: Any, kind: Any, align: int = ALIGNED) -> Any:
    return builder.load(builder.bitcast(address, kind.as_pointer()), align=align)


def write(builder: Any, value: Any, address: Any, align: int = ALIGNED) -> None:
    builder.store(value, builder.bitcast(address, value.type.as_pointer()), align=align)


def shuffled(builder: Any, a: Any, b: Any, lanes: list[int]) -> Any:
    """The named lanes of a (0 …) and, behind them, b."""
    return builder.shuffle_vector(a, b, ir.Constant(ir.VectorType(INDEX, len(lanes)), lanes))


def everywhere(builder: Any, value: Any, vector: Any) -> Any:
    """A number in all lanes."""
    one = builder.insert_element(undefined(vector), value, INDEX(0))
    return shuffled(builder, one, undefined(vector), [0] * vector.count)


def undefined(kind: Any) -> Any:
    return ir.Constant(kind, ir.Undefined)


def called(builder: Any, name: str, result: Any, *values: Any) -> Any:
    """What a function of LLVM's, or of the C library, returns."""
    kind = ir.FunctionType(result, [value.type for value in values])
    return builder.call(cgutils.get_or_insert_function(builder.module, kind, name), values)


def kept_of(kind: Any, lanes: Lanes) -> tuple[Any, int]:
    """The vector that an array of this type keeps of lanes, which may be rounded, and the bytes it is aligned to."""
    single = kind.dtype == types.float32
    return (ir.VectorType(SINGLE, lanes.vector.count), ALIGNED // 2) if single else (lanes.vector, ALIGNED)


def loads(columns: int | None = None, whole: bool = False, lanes: Lanes = LANES) -> Any:
    """A function that reads a[i, j …], where `whole` a[i], of an array with so many columns where they are given."""

    def load(at: At, array: Any, i: Any, *j: Any) -> Any:
        kept, aligned = kept_of(at.kinds[0], lanes)
        address = place(at, at.kinds[0], array, i, j[0] if j else i.type(0), columns)
        value = read(at.builder, address, kept, aligned)
        return value if kept == lanes.vector else at.builder.fpext(value, lanes.vector)

    return written(lanes, None, types.intp, *[types.intp] * (not whole))(load)


def stores(columns: int | None = None, whole: bool = False, lanes: Lanes = LANES) -> Any:
    """A function that writes a[i, j …], where `whole` a[i]."""

    def store(at: At, v: Any, array: Any, i: Any, *j: Any) -> None:
        kept, aligned = kept_of(at.kinds[1], lanes)
        address = place(at, at.kinds[1], array, i, j[0] if j else i.type(0), columns)
        write(at.builder, v if kept == lanes.vector else at.builder.fptrunc(v, kept), address, aligned)

    return written(types.void, lanes, None, types.intp, *[types.intp] * (not whole))(store)


load, load4, column = loads(), loads(4, whole=True), loads(8)


@written(LANES, None, types.intp)
def quad(at: At, array: Any, i: Any) -> Any:
    return read(at.builder, element(at, array, i), QUAD)


@written(types.void, LANES, None, types.intp)
def store_quad(at: At, v: Any, array: Any, i: Any) -> None:
    write(at.builder, v, element(at, array, i, 1))


store, store4, store_column = stores(), stores(4, whole=True), stores(8)


@written(LANES, None, types.intp)
def load3(at: At, array: Any, i: Any) -> Any:
    start = place(at, at.kinds[0], array, i, i.type(0))
    low = read(at.builder, start, PAIR)
    last = read(at.builder, at.builder.gep(start, [INDEX(2)]), DOUBLE)
    high = at.builder.insert_element(ir.Constant(PAIR, [0.0, 0.0]), last, INDEX(0))
    return shuffled(at.builder, low, high, [0, 1, 2, 3])


@written(types.void, LANES, None, types.intp)
def store3(at: At, v: Any, array: Any, i: Any) -> None:
    start = place(at, at.kinds[1], array, i, i.type(0))
    write(at.builder, shuffled(at.builder, v, undefined(QUAD), [0, 1]), start)
    write(at.builder, at.builder.extract_element(v, INDEX(2)), at.builder.gep(start, [INDEX(2)]))


@written(LANES, types.float64)
def splat(at: At, x: Any) -> Any:
    return everywhere(at.builder, x, QUAD)


@written(LANES, None, types.intp, types.intp)
def spread4(at: At, array: Any, i: Any, j: Any) -> Any:
    return everywhere(at.builder, read(at.builder, place(at, at.kinds[0], array, i, j, 4), DOUBLE), QUAD)


@written(LANES, *[types.float64] * 4)
def pack(at: At, *values: Any) -> Any:
    v = undefined(QUAD)
    for lane, value in enumerate(values):
        v = at.builder.insert_element(v, value, INDEX(lane))
    return v


def reordered(named: list[int], lanes: Lanes = LANES) -> Any:
    """A function of the named lanes of its four; 4 is a zero."""

    @written(lanes, lanes)
    def take(at: At, v: Any) -> Any:
        zeros = ir.Constant(lanes.vector, [0.0] * 4) if 4 in named else undefined(lanes.vector)
        return shuffled(at.builder, v, zeros, named)

    return take


spread0, spread1, spread2 = (reordered([lane] * 4) for lane in range(3))
turn, clear3 = reordered([1, 2, 0, 3]), reordered([0, 1, 2, 4])
xyzz, xxxy, zyyz, zxyy = (reordered(["xyz".index(c) for c in lanes]) for lanes in ("xyzz", "xxxy", "zyyz", "zxyy"))


def across(lane: int) -> Any:
    """A function that takes the same lane of each of its four arguments; of four such functions LLVM makes what two
    rounds of shuffles take, as both halves begin alike.
    """

    @written(LANES, *[LANES] * 4)
    def take(at: At, a: Any, b: Any, c: Any, d: Any) -> Any:
        half = [lane % 2, 4 + lane % 2, 2 + lane % 2, 6 + lane % 2]
        low, high = shuffled(at.builder, a, b, half), shuffled(at.builder, c, d, half)
        return shuffled(at.builder, low, high, [0, 1, 4, 5] if lane < 2 else [2, 3, 6, 7])

    return take


across0, across1, across2, across3 = (across(lane) for lane in range(4))


def summed(first: int, *others: int) -> Any:
    """A function that adds the named lanes of its argument, in their order."""

    @written(types.float64, LANES)
    def take(at: At, v: Any) -> Any:
        total = at.builder.extract_element(v, INDEX(first))
        for lane in others:
            total = at.builder.fadd(total, at.builder.extract_element(v, INDEX(lane)))
        return total

    return take


lane0, lane1, lane2, lane3 = (summed(lane) for lane in range(4))
sum3, sum4 = summed(0, 1, 2), summed(0, 1, 2, 3)


def combined(operation: str, lanes: Lanes = LANES) -> Any:
    """A function that does one instruction lane by lane."""
    return written(lanes, lanes, lanes)(lambda at, a, b: getattr(at.builder, operation)(a, b))


def fused(lanes: Lanes = LANES, less: bool = False) -> Any:
    """A function that adds a product, or subtracts it where `less`, lane by lane, rounded once."""

    @written(lanes, lanes, lanes, lanes)
    def fma(at: At, a: Any, b: Any, c: Any) -> Any:
        name = f"llvm.fma.v{lanes.vector.count}f{64 if lanes is LANES else 32}"
        return called(at.builder, name, lanes.vector, at.builder.fneg(a) if less else a, b, c)

    return fma


add, sub, mul, div = (combined(operation) for operation in ("fadd", "fsub", "fmul", "fdiv"))
fma = fused()


@written(LANES, LANES)
def root(at: At, a: Any) -> Any:
    return called(at.builder, "llvm.sqrt.v4f64", QUAD, a)


@written(LANES, LANES, LANES, LANES, LANES)
def where_less(at: At, a: Any, b: Any, p: Any, q: Any) -> Any:
    return at.builder.select(at.builder.fcmp_ordered("<", a, b), p, q)


@written(types.intp, None, types.intp)
def index(at: At, array: Any, i: Any) -> Any:
    return at.builder.sext(at.builder.load(element(at, array, i)), i.type)


def indices(columns: int) -> Any:
    """A function that reads a[i, j] of indices in rows of so many."""

    @written(types.intp, None, types.intp, types.intp)
    def take(at: At, array: Any, i: Any, j: Any) -> Any:
        return at.builder.sext(at.builder.load(place(at, at.kinds[0], array, i, j, columns)), i.type)

    return take


index2, index3 = indices(2), indices(3)


@written(types.void, None, types.intp)
def prefetch(at: At, array: Any, i: Any) -> None:
    address = at.builder.bitcast(place(at, at.kinds[0], array, i, i.type(0), 8), ir.IntType(8).as_pointer())
    to_write, near, data = INDEX(1), INDEX(3), INDEX(1)
    called(at.builder, "llvm.prefetch.p0", ir.VoidType(), address, to_write, near, data)


@written(types.int64, None, types.intp)
def read_shared(at: At, array: Any, i: Any) -> Any:
    return at.builder.load_atomic(element(at, array, i), "acquire", ALIGNED)


@written(types.void, None, types.intp, types.int64)
def write_shared(at: At, array: Any, i: Any, value: Any) -> None:
    at.builder.store_atomic(value, element(at, array, i), "release", ALIGNED)


@written(types.boolean, None, types.intp, types.int64, types.int64)
def exchange(at: At, array: Any, i: Any, expected: Any, value: Any) -> Any:
    found = at.builder.cmpxchg(element(at, array, i), expected, value, "acq_rel", "acquire")
    return at.builder.extract_value(found, 1)


@written(types.void, types.boolean)
def pause(at: At, long: Any) -> None:
    with at.builder.if_then(long):
        if hasattr(os, "sched_yield"):  # a function of the C library that the process has anyway
            called(at.builder, "sched_yield", INDEX)
    if platform.machine() in ("x86_64", "AMD64"):  # spins without keeping the core's other thread from its work
        called(at.builder, "llvm.x86.sse2.pause", ir.VoidType())


KINDS = {width: Lanes(f"Singles{width}", ir.VectorType(SINGLE, width)) for width in (4, 8, 16)}


def spreads(lanes: Lanes, columns: int | None = None) -> Any:
    """A function that fills all lanes with a[i, j]."""

    @written(lanes, None, types.intp, types.intp)
    def spread(at: At, array: Any, i: Any, j: Any) -> Any:
        address = place(at, at.kinds[0], array, i, j, columns=columns)
        return everywhere(at.builder, at.builder.load(address), lanes.vector)

    return spread


def splats(lanes: Lanes) -> Any:
    """A function that fills all lanes with a number."""

    @written(lanes, types.float64)
    def splat(at: At, x: Any) -> Any:
        return everywhere(at.builder, at.builder.fptrunc(x, SINGLE), lanes.vector)

    return splat


F, G, H = KINDS.values()
load4f, column4f, load8f, load16 = loads(4, lanes=F), loads(8, lanes=F), loads(8, lanes=G), loads(lanes=H)
store4f, store8f, store16 = stores(4, lanes=F), stores(8, lanes=G), stores(lanes=H)
spread4f, spread16 = spreads(F, 4), spreads(H)
splat4f, splat8f, splat16 = map(splats, KINDS.values())
add4f, sub4f, mul4f = (combined(operation, F) for operation in ("fadd", "fsub", "fmul"))
add16 = combined("fadd", H)
fma4f, fma8f, fma16 = map(fused, KINDS.values())
less4f = fused(F, less=True)
lane0f, lane1f, lane2f = (reordered([lane] * 4, F) for lane in range(3))
clear4f = reordered([0, 1, 2, 4], F)


@written(types.float32, H)
def sum16(at: At, v: Any) -> Any:
    for half in (8, 4, 2, 1):
        nothing = undefined(v.type)
        low = shuffled(at.builder, v, nothing, list(range(half)))
        v = at.builder.fadd(low, shuffled(at.builder, v, nothing, list(range(half, 2 * half))))
    return at.builder.extract_element(v, INDEX(0))
