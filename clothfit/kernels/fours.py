"""Four springs or faces at a time: their 3-vectors as tuples (x, y, z) of lanes, one lane for each.

What an element needs of the products of its vectors then takes a fourth of the instructions, and no lane is idle.
Elements come in fours from the first on; of those that are left over, lanes from `end` on repeat the last element, and
nothing of them is kept.
"""

from __future__ import annotations

from clothfit.kernels.kernel import kernel
from clothfit.kernels.lanes.operations import (
    across0,
    across1,
    across2,
    across3,
    add,
    fma,
    lane0,
    lane1,
    lane2,
    lane3,
    mul,
    pack,
    quad,
    splat,
    store_quad,
    sub,
)
from clothfit.kernels.vectors import item


@kernel
def of_four(a, b, c, d):
    """The four vectors as a tuple."""
    return across0(a, b, c, d), across1(a, b, c, d), across2(a, b, c, d)


@kernel
def everywhere(a):
    """A vector (3,) for each of the four."""
    return splat(a[0]), splat(a[1]), splat(a[2])


@kernel
def four_of(p, w):
    """The other way: four vectors, with the lanes of w behind them."""
    x, y, z = p
    return across0(x, y, z, w), across1(x, y, z, w), across2(x, y, z, w), across3(x, y, z, w)


@kernel
def dots(p, q):
    """p·q."""
    return fma(p[2], q[2], fma(p[1], q[1], mul(p[0], q[0])))


@kernel
def crosses(p, q):
    """p × q."""
    x = sub(mul(p[1], q[2]), mul(p[2], q[1]))
    y = sub(mul(p[2], q[0]), mul(p[0], q[2]))
    return x, y, sub(mul(p[0], q[1]), mul(p[1], q[0]))


@kernel
def scaled(c, p):
    """c p."""
    return mul(c, p[0]), mul(c, p[1]), mul(c, p[2])


@kernel
def plus(p, q):
    """p + q."""
    return add(p[0], q[0]), add(p[1], q[1]), add(p[2], q[2])


@kernel
def minus(p, q):
    """p − q."""
    return sub(p[0], q[0]), sub(p[1], q[1]), sub(p[2], q[2])


@kernel
def along(c, p, q):
    """c p + q."""
    return fma(c, p[0], q[0]), fma(c, p[1], q[1]), fma(c, p[2], q[2])


@kernel
def blocks(p, q, rest):
    """The numbers xx xy xz yy yz zz of the blocks p qᵀ, for q along p, with `rest` on the diagonal."""
    x, y, z = p
    return fma(x, q[0], rest), mul(x, q[1]), mul(x, q[2]), fma(y, q[1], rest), mul(y, q[2]), fma(z, q[2], rest)


@kernel
def halves(six):
    """The two halves of each of four blocks, as `sparse` keeps them, of their numbers as `blocks` gives them."""
    xx, xy, xz, yy, yz, zz = six
    first = across0(xx, xy, xz, yz), across0(zz, xy, yy, yz)
    second = across1(xx, xy, xz, yz), across1(zz, xy, yy, yz)
    third = across2(xx, xy, xz, yz), across2(zz, xy, yy, yz)
    return first, second, third, (across3(xx, xy, xz, yz), across3(zz, xy, yy, yz))


@kernel
def kept(v, i, end):
    """The numbers v of elements i … i + 3, 0 from `end` on."""
    if i + 4 <= end:
        return v
    return pack(lane0(v), lane1(v) if i + 1 < end else 0.0, lane2(v) if i + 2 < end else 0.0, 0.0)


@kernel
def some(a, i, end, other):
    """a[i … i + 3] of (n,), `other` from `end` on."""
    if i + 4 <= end:
        return quad(a, i)
    return pack(a[i], a[i + 1] if i + 1 < end else other, a[i + 2] if i + 2 < end else other, other)


@kernel
def add_some(a, i, end, v):
    """a[i … i + 3] += v of (n,), before `end`."""
    if i + 4 <= end:
        store_quad(add(quad(a, i), v), a, i)
        return
    a[i] += lane0(v)
    if i + 1 < end:
        a[i + 1] += lane1(v)
    if i + 2 < end:
        a[i + 2] += lane2(v)


@kernel
def of_objects(numbers, owner, i, end):
    """The numbers (K,) of the objects that elements i … i + 3 belong to."""
    second, third, fourth = min(i + 1, end - 1), min(i + 2, end - 1), min(i + 3, end - 1)
    p, q = numbers[item(owner, i)], numbers[item(owner, second)]
    return pack(p, q, numbers[item(owner, third)], numbers[item(owner, fourth)])


@kernel
def add_to_objects(a, owner, i, end, v):
    """a (K,) += v at the objects of elements i … i + 3, before `end`."""
    a[item(owner, i)] += lane0(v)
    if i + 1 < end:
        a[item(owner, i + 1)] += lane1(v)
    if i + 2 < end:
        a[item(owner, i + 2)] += lane2(v)
    if i + 3 < end:
        a[item(owner, i + 3)] += lane3(v)
