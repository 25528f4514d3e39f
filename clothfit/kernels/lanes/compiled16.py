"""Sixteen numbers of single precision, compiled: two registers of AVX2, one of AVX-512."""

from __future__ import annotations

from typing import Any

from llvmlite import ir
from numba.core import cgutils, types
from numba.extending import intrinsic, models, register_model

from clothfit.kernels.lanes.compiled import INDEX, Code, place, shuffled, undefined

SINGLE = ir.FloatType()
WIDE = ir.VectorType(SINGLE, 16)
ALIGNED = 4  # bytes


class Lanes16(types.Type):
    """numba's name for sixteen float32."""

    def __init__(self) -> None:
        super().__init__(name="Lanes16")


LANES16 = Lanes16()


@register_model(Lanes16)
class Lanes16Model(models.PrimitiveModel):
    """How numba keeps them: as one LLVM vector."""

    def __init__(self, manager: Any, kind: Any) -> None:
        super().__init__(manager, kind, WIDE)


def everywhere(builder: Any, value: Any) -> Any:
    """A number in all lanes."""
    one = builder.insert_element(undefined(WIDE), value, INDEX(0))
    return shuffled(builder, one, undefined(WIDE), [0] * 16)


@intrinsic
def load16(_context: Any, a: Any, i: Any, j: Any) -> Code:
    def code(context: Any, builder: Any, signature: Any, values: Any) -> Any:
        address = place(context, builder, signature.args[0], *values)
        return builder.load(builder.bitcast(address, WIDE.as_pointer()), align=ALIGNED)

    return LANES16(a, types.intp, types.intp), code


@intrinsic
def store16(_context: Any, v: Any, a: Any, i: Any, j: Any) -> Code:
    def code(context: Any, builder: Any, signature: Any, values: Any) -> Any:
        address = place(context, builder, signature.args[1], *values[1:])
        builder.store(values[0], builder.bitcast(address, WIDE.as_pointer()), align=ALIGNED)
        return context.get_dummy_value()

    return types.void(LANES16, a, types.intp, types.intp), code


@intrinsic
def spread16(_context: Any, a: Any, i: Any, j: Any) -> Code:
    def code(context: Any, builder: Any, signature: Any, values: Any) -> Any:
        return everywhere(builder, builder.load(place(context, builder, signature.args[0], *values)))

    return LANES16(a, types.intp, types.intp), code


@intrinsic
def splat16(_context: Any, x: Any) -> Code:
    def code(_target: Any, builder: Any, _signature: Any, values: Any) -> Any:
        return everywhere(builder, builder.fptrunc(values[0], SINGLE))

    return LANES16(types.float64), code


@intrinsic
def add16(_context: Any, a: Any, b: Any) -> Code:
    return LANES16(LANES16, LANES16), lambda _t, builder, _s, values: builder.fadd(*values)


@intrinsic
def fma16(_context: Any, a: Any, b: Any, c: Any) -> Code:
    def code(_target: Any, builder: Any, _signature: Any, values: Any) -> Any:
        kind = ir.FunctionType(WIDE, [WIDE] * 3)
        return builder.call(cgutils.get_or_insert_function(builder.module, kind, "llvm.fma.v16f32"), values)

    return LANES16(LANES16, LANES16, LANES16), code


@intrinsic
def sum16(_context: Any, v: Any) -> Code:
    def code(_target: Any, builder: Any, _signature: Any, values: Any) -> Any:
        part = values[0]
        for half in (8, 4, 2, 1):
            nothing = undefined(part.type)
            low = shuffled(builder, part, nothing, list(range(half)))
            part = builder.fadd(low, shuffled(builder, part, nothing, list(range(half, 2 * half))))
        return builder.extract_element(part, INDEX(0))

    return types.float32(LANES16), code
