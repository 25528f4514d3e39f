"""Four, eight or sixteen numbers of single precision, compiled: a half, a whole and two registers of AVX2."""

from __future__ import annotations

from typing import Any

from llvmlite import ir
from numba.core import types

from clothfit.kernels.lanes.compiled import (
    INDEX,
    SINGLE,
    At,
    Lanes,
    combined,
    everywhere,
    fused,
    loads,
    place,
    reordered,
    shuffled,
    stores,
    undefined,
    written,
)

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
