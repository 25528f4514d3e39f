"""The sums over all points of a subspace that a step needs, compiled, and its dense system.

    products     R (q, p, w): positions and velocities of the points
    add_matrix   A += Σ Rᵀ B R, its lower half, for a symmetric block B of each point
    add_vectors  b += Σ Rᵀ p for a vector p of each point
    factorise    A = L Lᵀ,  solve  A x = b

R (3 m, w) has single precision, and zeros where the basis has fewer than w columns, a multiple of 16. So have the sums,
a few hundred rows at a time; these are added up in double precision. A block of rank one, as that of a face at a
corner, makes one row of a product, others three.
"""

from __future__ import annotations

from math import sqrt

from clothfit.kernels.kernel import kernel
from clothfit.kernels.lanes.operations import fma16, load16, splat16, spread16, store16, sum16

LANES = 16
ROOM = 96
"""Rows of a product: two arrays of so many times 64 stay in the processor's first cache."""

PRODUCTS = 8
"""That are summed up in single precision."""

PANEL = 4
"""Columns of a factor that the others are rid of at once."""

TINY = 1e-13
"""What of a block's pivot is rounding, relative to its trace."""


@kernel
def products(rows, x, out):
    """out (3, 3 m) = R times the rows of x (3, w)."""
    for i in range(len(rows)):
        a, b, c = splat16(0.0), splat16(0.0), splat16(0.0)
        for j in range(0, rows.shape[1], LANES):
            r = load16(rows, i, j)
            a = fma16(r, load16(x, 0, j), a)
            b = fma16(r, load16(x, 1, j), b)
            c = fma16(r, load16(x, 2, j), c)
        out[0, i], out[1, i], out[2, i] = sum16(a), sum16(b), sum16(c)


@kernel
def add_matrix(rows, block, work, A):
    """A (r, r), its lower half, += Σ Rᵀ B R for blocks (m, 6), xx xy xz yy yz zz."""
    left, right, C = work.left, work.right, work.C
    count, since = 0, 0
    C[:] = 0.0
    for j in range(len(block)):
        count += factors(rows, j, block, left, right, count)
        if count > ROOM - 3:
            add_product(left, right, count, C)
            count = 0
            since += 1
            if since == PRODUCTS:
                flush(C, A)
                since = 0
    add_product(left, right, count, C)
    flush(C, A)


@kernel
def flush(C, A):
    """Add the lower half of the sums of single precision to that of double precision, and begin anew."""
    for i in range(len(A)):
        for j in range(i + 1):
            A[i, j] += C[i, j]
    C[:] = 0.0


@kernel
def add_vectors(rows, p, g, b):
    """b (r,) += Σ Rᵀ p for vectors p (m, 3); g (1, w) is used."""
    g[:] = 0.0
    for j in range(len(p)):
        add_row(rows, 3 * j, p[j, 0], p[j, 1], p[j, 2], g)
        if j % ROOM == ROOM - 1:
            flush_vector(g, b)
    flush_vector(g, b)


@kernel
def flush_vector(g, b):
    """The same for a vector."""
    for i in range(len(b)):
        b[i] += g[0, i]
    g[:] = 0.0


@kernel
def add_row(rows, i, p0, p1, p2, g):
    """g (1, w) += p · R for the three rows from i on."""
    a, b, c = splat16(p0), splat16(p1), splat16(p2)
    for k in range(0, rows.shape[1], LANES):
        sum_ = fma16(a, load16(rows, i, k), load16(g, 0, k))
        sum_ = fma16(b, load16(rows, i + 1, k), sum_)
        store16(fma16(c, load16(rows, i + 2, k), sum_), g, 0, k)


@kernel
def factors(rows, j, block, left, right, m):
    """Write rows from m on, the products of which are Rᵀ B R for point j; returns how many."""
    xx, xy, xz, yy, yz, zz = block[j, 0], block[j, 1], block[j, 2], block[j, 3], block[j, 4], block[j, 5]
    a, d, g = abs(xx), abs(yy), abs(zz)
    least = TINY * (a + d + g)
    if not max(a, d, g) > 0.0:
        return 0
    if a >= d and a >= g:
        pivot, l0, l1, l2 = xx, 1.0, xy / xx, xz / xx
    elif d >= g:
        pivot, l0, l1, l2 = yy, xy / yy, 1.0, yz / yy
    else:
        pivot, l0, l1, l2 = zz, xz / zz, yz / zz, 1.0
    i, width = 3 * j, rows.shape[1]
    if abs(xx - pivot * l0 * l0) + abs(yy - pivot * l1 * l1) + abs(zz - pivot * l2 * l2) <= least:
        p0, p1, p2, scale = splat16(l0), splat16(l1), splat16(l2), splat16(pivot)
        for k in range(0, width, LANES):
            along = fma16(p0, load16(rows, i, k), splat16(0.0))
            along = fma16(p2, load16(rows, i + 2, k), fma16(p1, load16(rows, i + 1, k), along))
            store16(along, left, m, k)
            store16(fma16(scale, along, splat16(0.0)), right, m, k)
        return 1
    B0, B1, B2, B3, B4, B5 = splat16(xx), splat16(xy), splat16(xz), splat16(yy), splat16(yz), splat16(zz)
    for k in range(0, width, LANES):
        x, y, z = load16(rows, i, k), load16(rows, i + 1, k), load16(rows, i + 2, k)
        store16(x, left, m, k)
        store16(y, left, m + 1, k)
        store16(z, left, m + 2, k)
        store16(fma16(B0, x, fma16(B1, y, fma16(B2, z, splat16(0.0)))), right, m, k)
        store16(fma16(B1, x, fma16(B3, y, fma16(B4, z, splat16(0.0)))), right, m + 1, k)
        store16(fma16(B2, x, fma16(B4, y, fma16(B5, z, splat16(0.0)))), right, m + 2, k)
    return 3


@kernel
def add_product(left, right, count, C):
    """C (w, w) += leftᵀ right for so many rows, where a tile of 8 × 16 reaches the lower half."""
    for i in range(0, C.shape[0], 8):
        for j in range(0, i + 8, LANES):
            a, b, c, d = load16(C, i, j), load16(C, i + 1, j), load16(C, i + 2, j), load16(C, i + 3, j)
            e, f, g, h = load16(C, i + 4, j), load16(C, i + 5, j), load16(C, i + 6, j), load16(C, i + 7, j)
            for k in range(count):
                t = load16(right, k, j)
                a, b = fma16(spread16(left, k, i), t, a), fma16(spread16(left, k, i + 1), t, b)
                c, d = fma16(spread16(left, k, i + 2), t, c), fma16(spread16(left, k, i + 3), t, d)
                e, f = fma16(spread16(left, k, i + 4), t, e), fma16(spread16(left, k, i + 5), t, f)
                g, h = fma16(spread16(left, k, i + 6), t, g), fma16(spread16(left, k, i + 7), t, h)
            store16(a, C, i, j)
            store16(b, C, i + 1, j)
            store16(c, C, i + 2, j)
            store16(d, C, i + 3, j)
            store16(e, C, i + 4, j)
            store16(f, C, i + 5, j)
            store16(g, C, i + 6, j)
            store16(h, C, i + 7, j)


@kernel
def factorise(A, columns):
    """Replace the lower half of A (r, r) by L; whether A is positive definite. `columns` (PANEL, r) are used."""
    r = len(A)
    for first in range(0, r, PANEL):
        end = min(first + PANEL, r)
        for k in range(first, end):
            pivot = A[k, k]
            if not pivot > 0.0:
                return False
            A[k, k] = sqrt(pivot)
            for i in range(k + 1, r):
                A[i, k] /= A[k, k]
                for j in range(k + 1, min(i + 1, end)):
                    A[i, j] -= A[i, k] * A[j, k]
        subtract_panel(A, columns, first, end)
    return True


@kernel
def subtract_panel(A, columns, first, end):
    """Take the products of the columns from `first` to `end` off the rest of the lower half, all of a row at once."""
    r = len(A)
    for i in range(end, r):
        for k in range(first, end):
            columns[k - first, i] = A[i, k]
    if end - first < PANEL:
        return
    for i in range(end, r):
        a, b, c, d = A[i, first], A[i, first + 1], A[i, first + 2], A[i, first + 3]
        for j in range(end, i + 1):
            A[i, j] -= a * columns[0, j] + b * columns[1, j] + (c * columns[2, j] + d * columns[3, j])


@kernel
def solve(L, x):
    """Replace b (r,) by the solution of L Lᵀ x = b."""
    r = len(x)
    for i in range(r):
        total = x[i]
        for j in range(i):
            total -= L[i, j] * x[j]
        x[i] = total / L[i, i]
    for i in range(r - 1, -1, -1):
        x[i] /= L[i, i]
        for j in range(i):
            x[j] -= L[i, j] * x[i]
