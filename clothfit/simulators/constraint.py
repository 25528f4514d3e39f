"""What a constraint measures: a distance between two vertices, or the angle between two faces; their derivatives.

    distance:  C = |x₀ − x₁| − L,   n = (x₀ − x₁)/|x₀ − x₁|,   ∇₀C = n = −∇₁C
    angle:     C = θ − θ₀ of a hinge with ends x₀, x₁ and the vertices x₂, x₃ across it; θ is 0 where it is flat

With e = x₁ − x₀, a = x₂ − x₀, b = x₃ − x₀, the normals p = e × a, q = b × e, and the feet s = a·e/|e|², t = b·e/|e|²:

    θ = atan2((p × q)·e/|e|, p·q)
    ∇₂θ = −|e| p/|p|²,  ∇₃θ = −|e| q/|q|²,  ∇₀θ = −(1 − s) ∇₂θ − (1 − t) ∇₃θ,  ∇₁θ = −s ∇₂θ − t ∇₃θ

(R. Bridson, S. Marino, R. Fedkiw, *Simulation of clothing with folds and wrinkles*, 2003.) The second derivative H is
only needed times a change d (4, 3) of the vertices; it is symmetric, so one function serves tangent and adjoint.
Rows of `members` are the vertices of constraints; those of a distance end in −1, −1. Gradients are rows of (4, 3).
"""

from __future__ import annotations

from math import atan2, pi, sqrt

from clothfit.kernels.kernel import kernel
from clothfit.kernels.lanes.operations import add, fma, load3, mul, splat, store3, sub
from clothfit.kernels.vectors import cross, dot


@kernel
def size_of(members, c):
    """The number of vertices of constraint c: 2 or 4."""
    return 2 if members[c, 2] < 0 else 4


@kernel
def measure(members, rest, c, x, g):
    """Write ∇C to the rows of g; returns C, m or rad."""
    if members[c, 2] < 0:
        return distance(members, rest, c, x, g)
    return angle(members, rest, c, x, g)


@kernel
def distance(members, rest, c, x, g):
    """`measure` of a distance."""
    e = sub(load3(x, members[c, 0]), load3(x, members[c, 1]))
    length = sqrt(dot(e, e))
    n = mul(splat(1.0 / length if length > 0.0 else 0.0), e)
    store3(n, g, 0)
    store3(sub(splat(0.0), n), g, 1)
    return length - rest[c]


@kernel
def sides(members, c, x):
    """e, a and b of a hinge."""
    origin = load3(x, members[c, 0])
    e, a = sub(load3(x, members[c, 1]), origin), sub(load3(x, members[c, 2]), origin)
    return e, a, sub(load3(x, members[c, 3]), origin)


@kernel
def angle(members, rest, c, x, g):
    """`measure` of an angle."""
    e, a, b = sides(members, c, x)
    p, q = cross(e, a), cross(b, e)
    ee, pp, qq = dot(e, e), dot(p, p), dot(q, q)
    if ee == 0.0 or pp == 0.0 or qq == 0.0:  # a face without area bends nothing
        g[:] = 0.0
        return 0.0
    length = sqrt(ee)
    by_a, by_b = mul(splat(-length / pp), p), mul(splat(-length / qq), q)
    s, t = dot(a, e) / ee, dot(b, e) / ee
    store3(by_a, g, 2)
    store3(by_b, g, 3)
    store3(fma(splat(s - 1.0), by_a, mul(splat(t - 1.0), by_b)), g, 0)
    store3(fma(splat(-s), by_a, mul(splat(-t), by_b)), g, 1)
    found = atan2(dot(cross(p, q), e) / length, dot(p, q)) - rest[c]
    if found > pi:
        return found - 2.0 * pi
    if found < -pi:
        return found + 2.0 * pi
    return found


@kernel
def bend(members, c, x, d, out):
    """Write H d to the rows of `out`, for changes d of the vertices, both (4, 3)."""
    if members[c, 2] < 0:
        bend_distance(members, c, x, d, out)
    else:
        bend_angle(members, c, x, d, out)


@kernel
def bend_distance(members, c, x, d, out):
    """`bend` of a distance."""
    e = sub(load3(x, members[c, 0]), load3(x, members[c, 1]))
    length = sqrt(dot(e, e))
    inverse = 1.0 / length if length > 0.0 else 0.0
    n, de = mul(splat(inverse), e), sub(load3(d, 0), load3(d, 1))
    turn = mul(splat(inverse), fma(splat(-dot(n, de)), n, de))
    store3(turn, out, 0)
    store3(sub(splat(0.0), turn), out, 1)


@kernel
def bend_angle(members, c, x, d, out):
    """`bend` of an angle: the change of each line of `angle`."""
    e, a, b = sides(members, c, x)
    p, q = cross(e, a), cross(b, e)
    ee, pp, qq = dot(e, e), dot(p, p), dot(q, q)
    if ee == 0.0 or pp == 0.0 or qq == 0.0:
        out[:] = 0.0
        return
    length = sqrt(ee)
    origin = load3(d, 0)
    de, da, db = sub(load3(d, 1), origin), sub(load3(d, 2), origin), sub(load3(d, 3), origin)
    dp, dq = add(cross(de, a), cross(e, da)), add(cross(db, e), cross(b, de))
    along = dot(e, de)
    by_a, by_b = mul(splat(-length / pp), p), mul(splat(-length / qq), q)
    da_by = change_of_normal(by_a, p, pp, dp, length, along / ee)
    db_by = change_of_normal(by_b, q, qq, dq, length, along / ee)
    s, t = dot(a, e) / ee, dot(b, e) / ee
    ds = (dot(da, e) + dot(a, de) - 2.0 * s * along) / ee
    dt = (dot(db, e) + dot(b, de) - 2.0 * t * along) / ee
    store3(da_by, out, 2)
    store3(db_by, out, 3)
    first = fma(splat(ds), by_a, mul(splat(dt), by_b))
    store3(fma(splat(s - 1.0), da_by, fma(splat(t - 1.0), db_by, first)), out, 0)
    store3(sub(fma(splat(-s), da_by, mul(splat(-t), db_by)), first), out, 1)


@kernel
def change_of_normal(by, p, pp, dp, length, growth):
    """The change of −|e| p/|p|², which is `by`, for a change dp of p and a relative `growth` of |e|."""
    first = mul(splat(growth - 2.0 * dot(p, dp) / pp), by)
    return fma(splat(-length / pp), dp, first)
