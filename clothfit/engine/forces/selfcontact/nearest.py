"""Closest points of a vertex and a triangle, or of two edges, and how they move with their four vertices.

The vector from one closest point to the other is

    r = Σ cᵢ yᵢ,    c = c⁰ + q₁ β₁ + q₂ β₂,

with the parameters q of the points in the triangle or on the edges: a vertex p and a triangle a b c have
r = p − a − q₁ (b − a) − q₂ (c − a), edges a b and e f have r = a + q₁ (b − a) − e − q₂ (f − e). Of the two parameters
two, one or none are free; the others are at a border. A free one, along β, has ε·r = 0 with ε = Σ βᵢ yᵢ. So where the
vertices move by dy, with ρ = Σ cᵢ dyᵢ and G = (ε_k·ε_l),

    G dq = −(ε_k·ρ + r·Σ β_ki dyᵢ),   dc = Σ dq_k β_k,   dr = ρ + Σ dq_k ε_k,   dδ = n·ρ,   dn = (I − n nᵀ) dr/δ

for the distance δ = ±|r| and the normal n = r/δ; δ < 0 means that the two have passed through each other since the
side was noted. The derivative of δ is therefore cᵢ n, without a derivative of c.

Two edges that are almost parallel have closest points that jump. The share of such a pair, `share`, goes to 0 there;
its vertices still touch triangles. Reference: C. Ericson, Real-time collision detection, 2005, section 5.1; M. Li et
al., Incremental potential contact, ACM Transactions on Graphics 39, 2020, section 5.1, on the share.
"""

from __future__ import annotations

from math import sqrt

import numpy as np

from clothfit.engine.forces import triangle
from clothfit.engine.forces.law import mixed, spread
from clothfit.kernels.kernel import kernel
from clothfit.kernels.lanes.operations import add, fma, load3, mul, splat, store3, sub
from clothfit.kernels.vectors import cross, dot

CORNER, EDGE = 0, 1
"""Kinds of a pair: a vertex and a triangle, two edges."""

NONE, FIRST, SECOND, BOTH, BETWEEN = 0, 1, 2, 3, 4
"""Which parameters are free; BETWEEN: along the side where q₁ + q₂ = 1."""

FREE_ON = (BOTH, FIRST, BETWEEN, SECOND, NONE, NONE, NONE)
"""The free parameters of the nearest point on each part of a triangle (`triangle`), in the order of these."""

PARALLEL = 0.01
"""sin² of the angle of two edges from which on their share is 1."""

ROUNDING = 1e-9
"""Distance relative to a way below which two parts meet: a search for where goes no finer."""

LEFT = 0.1
"""The part of a distance that must be left."""

SEAM = 1e-6
"""The part of the thickness below which what is apart at the start counts as a seam, which may pass through itself."""

SAMPLES = 1000
"""Times that a pair is looked at on its way, at most; one that is not through by then counts as passing."""


FIRST_EDGE, SECOND_EDGE = (-1.0, 1.0, 0.0, 0.0), (0.0, 0.0, -1.0, 1.0)
"""Weights of the vertices in the two edges of a pair."""


@kernel
def on_edges(a, b, e, f):
    """q₁, q₂ of the closest points of the edges a b and e f, and which of them are free."""
    one, other, away = sub(b, a), sub(f, e), sub(a, e)
    oo, tt, ot = dot(one, one), dot(other, other), dot(one, other)
    oa, ta = dot(one, away), dot(other, away)
    whole = oo * tt - ot * ot
    s = min(max((ot * ta - oa * tt) / whole, 0.0), 1.0) if whole > 0.0 else 0.0
    t = (ot * s + ta) / tt
    if t <= 0.0:
        t, s = 0.0, min(max(-oa / oo, 0.0), 1.0)
    elif t >= 1.0:
        t, s = 1.0, min(max((ot - oa) / oo, 0.0), 1.0)
    free = (FIRST if 0.0 < s < 1.0 else NONE) + (SECOND if 0.0 < t < 1.0 else NONE)
    return s, t, free


@kernel
def weights(kind, one, q1, q2):
    """c of a pair, where `one` is 1; its change with q, where that is 0."""
    if kind == CORNER:
        return one, q1 + q2 - one, -q1, -q2
    return one - q1, q1, q2 - one, -q2


@kernel
def ways(free):
    """How q₁ and q₂ go with the first free parameter, and q₂ with the second; 0 where fewer are free."""
    first = 1.0 if free in (FIRST, BOTH) else -1.0 if free == BETWEEN else 0.0
    return first, 1.0 if free in (SECOND, BETWEEN) else 0.0, 1.0 if free == BOTH else 0.0


@kernel
def closest(kind, own, y):
    """c, which parameters are free, and r, of the vertices `own` at y (n, 3)."""
    a, b, c, d = load3(y, own[0]), load3(y, own[1]), load3(y, own[2]), load3(y, own[3])
    if kind == CORNER:
        part, q1, q2 = triangle.nearest(a, b, c, d)
        free = FREE_ON[part]
    else:
        q1, q2, free = on_edges(a, b, c, d)
    found = weights(kind, 1.0, q1, q2)
    return found, free, mixed(found, own, y)


@kernel
def distance(kind, own, y):
    """|r|."""
    r = closest(kind, own, y)[2]
    return sqrt(dot(r, r))


@kernel
def passes(kind, own, x, after, thick, thickness):
    """Whether a pair with a thickness, of a cloth with the thickness `thick`, m, comes nearer on its way from x to
    `after` than a tenth of its distance or of `thick`.
    """
    delta, speed = distance(kind, own, x), past_each_other(kind, own, x, after)
    least = max(LEFT * min(delta, thick), ROUNDING * speed)
    if delta - speed > least:
        return False
    y, t = np.empty((4, 3)), 0.0
    corners = np.arange(4)
    for _ in range(SAMPLES):
        for e in range(4):
            way = sub(load3(after, own[e]), load3(x, own[e]))
            store3(add(load3(x, own[e]), mul(splat(t), way)), y, e)
        r = closest(kind, corners, y)[2]
        delta = sqrt(dot(r, r))
        if not delta > least:
            break
        t += (delta - 0.5 * least) / speed
        if t >= 1.0 or apart(kind, own, mul(splat(1.0 / delta), r), after) > least:
            return False
    return thickness > SEAM * thick


@kernel
def apart(kind, own, n, y):
    """How far the two of a pair are apart along a direction n (lanes) at y (n, 3), the first one before the other: on
    straight ways never nearer than at one of both ends.
    """
    low, high = 1e300, -1e300
    for e in range(4):
        place = dot(n, load3(y, own[e]))
        if e == 0 or (e == 1 and kind == EDGE):
            low = min(low, place)
        else:
            high = max(high, place)
    return low - high


@kernel
def past_each_other(kind, own, x, after):
    """How far the two of a pair move past each other at most, without what all four vertices do."""
    mean, one, other = splat(0.0), 0.0, 0.0
    for e in range(4):
        mean = add(mean, mul(splat(0.25), sub(load3(after, own[e]), load3(x, own[e]))))
    for e in range(4):
        way = sub(sub(load3(after, own[e]), load3(x, own[e])), mean)
        size = dot(way, way)
        if e == 0 or (e == 1 and kind == EDGE):
            one = max(one, size)
        else:
            other = max(other, size)
    return sqrt(one) + sqrt(other)


@kernel
def side(kind, own, y):
    """1 or −1: on which side of the triangle the vertex is, or of one edge the other."""
    a, b, c, d = load3(y, own[0]), load3(y, own[1]), load3(y, own[2]), load3(y, own[3])
    if kind == CORNER:
        return 1.0 if dot(sub(a, b), cross(sub(c, b), sub(d, b))) >= 0.0 else -1.0
    return 1.0 if dot(sub(a, c), cross(sub(b, a), sub(d, c))) >= 0.0 else -1.0


@kernel
def angle(own, y):
    """The edges of a pair of edges, their products o·o, t·t and o·t, and sin² of their angle relative to PARALLEL."""
    one, other = mixed(FIRST_EDGE, own, y), mixed(SECOND_EDGE, own, y)
    oo, tt, ot = dot(one, one), dot(other, other), dot(one, other)
    return one, other, oo, tt, ot, (1.0 - ot * ot / (oo * tt)) / PARALLEL


@kernel
def share(kind, own, y):
    """The share of a pair of edges, 1 of other pairs."""
    t = angle(own, y)[5] if kind == EDGE else 1.0
    return t * (2.0 - t) if t < 1.0 else 1.0


@kernel
def share_slopes(own, y):
    """The derivative of a share below 1 by the one edge and by the other."""
    one, other, oo, tt, ot, t = angle(own, y)
    # sin² = 1 − (a·b)²/(a² b²):  ∂/∂a = 2 (a·b)/(a² b²) ((a·b)/a² a − b)
    by_t = (2.0 - 2.0 * t) / PARALLEL * 2.0 * ot / (oo * tt)
    by_one = mul(splat(by_t), sub(mul(splat(ot / oo), one), other))
    return by_one, mul(splat(by_t), sub(mul(splat(ot / tt), other), one))


@kernel
def solve(g00, g01, g11, b0, b1):
    """G⁻¹ b for as many free parameters as there are: where one is missing, its row is 0."""
    if g11 == 0.0:
        return (b0 / g00 if g00 > 0.0 else 0.0), 0.0
    whole = g00 * g11 - g01 * g01
    return (g11 * b0 - g01 * b1) / whole, (g00 * b1 - g01 * b0) / whole


@kernel
def moved(kind, own, y, free, c, r, delta, n, dy):
    """dc, dn and dδ where the vertices move by dy (n, 3)."""
    first, second, other = ways(free)
    way0, way1 = weights(kind, 0.0, first, second), weights(kind, 0.0, 0.0, other)
    e0, e1, rho = mixed(way0, own, y), mixed(way1, own, y), mixed(c, own, dy)
    b0 = -dot(e0, rho) - dot(r, mixed(way0, own, dy))
    b1 = -dot(e1, rho) - dot(r, mixed(way1, own, dy))
    q0, q1 = solve(dot(e0, e0), dot(e0, e1), dot(e1, e1), b0, b1)
    dr = fma(splat(q0), e0, fma(splat(q1), e1, rho))
    dn = mul(splat(1.0 / delta), fma(splat(-dot(n, dr)), n, dr))
    dc = weights(kind, 0.0, q0 * first, q0 * second + q1 * other)
    return dc, dn, dot(n, rho)


@kernel
def add_moved_back(kind, own, y, free, c, r, delta, n, by_c, by_n, by_delta, scale, gy):
    """The transpose of `moved`: gy += scale · the gradient by y of what has these gradients by c, n and δ."""
    first, second, other = ways(free)
    way0, way1 = weights(kind, 0.0, first, second), weights(kind, 0.0, 0.0, other)
    e0, e1 = mixed(way0, own, y), mixed(way1, own, y)
    by_r = mul(splat(1.0 / delta), fma(splat(-dot(n, by_n)), n, by_n))
    b0 = dot(by_r, e0) + by_c[0] * way0[0] + by_c[1] * way0[1] + by_c[2] * way0[2] + by_c[3] * way0[3]
    b1 = dot(by_r, e1) + by_c[0] * way1[0] + by_c[1] * way1[1] + by_c[2] * way1[2] + by_c[3] * way1[3]
    m0, m1 = solve(dot(e0, e0), dot(e0, e1), dot(e1, e1), b0, b1)
    by_rho = fma(splat(by_delta), n, fma(splat(-m0), e0, fma(splat(-m1), e1, by_r)))
    spread(c, own, mul(splat(scale), by_rho), gy)
    spread(way0, own, mul(splat(-scale * m0), r), gy)
    spread(way1, own, mul(splat(-scale * m1), r), gy)


@kernel
def add_share_back(own, y, by_share, gy):
    """gy += by_share · the gradient by y of a share below 1."""
    one, other = share_slopes(own, y)
    spread(FIRST_EDGE, own, mul(splat(by_share), one), gy)
    spread(SECOND_EDGE, own, mul(splat(by_share), other), gy)


@kernel
def share_change(own, y, dy):
    """The change of a share below 1 where the vertices move by dy."""
    one, other = share_slopes(own, y)
    return dot(one, mixed(FIRST_EDGE, own, dy)) + dot(other, mixed(SECOND_EDGE, own, dy))
