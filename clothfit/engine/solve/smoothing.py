"""The smoother of `multigrid`: sweeps of Gauss–Seidel over rows of a level, in single precision.

Vectors are (n, 4) by the place of a row in the order of sweep, lane 3 being of no use. Each sweep reads a row's blocks
once, for what its vertex takes from later ones and for what it gives to them. So the first sweep goes back through the
rows and the second forwards: A z of the first is then known but for what later rows take from earlier ones.

Rows `begin` to below `end` are those of a subdomain; what they give to later rows goes to an array of the subdomain, so
that two threads may take two of them (`cg_multigrid`).
"""

from __future__ import annotations

from clothfit.kernels.kernel import kernel
from clothfit.kernels.lanes.operations import (
    add4f,
    clear4f,
    column4f,
    fma4f,
    index,
    lane0f,
    lane1f,
    lane2f,
    less4f,
    load4f,
    mul4f,
    splat4f,
    spread4f,
    store4f,
    sub4f,
)


@kernel
def product(blocks, k, x):
    """B x of block k, and 0 in lane 3."""
    total = mul4f(column4f(blocks, k, 0), lane0f(x))
    total = fma4f(column4f(blocks, k, 5), lane1f(x), total)
    return clear4f(fma4f(column4f(blocks, k, 2), lane2f(x), total))


@kernel
def take(A, first, last, z):
    """Σ B z over the later vertices, for the slots from `first` to below `last`; the nearest vertex comes last, as its
    z may be the newest. Three sums, since each product of one waits for the last.
    """
    x, y, w = splat4f(0.0), splat4f(0.0), splat4f(0.0)
    for e in range(last - 1, first - 1, -1):
        j = index(A.column, e)
        x = fma4f(column4f(A.upper, e, 0), spread4f(z, j, 0), x)
        y = fma4f(column4f(A.upper, e, 5), spread4f(z, j, 1), y)
        w = fma4f(column4f(A.upper, e, 2), spread4f(z, j, 2), w)
    return add4f(add4f(x, y), w)


@kernel
def give(A, first, last, z, out):
    """out −= B z at the later vertices, for the slots from `first` to below `last`."""
    z0, z1, z2 = lane0f(z), lane1f(z), lane2f(z)
    for e in range(first, last):
        j = index(A.column, e)
        total = less4f(column4f(A.upper, e, 0), z0, load4f(out, j, 0))
        total = less4f(column4f(A.upper, e, 5), z1, total)
        store4f(less4f(column4f(A.upper, e, 2), z2, total), out, j, 0)


@kernel
def clear(begin, end, out):
    """out = 0."""
    for k in range(begin, end):
        store4f(splat4f(0.0), out, k, 0)


@kernel
def descend(A, inverse, begin, end, r, z, rest):
    """z = (D + Lᵀ)⁻¹ r and rest = r − A z, which is −L z: 0 before at the rows of other subdomains."""
    for k in range(end - 1, begin - 1, -1):
        first, last = index(A.row, k), index(A.row, k + 1)
        z_k = product(inverse, k, sub4f(load4f(r, k, 0), take(A, first, last, z)))
        store4f(z_k, z, k, 0)
        store4f(splat4f(0.0), rest, k, 0)
        give(A, first, last, z_k, rest)


@kernel
def ascend(A, inverse, begin, end, rest, z):
    """z = (D + L)⁻¹ (r − Lᵀ z); `rest` is r less what earlier rows of other subdomains gave, and is used up."""
    for k in range(begin, end):
        first, last = index(A.row, k), index(A.row, k + 1)
        z_k = product(inverse, k, sub4f(load4f(rest, k, 0), take(A, first, last, z)))
        store4f(z_k, z, k, 0)
        give(A, first, last, z_k, rest)


@kernel
def gather(begin, end, far, out):
    """out += far."""
    for k in range(begin, end):
        store4f(add4f(load4f(out, k, 0), load4f(far, k, 0)), out, k, 0)


@kernel
def restrict(coarsening, begin, end, rest, r):
    """r of the coarser level += Pᵀ rest."""
    start, aggregate, weight = coarsening.start, coarsening.aggregate, coarsening.weight
    for k in range(begin, end):
        rest_k = load4f(rest, k, 0)
        for a in range(index(start, k), index(start, k + 1)):
            c = index(aggregate, a)
            store4f(fma4f(splat4f(weight[a]), rest_k, load4f(r, c, 0)), r, c, 0)


@kernel
def prolong(coarsening, begin, end, coarse, r, z, rest):
    """z += P z of the coarser level, and rest = r for the sweep that follows."""
    start, aggregate, weight = coarsening.start, coarsening.aggregate, coarsening.weight
    for k in range(begin, end):
        z_k = load4f(z, k, 0)
        for a in range(index(start, k), index(start, k + 1)):
            z_k = fma4f(splat4f(weight[a]), load4f(coarse, index(aggregate, a), 0), z_k)
        store4f(z_k, z, k, 0)
        store4f(load4f(r, k, 0), rest, k, 0)


@kernel
def relax(A, inverse, sweeps, r, z, rest):
    """z = A⁻¹ r, nearly: the result of some symmetric sweeps from z = 0."""
    rows = len(A.order)
    descend(A, inverse, 0, rows, r, z, rest)
    for turn in range(sweeps):
        if turn > 0:
            back_again(A, inverse, r, z, rest)
        for k in range(rows):
            store4f(load4f(r, k, 0), rest, k, 0)
        ascend(A, inverse, 0, rows, rest, z)


@kernel
def back_again(A, inverse, r, z, rest):
    """z = (D + Lᵀ)⁻¹ (r − L z)."""
    rows = len(A.order)
    for k in range(rows):
        store4f(load4f(r, k, 0), rest, k, 0)
    for k in range(rows):
        give(A, index(A.row, k), index(A.row, k + 1), load4f(z, k, 0), rest)
    for k in range(rows - 1, -1, -1):
        z_k = product(inverse, k, sub4f(load4f(rest, k, 0), take(A, index(A.row, k), index(A.row, k + 1), z)))
        store4f(z_k, z, k, 0)
