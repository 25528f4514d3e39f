"""3-vectors: products of two in lanes, and loops over (n, 3) arrays that would otherwise make temporary arrays."""

from __future__ import annotations

from clothfit.kernels.kernel import kernel
from clothfit.kernels.lanes.operations import mul, pack, sub, sum3, turn


@kernel
def vector(a):
    """The lanes of a (3,)."""
    return pack(a[0], a[1], a[2], 0.0)


@kernel(absent=0)
def item(numbers, i):
    """numbers[i], 0 where there are none."""
    return numbers[i]


@kernel
def dot(p, q):
    """p·q."""
    return sum3(mul(p, q))


@kernel
def cross(p, q):
    """p × q."""
    return turn(sub(mul(p, turn(q)), mul(turn(p), q)))


@kernel
def copy(a, out):
    """out = a; `out[:] = a` would add seconds to the compilation, for its messages about shapes that differ."""
    for i in range(len(out)):
        out[i, 0], out[i, 1], out[i, 2] = a[i, 0], a[i, 1], a[i, 2]


@kernel
def copy_row(a, out):
    """out = a, (m,), as in `copy`."""
    for q in range(len(out)):
        out[q] = a[q]


@kernel
def combine(p, a, q, b, out):
    """out = p a + q b; out may be a or b."""
    for i in range(len(out)):
        out[i, 0] = p * a[i, 0] + q * b[i, 0]
        out[i, 1] = p * a[i, 1] + q * b[i, 1]
        out[i, 2] = p * a[i, 2] + q * b[i, 2]


@kernel
def add(scale, d, out):
    """out += scale · d."""
    combine(1.0, out, scale, d, out)


@kernel
def add_mass(mass, scale, d, out):
    """out += scale · M d, mass (n,)."""
    for i in range(len(mass)):
        m = scale * mass[i]
        out[i, 0] += m * d[i, 0]
        out[i, 1] += m * d[i, 1]
        out[i, 2] += m * d[i, 2]


@kernel
def add_rows_dot(scale, a, b, out):
    """out_i += scale · a_i·b_i, out (n,)."""
    for i in range(len(out)):
        out[i] += scale * (a[i, 0] * b[i, 0] + a[i, 1] * b[i, 1] + a[i, 2] * b[i, 2])


@kernel
def hold_fixed(free, a):
    """Zero the rows of fixed vertices."""
    for i in range(len(free)):
        if not free[i]:
            a[i, 0], a[i, 1], a[i, 2] = 0.0, 0.0, 0.0
