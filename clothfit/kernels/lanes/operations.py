"""Four numbers at once: the vector registers of the processor, for rows of 3×3 blocks and for 3-vectors.

A compiler does not turn loops over three components into vector instructions, so the kernels say it: a 3-vector is
loaded into the first three of four lanes, and a block times a vector is three fused multiply-adds, one per column.
What is fused is named here, product by product, so no result depends on what a compiler makes of its surroundings.

    load(a, i, j)      a[i, j … j + 3]                   store(v, a, i, j)
    load4(a, i)        a[i], a row of four               store4(v, a, i)
    column(a, i, j)    a[i, j … j + 3], rows of eight    store_column(v, a, i, j)
    load3(a, i)        a[i, 0 … 2], and 0                store3(v, a, i)       without touching what follows
    splat(x)           x x x x                           pack(x, y, z, w)      x y z w
    spread0/1/2(v)     one lane in all four              lane0/1/2(v)          one lane as a number
    add sub mul div    lane by lane                      fma(a, b, c)          a b + c, rounded once
    root(v)            the square roots                  where_less(a, b, p, q)  p where a < b, else q
    sum3(v), sum4(v)   v₀ + v₁ + v₂ (+ v₃)               clear3(v)             v with 0 in lane 3
    turn(v)            v₁ v₂ v₀ v₃, for cross products     xyzz xxxy zyyz zxyy(v)   the components so named
    index(a, i)        a[i] of indices, none negative
    prefetch(a, i)     brings a row of eight near, that will be written
    read_shared(a, i), write_shared(a, i, x)             an int64 of (n,) that two threads look at
    exchange(a, i, old, new)                             the same, set only where it is `old`; whether it was
    pause(long)                                          between two looks

Four, eight or sixteen of single precision, for arrays of float32; their rows are of four numbers where a name ends
with 4f, but of eight for column4f, and of eight where it ends with 8f:

    load4f column4f load8f load16 (a, i, j), store4f store8f store16 (v, a, i, j)    a[i, j … j + 3], … 7 or … 15
    spread4f spread16 (a, i, j)  a[i, j] in all lanes    splat4f splat8f splat16 (x)  a number in all lanes
    add4f sub4f mul4f fma4f fma8f add16 fma16            lane by lane
    less4f(a, b, c)     c − a b, rounded once            lane0f lane1f lane2f (v)  one lane in all four
    clear4f(v)          v with 0 in lane 3               sum16(v)              halves added to halves

The arrays of `load` and `store` may be of float32: what is kept is rounded, what is computed is not. Indices are not
checked. With NUMBA_DISABLE_JIT=1 the same functions work on NumPy arrays of four numbers. Else they are
names, for which numba takes what `compiled` has when it compiles a kernel that uses them.
"""

from __future__ import annotations

from typing import Any

from clothfit.base.threads import interpreted
from clothfit.kernels.lanes import plain, plain_singles

SINGLES = frozenset(name for name in vars(plain_singles) if name.endswith(("16", "f")))
"""The operations on single precision."""


class Operation:
    """An operation of compiled kernels."""

    def __init__(self, name: str) -> None:
        self.name = name

    @property
    def _numba_type_(self) -> Any:
        """What numba takes this object for."""
        from numba.core.registry import cpu_target

        from clothfit.kernels.lanes import compiled, compiled_singles

        cpu_target.typing_context.refresh()  # which learns of operations that were imported just now
        own = compiled_singles if self.name in SINGLES else compiled
        return cpu_target.typing_context.resolve_value_type(getattr(own, self.name))


class Plain:
    """The operations of kernels that are not compiled, by their names."""

    def __getattr__(self, name: str) -> Any:
        return getattr(plain_singles if name in SINGLES else plain, name)


class Compiled:
    """The operations of compiled kernels, by their names."""

    def __getattr__(self, name: str) -> Operation:
        return Operation(name)


chosen: Any = Plain() if interpreted() else Compiled()

load, store, load3, store3 = chosen.load, chosen.store, chosen.load3, chosen.store3
load4, store4, column, store_column = chosen.load4, chosen.store4, chosen.column, chosen.store_column
splat, pack, clear3, turn = chosen.splat, chosen.pack, chosen.clear3, chosen.turn
spread0, spread1, spread2 = chosen.spread0, chosen.spread1, chosen.spread2
lane0, lane1, lane2 = chosen.lane0, chosen.lane1, chosen.lane2
sum3, sum4 = chosen.sum3, chosen.sum4
add, sub, mul, fma = chosen.add, chosen.sub, chosen.mul, chosen.fma
div, root, where_less = chosen.div, chosen.root, chosen.where_less
xyzz, xxxy, zyyz, zxyy = chosen.xyzz, chosen.xxxy, chosen.zyyz, chosen.zxyy
index, prefetch, read_shared, write_shared = chosen.index, chosen.prefetch, chosen.read_shared, chosen.write_shared
exchange, pause = chosen.exchange, chosen.pause
load16, store16, spread16, splat16 = chosen.load16, chosen.store16, chosen.spread16, chosen.splat16
add16, fma16, sum16 = chosen.add16, chosen.fma16, chosen.sum16
load4f, column4f, store4f = chosen.load4f, chosen.column4f, chosen.store4f
spread4f, splat4f = chosen.spread4f, chosen.splat4f
add4f, sub4f, mul4f, fma4f, less4f = chosen.add4f, chosen.sub4f, chosen.mul4f, chosen.fma4f, chosen.less4f
load8f, store8f, splat8f, fma8f = chosen.load8f, chosen.store8f, chosen.splat8f, chosen.fma8f
lane0f, lane1f, lane2f, clear4f = chosen.lane0f, chosen.lane1f, chosen.lane2f, chosen.clear4f
