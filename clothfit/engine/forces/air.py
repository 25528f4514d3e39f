"""The law "air" of the faces: the pressure and the friction of real air, whatever the mesh.

Face (a, b, c) of area A and unit normal N, moving at the mean velocity ū of its corners in the wind W; w = W − ū,
v = N·w, ω = |w|, and w_t = w − v N along the face. The air pushes it with

    ϱ/2 · A · c (|v| v N + r ω w_t),    ϱ = 1.2 kg/m³, c the drag coefficient, r = 0.02,

a third for each corner. c has no unit: a square plate that faces the wind has 1.17, a long strip 2.0 (Hoerner,
Fluid-Dynamic Drag, 1965, 3-3), and r c is the skin friction on both sides together, 0.01 of a smooth plate at Reynolds
numbers of 10⁵ (2-5) and some times that of woven cloth. Faces of one velocity may be divided: N and w are the same for
all their parts, and the areas add up. The step takes for each corner, as if all three moved alike, with
κ = c ϱ/12 and s = |n| = 2 A,

    f = κ s (|v| v N + r ω w_t),    D = −κ s (P N Nᵀ + Q 1),    P = 2 √(v² + ε²) − Q,  Q = r √(ω² + ε²),   K = 0,

which is symmetric and negative semidefinite. Left out of the true Jacobian by velocities: what a change of w does to ω,
r w_t wᵀ/ω, which is small and not symmetric, and that by positions, as in the editor's law. f has continuous first
derivatives, and with ε = 1 mm/s so has D. On a face without area nothing acts and nothing depends on its corners.

With Λ = Σ λ_i, and per vertex θ_i = N·(w_i − u_i), ν_i = N·λ_i, T = Σ ν_i θ_i, E = Σ λ_i·(w_i − u_i):

    φ = h κ s Ψ,   Ψ = (|v| − r ω) v N·Λ + r ω w·Λ − P T − Q E.
"""

from __future__ import annotations

from math import sqrt

from clothfit.engine.forces.faces import add_along, add_by_normal, at, change_of_normal, drag_of, edges, mean, relative
from clothfit.engine.solve.sparse import XX, YY, ZZ, add_block, outer
from clothfit.kernels.kernel import kernel
from clothfit.kernels.lanes.operations import add, fma, lane0, lane1, lane2, load3, mul, splat, sub
from clothfit.kernels.vectors import cross, dot, item, vector
from clothfit.scene.kinds import AIR_DENSITY

RATIO = 0.02
"""r."""

SLOW2 = 1e-6
"""ε², m²/s²."""

SHARE = AIR_DENSITY / 12.0
"""κ of a drag coefficient of 1, kg/m³."""


@kernel
def state(faces, y, u, i):
    """N, s, w, v and ω of face i; N is 0 where s is."""
    p, q = edges(faces, y, i)
    n = cross(p, q)
    size = sqrt(dot(n, n))
    unit = mul(splat(1.0 / size if size > 0.0 else 0.0), n)
    flow = relative(faces, u, i)
    return unit, size, flow, dot(unit, flow), sqrt(dot(flow, flow))


@kernel
def slopes(v, omega):
    """√(v² + ε²), √(ω² + ε²), P and Q."""
    sigma, root = sqrt(v * v + SLOW2), sqrt(omega * omega + SLOW2)
    return sigma, root, 2.0 * sigma - RATIO * root, RATIO * root


@kernel
def push(unit, flow):
    """|v| v N + r ω w_t, of which N and w are given."""
    v, omega = dot(unit, flow), sqrt(dot(flow, flow))
    return fma(splat((abs(v) - RATIO * omega) * v), unit, mul(splat(RATIO * omega), flow))


@kernel(apart=(0.0, 0.0))
def powers(faces, y, u, w):
    """f·w, W, in its two parts: the push of the wind on a cloth that is still, and what its own velocity changes."""
    wind, drag = 0.0, 0.0
    for i in range(len(faces.corners)):
        unit, size, flow, _, _ = state(faces, y, u, i)
        along = mul(splat(3.0 * SHARE * drag_of(faces, i) * size), mean(faces, w, i))
        still = dot(along, push(unit, vector(faces.wind)))
        wind += still
        drag += dot(along, push(unit, flow)) - still
    return wind, drag


@kernel(apart=None)
def add_force(faces, y, u, f):
    for i in range(len(faces.corners)):
        unit, size, flow, _, _ = state(faces, y, u, i)
        pushed = push(unit, flow)
        for corner in range(3):
            add_along(f, faces.corners[i, corner], SHARE * drag_of(faces, i) * size, pushed)


@kernel(apart=None)
def add_damping(faces, y, u, scale, q, out):
    for i in range(len(faces.corners)):
        unit, size, _, v, omega = state(faces, y, u, i)
        _, _, P, Q = slopes(v, omega)
        c = -scale * SHARE * drag_of(faces, i) * size
        for corner in range(3):
            j = faces.corners[i, corner]
            q_j = load3(q, j)
            add_along(out, j, c * P * dot(q_j, unit), unit)
            add_along(out, j, c * Q, q_j)


@kernel(apart=None)
def add_step(faces, y, u, h, ahead, A, b):
    for i in range(len(faces.corners)):
        unit, size, flow, v, omega = state(faces, y, u, i)
        _, _, P, Q = slopes(v, omega)
        c = h * SHARE * drag_of(faces, i) * size
        P, Q = c * P, c * Q
        low, high = outer(mul(splat(P), unit), unit)
        for corner in range(3):
            j = faces.corners[i, corner]
            add_block(A.diagonal, j, low, high)
            A.diagonal[j, XX] += Q
            A.diagonal[j, YY] += Q
            A.diagonal[j, ZZ] += Q
        if len(b) > 0:
            pushed = mul(splat(c), push(unit, flow))
            for corner in range(3):
                j = faces.corners[i, corner]
                u_j = load3(u, j)
                add_along(b, j, 1.0, fma(splat(P * dot(u_j, unit)), unit, fma(splat(Q), u_j, pushed)))


@kernel(apart=None)
def add_pullback(faces, y, u, w, s, lam, h, grad, gy, gu):
    for i in range(len(faces.corners)):
        unit, size, flow, v, omega = state(faces, y, u, i)
        if size == 0.0:
            continue
        sigma, root, P, Q = slopes(v, omega)
        rub = RATIO * omega
        a, b, c = at(lam, faces, i)
        lam_sum = add(add(a, b), c)  # Λ
        total, along, T, E = dot(unit, lam_sum), dot(flow, lam_sum), 0.0, 0.0
        g = mul(splat((abs(v) - rub) * v), lam_sum)  # ∂Ψ/∂N at fixed w
        for corner in range(3):
            j = faces.corners[i, corner]
            lam_j, change = load3(lam, j), sub(load3(w, j), load3(u, j))
            nu, theta = dot(unit, lam_j), dot(unit, change)
            T += nu * theta
            E += dot(lam_j, change)
            g = fma(splat(-P * theta), lam_j, fma(splat(-P * nu), change, g))
        value = (abs(v) - rub) * v * total + rub * along - P * T - Q * E  # Ψ
        by_v = (2.0 * abs(v) - rub) * total - 2.0 * v / sigma * T
        g = fma(splat(by_v), flow, g)
        by_flow = fma(splat(by_v), unit, mul(splat(rub), lam_sum))
        if omega > 0.0:
            by_omega = RATIO * (along - v * total + omega / root * (T - E))
            by_flow = fma(splat(by_omega / omega), flow, by_flow)
        scale = h * SHARE * drag_of(faces, i)
        by_flow = mul(splat(scale * size), by_flow)
        for corner in range(3):
            j = faces.corners[i, corner]
            lam_j = load3(lam, j)
            add_along(gu, j, scale * size * P * dot(unit, lam_j), unit)
            add_along(gu, j, scale * size * Q, lam_j)
            add_along(gu, j, -1.0 / 3.0, by_flow)
        if len(grad.drag) > 0:
            grad.drag[item(faces.object, i)] += h * SHARE * size * value
        if len(grad.wind) > 0:
            grad.wind[0] += lane0(by_flow)
            grad.wind[1] += lane1(by_flow)
            grad.wind[2] += lane2(by_flow)
        g = fma(splat(value - dot(unit, g)), unit, g)  # ∂(s Ψ)/∂n = Ψ N + (1 − N Nᵀ) ∂Ψ/∂N
        add_by_normal(gy, faces, y, i, mul(splat(scale), g))


@kernel(apart=None)
def add_pushforward(faces, y, u, w, s, dy, du, direction, h, out):
    # F_j = κ s [(|v| v − r ω v − P θ_j) N + r ω w − Q (w_j − u_j)]: the product rule over κ s, v, ω, N and w.
    for i in range(len(faces.corners)):
        unit, size, flow, v, omega = state(faces, y, u, i)
        if size == 0.0:
            continue
        sigma, root, P, Q = slopes(v, omega)
        rub = RATIO * omega
        dn = change_of_normal(faces, y, dy, i)
        grown = dot(unit, dn)
        dunit = mul(splat(1.0 / size), fma(splat(-grown), unit, dn))
        dflow = mul(splat(-1.0), mean(faces, du, i))
        if len(direction.wind) > 0:
            dflow = add(dflow, vector(direction.wind))
        dv, domega = dot(dunit, flow) + dot(unit, dflow), dot(flow, dflow) / omega if omega > 0.0 else 0.0
        drub, dQ = RATIO * domega, RATIO * omega / root * domega
        dP = 2.0 * v / sigma * dv - dQ
        through = (abs(v) - rub) * v
        dthrough = (2.0 * abs(v) - rub) * dv - drub * v
        scale = h * SHARE * drag_of(faces, i) * size
        dscale = h * SHARE * drag_of(faces, i) * grown
        if len(direction.drag) > 0:
            dscale += h * SHARE * size * direction.drag[item(faces.object, i)]
        for corner in range(3):
            j = faces.corners[i, corner]
            du_j, change = load3(du, j), sub(load3(w, j), load3(u, j))
            theta = dot(unit, change)
            dtheta = dot(dunit, change) - dot(unit, du_j)
            normal = dscale * (through - P * theta) + scale * (dthrough - dP * theta - P * dtheta)
            add_along(out, j, normal, unit)
            add_along(out, j, scale * (through - P * theta), dunit)
            add_along(out, j, dscale * rub + scale * drub, flow)
            add_along(out, j, scale * rub, dflow)
            add_along(out, j, -dscale * Q - scale * dQ, change)
            add_along(out, j, scale * Q, du_j)
