"""Four numbers at once: the vector registers of the processor, for rows of 3×3 blocks and for 3-vectors.

A compiler does not turn loops over three components into vector instructions, so the kernels say it: a 3-vector is
loaded into the first three of four lanes, and a block times a vector is three fused multiply-adds, one per column.
What is fused is named here, product by product, so no result depends on what a compiler makes of its surroundings.

    load(a, i, j)      a[i, j … j + 3]                   store(v, a, i, j)
    load3(a, i)        a[i, 0 … 2], and 0                store3(v, a, i)       without touching what follows
    splat(x)           x x x x                           pack(x, y, z, w)      x y z w
    spread0/1/2(v)     one lane in all four              lane0/1/2(v)          one lane as a number
    add sub mul        lane by lane                      fma(a, b, c)          a b + c, rounded once
    sum3(v)            v₀ + v₁ + v₂                      clear3(v)             v with 0 in lane 3
    turn(v)            v₁ v₂ v₀ v₃, for cross products     xyzz xxxy zyyz zxyy(v)   the components so named

Indices are not checked. With NUMBA_DISABLE_JIT=1 the same functions work on NumPy arrays of four numbers.
"""

from __future__ import annotations

import numba

if numba.config.DISABLE_JIT:
    from clothfit.lanes.plain import (
        add, clear3, fma, lane0, lane1, lane2, load, load3, mul, pack, splat, spread0, spread1, spread2, store, store3,
        sub, sum3, turn, xxxy, xyzz, zxyy, zyyz,
    )  # fmt: skip
else:
    from clothfit.lanes.compiled import (
        add, clear3, fma, lane0, lane1, lane2, load, load3, mul, pack, splat, spread0, spread1, spread2, store, store3,
        sub, sum3, turn, xxxy, xyzz, zxyy, zyyz,
    )  # fmt: skip

__all__ = [
    "add", "clear3", "fma", "lane0", "lane1", "lane2", "load", "load3", "mul", "pack", "splat", "spread0", "spread1",
    "spread2", "store", "store3", "sub", "sum3", "turn", "xxxy",
    "xyzz", "zxyy", "zyyz",
]  # fmt: skip
