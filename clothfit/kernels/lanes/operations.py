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


class Operation:
    """An operation."""

    def __init__(self, name: str) -> None:
        self.name = name

    @property
    def _numba_type_(self) -> Any:
        """What numba takes this object for."""
        from numba.core.registry import cpu_target

        from clothfit.kernels.lanes import compiled

        cpu_target.typing_context.refresh()  # which learns of operations that were imported just now
        return cpu_target.typing_context.resolve_value_type(getattr(compiled, self.name))


def __getattr__(name: str) -> Any:
    """The operation of that name."""
    if name.startswith("_"):  # what Python asks of every module
        raise AttributeError(name)
    return globals().setdefault(name, Operation(name))
