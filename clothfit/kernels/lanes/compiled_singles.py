"""Four, eight or sixteen numbers of single precision, compiled: a half, a whole and two registers of AVX2."""

from __future__ import annotations

from typing import Any

from llvmlite import ir
from numba.core import cgutils, types
from numba.extending import intrinsic, models, register_model

from clothfit.kernels.lanes.compiled import INDEX, Code, place, shuffled, undefined

SINGLE = ir.FloatType()
ALIGNED = 4  # bytes


class Singles(types.Type):
    """numba's name for so many float32."""

    def __init__(self, width: int) -> None:
        super().__init__(name=f"Singles{width}")
        self.width = width


@register_model(Singles)
class SinglesModel(models.PrimitiveModel):
    """How numba keeps them: as one LLVM vector."""

    def __init__(self, manager: Any, kind: Any) -> None:
        super().__init__(manager, kind, vector(kind.width))


def vector(width: int) -> Any:
    """LLVM's type of so many."""
    return ir.VectorType(SINGLE, width)


def everywhere(builder: Any, value: Any, width: int) -> Any:
    """A number in all lanes."""
    one = builder.insert_element(undefined(vector(width)), value, INDEX(0))
    return shuffled(builder, one, undefined(vector(width)), [0] * width)


def loads(width: int, columns: int | None = None) -> Any:
    """A function that reads a[i, j …], of an array with so many columns where they are given."""
    kind = KINDS[width]

    @intrinsic
    def load(_context: Any, a: Any, i: Any, j: Any) -> Code:
        def code(context: Any, builder: Any, signature: Any, values: Any) -> Any:
            address = place(context, builder, signature.args[0], *values, columns=columns)
            return builder.load(builder.bitcast(address, vector(width).as_pointer()), align=ALIGNED)

        return kind(a, types.intp, types.intp), code

    return load


def stores(width: int, columns: int | None = None) -> Any:
    """A function that writes a[i, j …]."""
    kind = KINDS[width]

    @intrinsic
    def store(_context: Any, v: Any, a: Any, i: Any, j: Any) -> Code:
        def code(context: Any, builder: Any, signature: Any, values: Any) -> Any:
            address = place(context, builder, signature.args[1], *values[1:], columns=columns)
            builder.store(values[0], builder.bitcast(address, vector(width).as_pointer()), align=ALIGNED)
            return context.get_dummy_value()

        return types.void(kind, a, types.intp, types.intp), code

    return store


def spreads(width: int, columns: int | None = None) -> Any:
    """A function that fills all lanes with a[i, j]."""
    kind = KINDS[width]

    @intrinsic
    def spread(_context: Any, a: Any, i: Any, j: Any) -> Code:
        def code(context: Any, builder: Any, signature: Any, values: Any) -> Any:
            address = place(context, builder, signature.args[0], *values, columns=columns)
            return everywhere(builder, builder.load(address), width)

        return kind(a, types.intp, types.intp), code

    return spread


def splats(width: int) -> Any:
    """A function that fills all lanes with a number."""
    kind = KINDS[width]

    @intrinsic
    def splat(_context: Any, x: Any) -> Code:
        def code(_target: Any, builder: Any, _signature: Any, values: Any) -> Any:
            return everywhere(builder, builder.fptrunc(values[0], SINGLE), width)

        return kind(types.float64), code

    return splat


def combined(width: int, operation: str) -> Any:
    """A function that does one instruction lane by lane."""
    kind = KINDS[width]

    @intrinsic
    def apply(_context: Any, a: Any, b: Any) -> Code:
        return kind(kind, kind), lambda _t, builder, _s, values: getattr(builder, operation)(*values)

    return apply


def fused(width: int, less: bool = False) -> Any:
    """A function that adds a product, or subtracts it where `less`, lane by lane, rounded once."""
    kind = KINDS[width]

    @intrinsic
    def fma(_context: Any, a: Any, b: Any, c: Any) -> Code:
        def code(_target: Any, builder: Any, _signature: Any, values: Any) -> Any:
            of = ir.FunctionType(vector(width), [vector(width)] * 3)
            name = f"llvm.fma.v{width}f32"
            first = builder.fneg(values[0]) if less else values[0]
            return builder.call(cgutils.get_or_insert_function(builder.module, of, name), [first, *values[1:]])

        return kind(kind, kind, kind), code

    return fma


def reordered(lanes: list[int]) -> Any:
    """A function of the named lanes of four; 4 is a zero."""

    @intrinsic
    def take(_context: Any, v: Any) -> Code:
        def code(_target: Any, builder: Any, _signature: Any, values: Any) -> Any:
            return shuffled(builder, values[0], ir.Constant(vector(4), [0.0] * 4), lanes)

        return KINDS[4](KINDS[4]), code

    return take


KINDS = {width: Singles(width) for width in (4, 8, 16)}

load4f, column4f, load8f, load16 = loads(4, 4), loads(4, 8), loads(8, 8), loads(16)
store4f, store8f, store16 = stores(4, 4), stores(8, 8), stores(16)
spread4f, spread16 = spreads(4, 4), spreads(16)
splat4f, splat8f, splat16 = (splats(width) for width in KINDS)
add4f, sub4f, mul4f = (combined(4, operation) for operation in ("fadd", "fsub", "fmul"))
add16 = combined(16, "fadd")
fma4f, fma8f, fma16 = (fused(width) for width in KINDS)
less4f = fused(4, less=True)
lane0f, lane1f, lane2f = (reordered([lane] * 4) for lane in range(3))
clear4f = reordered([0, 1, 2, 4])


@intrinsic
def sum16(_context: Any, v: Any) -> Code:
    def code(_target: Any, builder: Any, _signature: Any, values: Any) -> Any:
        part = values[0]
        for half in (8, 4, 2, 1):
            nothing = undefined(part.type)
            low = shuffled(builder, part, nothing, list(range(half)))
            part = builder.fadd(low, shuffled(builder, part, nothing, list(range(half, 2 * half))))
        return builder.extract_element(part, INDEX(0))

    return types.float32(KINDS[16]), code
