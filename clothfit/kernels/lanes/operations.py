"""Four numbers at once: the vector registers of the processor, for rows of 3×3 blocks and for 3-vectors.

A compiler does not turn loops over three components into vector instructions, so the kernels say it: a 3-vector is
loaded into the first three of four lanes, and a block times a vector is three fused multiply-adds, one per column.
What is fused is named here, product by product, so no result depends on what a compiler makes of its surroundings.

    load(a, i, j)      a[i, j … j + 3]                   store(v, a, i, j)
    load4(a, i)        a[i], a row of four               store4(v, a, i)
    column(a, i, j)    a[i, j … j + 3], rows of eight    store_column(v, a, i, j)
    load3(a, i)        a[i, 0 … 2], and 0                store3(v, a, i)       without touching what follows
    splat(x)           x x x x                           pack(x, y, z, w)      x y z w
    spread4(a, i, j)   a[i, j] in all lanes, rows of four, faster than a shuffle of what was loaded on some processors
    spread0/1/2(v)     one lane in all four              lane0/1/2/3(v)        one lane as a number
    add sub mul div    lane by lane                      fma(a, b, c)          a b + c, rounded once
    root(v)            the square roots                  where_less(a, b, p, q)  p where a < b, else q
    sum3(v), sum4(v)   v₀ + v₁ + v₂ (+ v₃)               clear3(v)             v with 0 in lane 3
    turn(v)            v₁ v₂ v₀ v₃, for cross products     xyzz xxxy zyyz zxyy(v)   the components so named
    quad(a, i)         a[i … i + 3] of (n,)          store_quad(v, a, i)
    across0/1/2/3(a, b, c, d)  that lane of each
    index(a, i)        a[i] of indices, none negative; index2, index3(a, i, j)    a[i, j] in rows of two, of three
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
checked. These are names, for which numba takes what `compiled` has when it compiles a kernel that uses them.
"""

from __future__ import annotations

from typing import Any

SINGLES = ("16", "f")
"""How the names of operations on single precision end."""


class Operation:
    """An operation."""

    def __init__(self, name: str) -> None:
        self.name = name

    @property
    def _numba_type_(self) -> Any:
        """What numba takes this object for."""
        from numba.core.registry import cpu_target

        from clothfit.kernels.lanes import compiled, compiled_singles

        cpu_target.typing_context.refresh()  # which learns of operations that were imported just now
        own = compiled_singles if self.name.endswith(SINGLES) else compiled
        return cpu_target.typing_context.resolve_value_type(getattr(own, self.name))


class Named:
    """All operations, by their names."""

    def __getattr__(self, name: str) -> Operation:
        return Operation(name)


named: Any = Named()

load, store, load3, store3 = named.load, named.store, named.load3, named.store3
load4, store4, column, store_column = named.load4, named.store4, named.column, named.store_column
splat, pack, clear3, turn = named.splat, named.pack, named.clear3, named.turn
spread4, spread0, spread1, spread2 = named.spread4, named.spread0, named.spread1, named.spread2
lane0, lane1, lane2, lane3 = named.lane0, named.lane1, named.lane2, named.lane3
sum3, sum4 = named.sum3, named.sum4
add, sub, mul, fma = named.add, named.sub, named.mul, named.fma
div, root, where_less = named.div, named.root, named.where_less
xyzz, xxxy, zyyz, zxyy = named.xyzz, named.xxxy, named.zyyz, named.zxyy
quad, store_quad, index2, index3 = named.quad, named.store_quad, named.index2, named.index3
across0, across1, across2, across3 = named.across0, named.across1, named.across2, named.across3
index, prefetch, read_shared, write_shared = named.index, named.prefetch, named.read_shared, named.write_shared
exchange, pause = named.exchange, named.pause
load16, store16, spread16, splat16 = named.load16, named.store16, named.spread16, named.splat16
add16, fma16, sum16 = named.add16, named.fma16, named.sum16
load4f, column4f, store4f = named.load4f, named.column4f, named.store4f
spread4f, splat4f = named.spread4f, named.splat4f
add4f, sub4f, mul4f, fma4f, less4f = named.add4f, named.sub4f, named.mul4f, named.fma4f, named.less4f
load8f, store8f, splat8f, fma8f = named.load8f, named.store8f, named.splat8f, named.fma8f
lane0f, lane1f, lane2f, clear4f = named.lane0f, named.lane1f, named.lane2f, named.clear4f
