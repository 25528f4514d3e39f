"""One correction of XPBD: moves the vertices of a constraint towards it, as far as its compliance lets them.

With C and ∇C at x, the multiplier λ, the inverse masses w, the places p before the substep of h, and

    α̃ = (compliance)/h²,  γ = τ/h,  τ the time of the constraint's damping (damping coefficient times compliance)

    Δ = −(C + α̃ λ + γ ∇C·(x − p)) / ((1 + γ) Σ wᵢ |∇ᵢC|² + α̃),   λ⁺ = λ + ω Δ,   xᵢ⁺ = xᵢ + wᵢ ∇ᵢC ω Δ

(M. Macklin, M. Müller, N. Chentanez, *XPBD*, 2016, eq. 26), with a relaxation ω between 0 and 2, as in successive
over-relaxation: where the directions ∇C stay, the iterations end at the same place, sooner or later (D. Young,
*Iterative solution of large linear systems*, 1971). Without one ω is 1. A sphere is a constraint |x − c| − r ≥ 0 of
each vertex, whose multiplier stays at least 0.

A constraint measures a distance between two vertices, or the angle between two faces:

    distance:  C = |x₀ − x₁| − L,   n = (x₀ − x₁)/|x₀ − x₁|,   ∇₀C = n = −∇₁C
    angle:     C = θ − θ₀ of a hinge with ends x₀, x₁ and the vertices x₂, x₃ across it; θ is 0 where it is flat

With e = x₁ − x₀, a = x₂ − x₀, b = x₃ − x₀, the normals p = e × a, q = b × e, and the feet s = a·e/|e|², t = b·e/|e|²:

    θ = atan2((p × q)·e/|e|, p·q)
    ∇₂θ = −|e| p/|p|²,  ∇₃θ = −|e| q/|q|²,  ∇₀θ = −(1 − s) ∇₂θ − (1 − t) ∇₃θ,  ∇₁θ = −s ∇₂θ − t ∇₃θ

(R. Bridson, S. Marino, R. Fedkiw, *Simulation of clothing with folds and wrinkles*, 2003.) The second derivative H
is only needed times a change d (4, 3) of the vertices. Rows of `members` are the vertices of constraints; those of a
distance end in −1, −1. Gradients are rows of (4, 3).
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



@kernel
def factors(model, c, h):
    """α̃ and γ of constraint c."""
    return model.compliance[c] / (h * h), model.time[c] / h


@kernel
def parts(model, c, h, x, p, multiplier, g):
    """Write ∇C to g; returns Δ, its denominator, ∇C·(x − p) and Σ w |∇C|²; Δ is 0 where nothing can move."""
    stiff, gamma = factors(model, c, h)
    value = measure(model.members, model.rest, c, x, g)
    slide, weight = 0.0, 0.0
    for k in range(size_of(model.members, c)):
        i = model.members[c, k]
        square = 0.0
        for j in range(3):
            square += g[k, j] * g[k, j]
            slide += g[k, j] * (x[i, j] - p[i, j])
        weight += model.inverse[i] * square
    below = (1.0 + gamma) * weight + stiff
    if not below > 0.0 or weight == 0.0:
        return 0.0, 0.0, slide, weight
    return -(value + stiff * multiplier + gamma * slide) / below, below, slide, weight


@kernel
def project(model, c, h, x, p, multiplier, g):
    """Correct x by constraint c; returns λ⁺."""
    change = model.relaxation[c] * parts(model, c, h, x, p, multiplier, g)[0]
    for k in range(size_of(model.members, c)):
        i = model.members[c, k]
        for j in range(3):
            x[i, j] += model.inverse[i] * g[k, j] * change
    return multiplier + change


@kernel
def gap(centre, radius, x, i, n):
    """Write the outward normal of vertex i at a sphere to n (3,); returns the gap, m, and the distance to the centre,
    infinite at the centre itself, whose normal is up.
    """
    for j in range(3):
        n[j] = x[i, j] - centre[j]
    distance = sqrt(n[0] * n[0] + n[1] * n[1] + n[2] * n[2])
    if distance == 0.0:
        n[0], n[1], n[2] = 0.0, 1.0, 0.0
        return -radius, float("inf")
    for j in range(3):
        n[j] /= distance
    return distance - radius, distance


@kernel
def push_out(stiff, inverse, depth, multiplier):
    """Δ of a contact of gap `depth`, and whether it presses after that."""
    change = -(depth + stiff * multiplier) / (inverse + stiff)
    if multiplier + change > 0.0:
        return change, True
    return -multiplier, False


@kernel
def touch(stiff, inverse, centre, radius, x, i, multiplier, n):
    """Correct vertex i by its contact with a sphere; returns λ⁺."""
    depth, _ = gap(centre, radius, x, i, n)
    change, _ = push_out(stiff, inverse, depth, multiplier)
    for j in range(3):
        x[i, j] += inverse * n[j] * change
    return multiplier + change
