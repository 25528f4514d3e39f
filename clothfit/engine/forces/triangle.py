"""The point of a triangle that is nearest to another point, and how it moves with that.

The triangle (a, b, c) is in lanes, as the point p is. The nearest point is wₐ a + w_b b + w_c c; which part of the
triangle it is on decides what depends on p: FACE, an edge AB, BC or CA, or a corner A, B or C. The parts are those of
Voronoi: C. Ericson, Real-time collision detection, section 5.1.5.

    w_b, w_c of a face, with e = b − a, g = c − a:   the solution of  [e·e e·g; e·g g·g] (w_b, w_c) = (e·(p−a), g·(p−a))
    w of an edge from a to b:                        (p − a)·e / e·e
"""

from __future__ import annotations

from clothfit.kernels.kernel import kernel
from clothfit.kernels.lanes.operations import add, fma, mul, splat, sub
from clothfit.kernels.vectors import dot

FACE, AB, BC, CA, A, B, C = range(7)
"""Parts of a triangle."""


@kernel
def nearest(p, a, b, c):
    """The part that the nearest point to p is on, and its weights w_b and w_c, between 0 and 1."""
    e, g = sub(b, a), sub(c, a)
    pa, pb, pc = sub(p, a), sub(p, b), sub(p, c)
    a1, a2 = dot(e, pa), dot(g, pa)
    if a1 <= 0.0 and a2 <= 0.0:
        return A, 0.0, 0.0
    b1, b2 = dot(e, pb), dot(g, pb)
    if b1 >= 0.0 and b2 <= b1:
        return B, 1.0, 0.0
    along_c = a1 * b2 - b1 * a2  # of p's weights where it is in the plane, but for a factor, that of c
    if along_c <= 0.0 and a1 >= 0.0 and b1 <= 0.0:
        return AB, a1 / (a1 - b1), 0.0
    c1, c2 = dot(e, pc), dot(g, pc)
    if c2 >= 0.0 and c1 <= c2:
        return C, 0.0, 1.0
    along_b = c1 * a2 - a1 * c2
    if along_b <= 0.0 and a2 >= 0.0 and c2 <= 0.0:
        return CA, 0.0, a2 / (a2 - c2)
    along_a = b1 * c2 - c1 * b2
    if along_a <= 0.0 and b2 >= b1 and c1 >= c2:
        share = (b2 - b1) / ((b2 - b1) + (c1 - c2))
        return BC, 1.0 - share, share
    whole = along_a + along_b + along_c
    return FACE, along_b / whole, along_c / whole


@kernel
def weighted(b, c, a_vector, b_vector, c_vector):
    """(1 − b − c) a_vector + b b_vector + c c_vector, for weights b and c of the second and third corner."""
    return fma(splat(c), c_vector, fma(splat(b), b_vector, mul(splat(1.0 - b - c), a_vector)))


@kernel
def weight_gradients(part, a, b, c):
    """∂w_b/∂p and ∂w_c/∂p where the nearest point is on this part."""
    e, g, none = sub(b, a), sub(c, a), splat(0.0)
    if part == FACE:
        ee, eg, gg = dot(e, e), dot(e, g), dot(g, g)
        whole = ee * gg - eg * eg
        by_b = sub(mul(splat(gg / whole), e), mul(splat(eg / whole), g))
        return by_b, sub(mul(splat(ee / whole), g), mul(splat(eg / whole), e))
    if part == AB:
        return mul(splat(1.0 / dot(e, e)), e), none
    if part == CA:
        return none, mul(splat(1.0 / dot(g, g)), g)
    if part == BC:
        side = sub(c, b)
        by_c = mul(splat(1.0 / dot(side, side)), side)
        return sub(none, by_c), by_c
    return none, none


@kernel
def edge(part, a, b, c):
    """The vector along the edge AB, BC or CA; that along AB for any other part."""
    if part == BC:
        return sub(c, b)
    if part == CA:
        return sub(a, c)
    return sub(b, a)


@kernel
def moved(by_b, by_c, dp, a_vector, b_vector, c_vector):
    """The change of a weighted mean of three vectors, for gradients of the weights and a change dp of the point."""
    db, dc = dot(by_b, dp), dot(by_c, dp)
    return add(mul(splat(db), sub(b_vector, a_vector)), mul(splat(dc), sub(c_vector, a_vector)))
