"""Products of 3-vectors in lanes."""

from __future__ import annotations

from clothfit.kernels.kernel import kernel
from clothfit.kernels.lanes.operations import mul, pack, sub, sum3, turn


@kernel
def vector(a):
    """The lanes of a (3,)."""
    return pack(a[0], a[1], a[2], 0.0)


@kernel
def dot(p, q):
    """p·q."""
    return sum3(mul(p, q))


@kernel
def cross(p, q):
    """p × q."""
    return turn(sub(mul(p, turn(q)), mul(turn(p), q)))
