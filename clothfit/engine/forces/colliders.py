"""Colliders that a cloth slides on, with friction: planes, round cones (capsules and spheres), boxes, closed meshes.

A vertex at the signed distance δ < d₀ from the surface (`surfaces`), d₀ the thickness, is at the depth d = d₀ − δ.
With the outward normal n, P = I − n nᵀ, the velocity V = ċ + W (y − c) of the collider at y, W p = ω × p + S p with
the rate S at which it stretches, and that of the vertex past it, v = u − V, it feels

    f = κ d n − γ P v,   γ = μ κ d / q,   q = sqrt(|P v|² + ε²),       K = −κ n nᵀ,   D = −γ P:

Coulomb's friction, of which the part |P v|/q acts at slow speeds. The step's model keeps γ as it is at (y, u),

    F = κ (d − n·s) n − γ P z,   z = w − V,

so that D is negative semi-definite and the step stable, however long it is. That γ lags behind costs μ h |g| of speed
where a vertex starts to slide, and nothing once its velocity stays, or with several Newton iterations.

With dV = W dy, and from `surfaces` and `bodies` dδ = n·dy and dn = H dy, H = k P + j t tᵀ:

    dq = v_t·(du − dV − (n·v) dn)/q, v_t = P v,    d(P z) = −P dV − (n·z) dn − (z·dn) n,

and by the parameters ∂F/∂μ = −(κ d/q) P z, ∂F/∂κ = (d − n·s) n − (μ d/q) P z, ∂F/∂c = −∂F/∂y.

The surface of a mesh may also go its own way, which is then a part of V and of dV. A linearised step also knows the
contacts with meshes that the vertex's way leads to (`touch.begins`), and those that it ends in (`meeting`), without
friction and with d < 0: so that none is deep in a body before it is pushed.
"""

from __future__ import annotations

from clothfit.engine.forces import touch
from clothfit.engine.forces.faces import add_along
from clothfit.engine.forces.meeting import counts
from clothfit.engine.forces.spheres import offset_of
from clothfit.engine.forces.touch import (
    FRICTION,
    LAW,
    SHAPE,
    STIFFNESS,
    across,
    contact,
    gamma_slope,
    held_change,
    slide,
)
from clothfit.engine.solve.sparse import add_block, outer
from clothfit.kernels.kernel import kernel
from clothfit.kernels.lanes.operations import add, fma, lane0, lane1, lane2, load3, mul, pack, splat, sub
from clothfit.kernels.vectors import dot


@kernel(empty=0.0, apart=0.0)
def energy(colliders, y):
    total = 0.0  # ½ κ d²
    for c in range(len(colliders.rows)):
        for i in range(len(y)):
            depth = max(contact(colliders, y, i, c)[0], 0.0)
            total += 0.5 * colliders.rows[c, LAW, STIFFNESS] * depth * depth
    return total


@kernel(absent=0.0)
def damping_power(colliders, y, u, w):
    total = 0.0
    for c in range(len(colliders.rows)):
        for i in range(len(y)):
            depth, _, _, n, _, spot = contact(colliders, y, i, c)
            if depth > 0.0:
                _, v, _, gamma = slide(colliders, y, u, i, c, depth, n, spot)
                total -= gamma * dot(across(n, v), load3(w, i))
    return total


@kernel(empty=None, apart=None)
def add_force(colliders, y, u, f):
    for c in range(len(colliders.rows)):
        for i in range(len(y)):
            depth, _, _, n, _, spot = contact(colliders, y, i, c)
            if depth > 0.0:
                _, v, _, gamma = slide(colliders, y, u, i, c, depth, n, spot)
                add_along(f, i, colliders.rows[c, LAW, STIFFNESS] * depth, n)
                add_along(f, i, -gamma, across(n, v))


@kernel(empty=None, apart=None)
def add_damping(colliders, y, u, scale, q, out):
    for c in range(len(colliders.rows)):
        for i in range(len(y)):
            depth, _, _, n, _, spot = contact(colliders, y, i, c)
            if depth > 0.0:
                gamma = slide(colliders, y, u, i, c, depth, n, spot)[3]
                add_along(out, i, -scale * gamma, across(n, load3(q, i)))


@kernel(empty=0.0, apart=0.0)
def add_step(colliders, y, u, h, ahead, A, b):
    stored, reach = 0.0, 0.0 if ahead else h
    for c in range(len(colliders.rows)):
        kappa = colliders.rows[c, LAW, STIFFNESS]
        for i in range(len(y)):
            depth, _, _, n, _, spot = contact(colliders, y, i, c)
            way = mul(splat(reach), load3(u, i))
            if counts(colliders, depth, n, c, i, load3(y, i), way):
                V, _, _, gamma = slide(colliders, y, u, i, c, depth, n, spot)
                rub = h * gamma
                low, high = outer(mul(splat(h * h * kappa - rub), n), n)
                low = add(low, pack(rub, 0.0, 0.0, 0.0))
                add_block(A.diagonal, i, low, add(high, pack(rub, 0.0, rub, 0.0)))
                if len(b) > 0:
                    stored += 0.5 * kappa * max(depth, 0.0) * depth
                    leaving = dot(n, load3(u, i)) if ahead else 0.0
                    add_along(b, i, h * kappa * (depth + h * leaving), n)
                    add_along(b, i, rub, across(n, V))
    return stored


@kernel(empty=None, apart=None)
def add_pullback(colliders, y, u, w, s, lam, h, grad, gy, gu):
    # φ/h = κ (d − σ) ν − γ π,  ν = n·λ,  σ = n·s,  π = λ·P z;  dγ = −μκ/q dδ − γ/q dq
    for c in range(len(colliders.rows)):
        own, kappa = colliders.rows[c], colliders.rows[c, LAW, STIFFNESS]
        for i in range(len(y)):
            depth, k, j, n, t, spot = contact(colliders, y, i, c)
            way = fma(splat(h), sub(load3(u, i), load3(w, i)), load3(s, i))  # h u where the step begins at y, else 0
            if counts(colliders, depth, n, c, i, load3(y, i), way):
                V, v, q, gamma = slide(colliders, y, u, i, c, depth, n, spot)
                lam_i, s_i, z = load3(lam, i), load3(s, i), sub(load3(w, i), V)
                nu, push = dot(n, lam_i), kappa * (depth - dot(n, s_i))
                pi = dot(lam_i, z) - nu * dot(n, z)
                by_u = mul(splat(gamma * pi / (q * q)), across(n, v))
                by_v = sub(mul(splat(gamma), across(n, lam_i)), by_u)  # by V
                by_n = fma(splat(-kappa * nu), s_i, mul(splat(push + gamma * dot(n, z)), lam_i))
                by_n = fma(splat(gamma * nu), z, fma(splat(-dot(n, v)), by_u, by_n))
                by_y = fma(splat(k), across(n, by_n), mul(splat(j * dot(t, by_n)), t))
                by_y = add(by_y, touch.surface_gradient(colliders.bodies, own, spot, by_v))
                by_delta = gamma_slope(gamma, depth) * pi - kappa * nu
                by_y = fma(splat(by_delta), n, by_y)
                add_along(gy, i, h, by_y)
                add_along(gu, i, h, by_u)
                rub = max(depth, 0.0) / q * pi
                if len(grad.friction) > 0:
                    grad.friction[c] -= h * kappa * rub
                if len(grad.contact) > 0:
                    grad.contact[c] += h * (push / kappa * nu - own[LAW, FRICTION] * rub)
                if len(grad.offset) > 0:
                    grad.offset[0] -= h * lane0(by_y)
                    grad.offset[1] -= h * lane1(by_y)
                    grad.offset[2] -= h * lane2(by_y)
                    if len(colliders.begin) > 0:
                        for axis in range(3):  # what is held begins deeper
                            grad.offset[axis] += h * by_delta * own[SHAPE, 2] * colliders.begin[c, i, 1 + axis]


@kernel(empty=None, apart=None)
def add_pushforward(colliders, y, u, w, s, dy, du, direction, h, out):
    offset = offset_of(direction)
    for c in range(len(colliders.rows)):
        own, kappa = colliders.rows[c], colliders.rows[c, LAW, STIFFNESS]
        dmu = direction.friction[c] if len(direction.friction) > 0 else 0.0
        dkappa = direction.contact[c] if len(direction.contact) > 0 else 0.0
        for i in range(len(y)):
            depth, k, j, n, t, spot = contact(colliders, y, i, c)
            way = fma(splat(h), sub(load3(u, i), load3(w, i)), load3(s, i))  # h u where the step begins at y, else 0
            if counts(colliders, depth, n, c, i, load3(y, i), way):
                V, v, q, gamma = slide(colliders, y, u, i, c, depth, n, spot)
                dy_i, s_i, z = sub(load3(dy, i), offset), load3(s, i), sub(load3(w, i), V)
                dn = fma(splat(k), across(n, dy_i), mul(splat(j * dot(t, dy_i)), t))
                ddelta = dot(n, dy_i) + held_change(colliders, c, i, offset)
                dV = touch.surface_change(colliders.bodies, own, spot, dy_i)
                change = sub(sub(load3(du, i), dV), mul(splat(dot(n, v)), dn))
                dq = dot(across(n, v), change) / q
                dgamma = -gamma_slope(gamma, depth) * ddelta - gamma / q * dq
                dgamma += (dmu * kappa + own[LAW, FRICTION] * dkappa) * max(depth, 0.0) / q
                dpz = fma(splat(-dot(n, z)), dn, mul(splat(-1.0), across(n, dV)))
                dpz = fma(splat(-dot(z, dn)), n, dpz)
                add_along(out, i, h * kappa * (depth - dot(n, s_i)), dn)
                add_along(out, i, -h * kappa * (ddelta + dot(dn, s_i)), n)
                add_along(out, i, h * dkappa * (depth - dot(n, s_i)), n)
                add_along(out, i, -h * dgamma, across(n, z))
                add_along(out, i, -h * gamma, dpz)
