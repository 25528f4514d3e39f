"""The parts of a substep of XPBD, which `directions` takes: predict, correct by all constraints in turn some times
over, take the velocity from the way.

With h the substep, f the drag of the air at (x, v), α the damping of the vertices:

    v* = v / (1 + h α) + h (g + w f),   y = x + h v*,   y ← corrected `iterations` times,   x⁺ = y,   v⁺ = (y − x)/h

Pins go to their places. Wind, gravity, spheres and pins at a substep are between their values before and after the
step. (M. Macklin et al., *Small steps in physics simulation*, 2019: many substeps of one iteration converge faster
than the reverse.)

A correction moves the vertices of a constraint towards it, as far as its compliance lets them.

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
from typing import NamedTuple

import numpy as np

from clothfit.base.arrays import Array, Flags, Indices
from clothfit.engine.forces import faces, wind
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


class Model(NamedTuple):
    """A cloth of n vertices and K constraints, as XPBD has it, in a world of R spheres over T steps."""

    x0: Array  # (n, 3), m, at the start
    v0: Array  # (n, 3), m/s
    free: Flags  # (n,), what is not fixed
    inverse: Array  # (n,), 1/kg, inverse masses, 0 where fixed
    members: Indices  # (K, 4), vertices; of distances the last two are −1
    rest: Array  # (K,), m or rad
    compliance: Array  # (K,), m/N, of angles rad²/J
    time: Array  # (K,), s
    relaxation: Array  # (K,), of corrections
    damping: Array  # (n,), 1/s
    faces: faces.Faces  # that feel the air; its wind is that of the substep
    radius: Array  # (R,), m
    contact: float  # m/N, compliance of contacts
    wind: Array  # (T + 1, 3), m/s
    gravity: Array  # (T + 1, 3), m/s²
    centre: Array  # (T + 1, R, 3), m
    path: Array  # (T + 1, P, 3), m, of the pins
    pins: Indices  # (P,)
    h: float  # s, a step
    substeps: int
    iterations: int


class Work(NamedTuple):
    """Scratch space for one model."""

    start: Array  # (n, 3), x before the substep
    force: Array  # (n, 3)
    still: Array  # (n, 3), zeros
    local: Array  # (3, 4, 3)
    normal: Array  # (3,)
    multiplier: Array  # (K,)
    pressing: Array  # (R, n)
    gravity: Array  # (3,)
    centre: Array  # (R, 3)


def workspace(model: Model) -> Work:
    """Scratch space for a model."""
    n, count, spheres = len(model.x0), len(model.rest), len(model.radius)
    start, force, still = np.zeros((3, n, 3))
    return Work(start, force, still, np.zeros((3, 4, 3)), np.zeros(3), np.zeros(count), np.zeros((spheres, n)),
                np.zeros(3), np.zeros((spheres, 3)))


@kernel
def set_world(model, t, s, work):
    """Write the world at the end of substep s of step t to where it is read; returns the part of the step that is over.
    """
    part = (s + 1.0) / model.substeps
    for j in range(3):
        model.faces.wind[j] = model.wind[t, j] + part * (model.wind[t + 1, j] - model.wind[t, j])
        work.gravity[j] = model.gravity[t, j] + part * (model.gravity[t + 1, j] - model.gravity[t, j])
        for c in range(len(model.radius)):
            work.centre[c, j] = model.centre[t, c, j] + part * (model.centre[t + 1, c, j] - model.centre[t, c, j])
    return part


@kernel
def predict(model, t, s, x, v, work):
    """Write v* to v and y to x, and x before that to `start`."""
    part, h = set_world(model, t, s, work), model.h / model.substeps
    work.force[:] = 0.0
    wind.add_force(model.faces, x, v, work.force)
    for i in range(len(x)):
        slow = 1.0 / (1.0 + h * model.damping[i])
        for j in range(3):
            work.start[i, j] = x[i, j]
            if model.free[i]:
                v[i, j] = slow * v[i, j] + h * (work.gravity[j] + model.inverse[i] * work.force[i, j])
                x[i, j] += h * v[i, j]
    for k in range(len(model.pins)):
        for j in range(3):
            x[model.pins[k], j] = model.path[t, k, j] + part * (model.path[t + 1, k, j] - model.path[t, k, j])


@kernel
def finish(model, x, v, work):
    """Write v⁺ to v."""
    h = model.h / model.substeps
    for i in range(len(x)):
        for j in range(3):
            v[i, j] = (x[i, j] - work.start[i, j]) / h
