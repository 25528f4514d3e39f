"""Signed distances of colliders: plane, round cone and box, each in axes of its own.

A point has the distance δ, negative inside, and the outward normal n = ∂δ/∂p. The normal turns with the point by

    ∂n/∂p = k (I − n nᵀ) + j t tᵀ,

k and j in 1/m, t a unit vector across n: k = 1/ρ and j = 0 on a ball at the distance ρ from its centre; 0 and 1/ρ on
the mantle of a cone at the distance ρ from its axis along n; 1/ρ and −1/ρ along an edge; 0 and 0 on a face.

The planes' normal is y. A round cone is what two balls, r at (0, −l/2, 0) and s at (0, l/2, 0), and the cone that
touches both enclose: a capsule where r = s, a ball where l = 0. At a centre, and on the axis, where no direction is the
shortest one, n is some that is, and does not turn. A box has corners; outside of it the distance to them is exact.
"""

from __future__ import annotations

from math import copysign, sqrt

from clothfit.kernels.kernel import kernel
from clothfit.kernels.lanes.operations import pack

PLANE, CONE, BOX, MESH = 0, 2, 3, 4
"""What a shape is: the scene's `type`, but that a sphere is a cone here. Meshes are in `bodies`."""


@kernel
def distance(shape, size, p0, p1, p2):
    """δ, k, j, n and t (lanes) of a shape with a size (3,), m, at a point of its own axes."""
    if shape == PLANE:
        return p1, 0.0, 0.0, pack(0.0, 1.0, 0.0, 0.0), pack(1.0, 0.0, 0.0, 0.0)
    if shape == BOX:
        return box(size, p0, p1, p2)
    return cone(size[0], size[1], size[2], p0, p1, p2)


@kernel
def cone(r, s, length, p0, p1, p2):
    """The same for a round cone."""
    radial, low = sqrt(p0 * p0 + p2 * p2), p1 + 0.5 * length
    if length <= abs(r - s):  # one ball is in the other
        return ball(r, p0, low, p2) if r >= s else ball(s, p0, low - length, p2)
    sine = (r - s) / length
    cosine = sqrt(1.0 - sine * sine)
    along = cosine * low - sine * radial
    if along <= 0.0:
        return ball(r, p0, low, p2)
    if along >= cosine * length:
        return ball(s, p0, low - length, p2)
    delta = cosine * radial + sine * low - r
    if radial == 0.0:
        return delta, 0.0, 0.0, pack(cosine, sine, 0.0, 0.0), pack(0.0, 0.0, 1.0, 0.0)
    e0, e2 = p0 / radial, p2 / radial
    return delta, 0.0, cosine / radial, pack(cosine * e0, sine, cosine * e2, 0.0), pack(-e2, 0.0, e0, 0.0)


@kernel
def ball(r, p0, p1, p2):
    """The same for a ball about the origin."""
    rho = sqrt(p0 * p0 + p1 * p1 + p2 * p2)
    t = pack(1.0, 0.0, 0.0, 0.0)
    if rho == 0.0:
        return -r, 0.0, 0.0, pack(0.0, 1.0, 0.0, 0.0), t
    return rho - r, 1.0 / rho, 0.0, pack(p0 / rho, p1 / rho, p2 / rho, 0.0), t


@kernel
def box(half, p0, p1, p2):
    """The same for a box about the origin, with half of its lengths (3,)."""
    q0, q1, q2 = abs(p0) - half[0], abs(p1) - half[1], abs(p2) - half[2]
    o0, o1, o2 = max(q0, 0.0), max(q1, 0.0), max(q2, 0.0)
    rho = sqrt(o0 * o0 + o1 * o1 + o2 * o2)
    deepest = max(q0, max(q1, q2))
    flat0, flat1 = q0 <= 0.0, q0 > 0.0 and q1 <= 0.0
    t = pack(one_if(flat0), one_if(flat1), one_if(not (flat0 or flat1)), 0.0)
    if rho == 0.0:  # inside: the nearest face
        n0, n1 = one_if(q0 == deepest), one_if(q0 < deepest and q1 == deepest)
        n2 = 1.0 - n0 - n1
        return deepest, 0.0, 0.0, pack(copysign(n0, p0), copysign(n1, p1), copysign(n2, p2), 0.0), t
    n = pack(copysign(o0, p0) / rho, copysign(o1, p1) / rho, copysign(o2, p2) / rho, 0.0)
    beyond = one_if(q0 > 0.0) + one_if(q1 > 0.0) + one_if(q2 > 0.0)
    if beyond == 1.0:
        return rho, 0.0, 0.0, n, t
    return rho, 1.0 / rho, -1.0 / rho if beyond == 2.0 else 0.0, n, t


@kernel
def one_if(true):
    """1.0 or 0.0."""
    return 1.0 if true else 0.0
