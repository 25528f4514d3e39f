"""The parts of conjugate gradients with the SSOR preconditioner: passes over rows of the matrix.

Symbols are those of `cg`. Each pass takes the rows of one subdomain (`sparse.Pattern`): all rows of a small cloth, or
a third of them, so that two threads can take the first two. A row pushes what it knows to later rows, of its own
subdomain or the separator. Those pushes go to an array of the subdomain, `own`, and the separator adds up what both
pushed. Vectors are (n, 4), lane 3 being 0.
"""

from __future__ import annotations

from clothfit.engine.solve.sparse import added, spread, times, times_row, times_spread
from clothfit.kernels.kernel import kernel
from clothfit.kernels.lanes.operations import add, clear3, fma, index, load4, mul, splat, store4, sub, sum3


@kernel
def rows(A, subdomain):
    """The vertices of a subdomain's rows, and where their slots begin and end; indices from 0 cost numba no checks."""
    return A.order[subdomain[0] : subdomain[1]], A.row[subdomain[0] : subdomain[1] + 1]


@kernel
def push(A, row, k, y, out):
    """out_j += B y for all blocks B of row k."""
    wide = spread(y)
    for e in range(row[k], row[k + 1]):
        j = index(A.column, e)
        store4(times_spread(A.upper, e, wide, load4(out, j)), out, j)


@kernel
def gather(A, subdomain, far, own):
    """own += far at the rows of the separator, then far = 0: what subdomain 1 pushed to it."""
    zero = splat(0.0)
    for i in rows(A, subdomain)[0]:
        store4(add(load4(own, i), load4(far, i)), own, i)
        store4(zero, far, i)


@kernel
def residual(A, subdomain, x, own, r):
    """r = b − A x, `own` being b and used up; returns |r|²."""
    order, row = rows(A, subdomain)
    rr, zero = splat(0.0), splat(0.0)
    for k in range(len(order)):
        i = order[k]
        wide = spread(sub(zero, load4(x, i)))
        sums = zero, zero, zero
        for e in range(row[k], row[k + 1]):
            j = index(A.column, e)
            sums = times_row(A.upper, e, x, j, sums)
            store4(times_spread(A.upper, e, wide, load4(own, j)), own, j)
        total = clear3(sub(times_spread(A.diagonal, i, wide, load4(own, i)), added(sums)))
        store4(total, r, i)
        rr = fma(total, total, rr)
    return sum3(rr)


@kernel
def solve_lower(A, subdomain, inverse, own, r):
    """r = (D̂ + L)⁻¹ own, `own` being used up."""
    order, row = rows(A, subdomain)
    zero = splat(0.0)
    for k in range(len(order)):
        i = order[k]
        y = clear3(times(inverse, i, load4(own, i), zero))
        store4(y, r, i)
        push(A, row, k, sub(zero, y), own)


@kernel
def weigh(A, subdomain, scale, r, z):
    """z = scale · D r; returns r·z."""
    total, factor, zero = splat(0.0), splat(scale), splat(0.0)
    for i in rows(A, subdomain)[0]:
        r_i = load4(r, i)
        z_i = clear3(times(A.diagonal, i, mul(factor, r_i), zero))
        store4(z_i, z, i)
        total = fma(r_i, z_i, total)
    return sum3(total)


@kernel
def solve_upper(A, subdomain, inverse, kappa, beta, z, p, t, own):
    """p = z + β p, t = (D̂ + Lᵀ)⁻¹ p and own = p − K t, with K = κ D."""
    order, row = rows(A, subdomain)
    zero, growth, minus_kappa = splat(0.0), splat(beta), splat(-kappa)
    for k in range(len(order) - 1, -1, -1):
        i = order[k]
        p_i = fma(growth, load4(p, i), load4(z, i))
        store4(p_i, p, i)
        sums = zero, zero, zero
        for e in range(row[k + 1] - 1, row[k] - 1, -1):  # the nearest vertex, whose t is the newest, last
            sums = times_row(A.upper, e, t, index(A.column, e), sums)
        t_i = clear3(times(inverse, i, sub(p_i, added(sums)), zero))
        store4(t_i, t, i)
        store4(clear3(times(A.diagonal, i, mul(minus_kappa, t_i), p_i)), own, i)


@kernel
def apply_lower(A, subdomain, inverse, p, t, own, q):
    """q = t + (D̂ + L)⁻¹ own, `own` being used up; returns p·q."""
    order, row = rows(A, subdomain)
    zero, total = splat(0.0), splat(0.0)
    for k in range(len(order)):
        i = order[k]
        y = clear3(times(inverse, i, load4(own, i), zero))
        q_i = add(load4(t, i), y)
        store4(q_i, q, i)
        total = fma(load4(p, i), q_i, total)
        push(A, row, k, sub(zero, y), own)
    return sum3(total)


@kernel
def update(A, subdomain, alpha, scale, t, q, x, r, z):
    """x += α t, r −= α q, z = scale · D r; returns r·z."""
    total, step, back, factor, zero = splat(0.0), splat(alpha), splat(-alpha), splat(scale), splat(0.0)
    for i in rows(A, subdomain)[0]:
        store4(fma(step, load4(t, i), load4(x, i)), x, i)
        r_i = fma(back, load4(q, i), load4(r, i))
        store4(r_i, r, i)
        z_i = clear3(times(A.diagonal, i, mul(factor, r_i), zero))
        store4(z_i, z, i)
        total = fma(r_i, z_i, total)
    return sum3(total)


@kernel
def squared_residual(A, subdomain, scale, r, own):
    """|(D̂ + L) r|² at the rows of a subdomain, `own` being 0 and used up: the residual of A w = b itself."""
    order, row = rows(A, subdomain)
    total, factor = splat(0.0), splat(scale)
    for k in range(len(order)):
        i = order[k]
        r_i = load4(r, i)
        sum_i = clear3(times(A.diagonal, i, mul(factor, r_i), load4(own, i)))
        total = fma(sum_i, sum_i, total)
        push(A, row, k, r_i, own)
    return sum3(total)


@kernel
def clear(A, subdomain, own):
    """own = 0 at the rows of a subdomain."""
    zero = splat(0.0)
    for i in rows(A, subdomain)[0]:
        store4(zero, own, i)
