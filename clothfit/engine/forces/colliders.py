"""Colliders that a cloth slides on, with friction: planes, round cones (capsules and spheres), boxes, closed meshes.

A vertex at the signed distance δ < d₀ from the surface (`surfaces`), d₀ the thickness, is at the depth d = d₀ − δ. With
the outward normal n and the velocity V = ċ + W (y − c) of the collider at y, W p = ω × p + S p with the rate S at which
it stretches, it feels what `law` says for U = u − V, S = s and Z = w − V. There dV = W dy, from `surfaces` and `bodies`
dδ = n·dy and dn = H dy, H = k P + j t tᵀ, and ∂F/∂c = −∂F/∂y.

The surface of a mesh may also go its own way, which is then a part of V and of dV. A linearised step also knows the
contacts that the vertex's way leads to (`touch.counts`), and those that it ends in (`meeting`), without
friction and with d < 0: so that none is deep in a body before it is pushed.
"""

from __future__ import annotations

from clothfit.engine.forces import law
from clothfit.engine.forces.faces import add_along
from clothfit.engine.forces.law import across, rubbing
from clothfit.engine.forces.spheres import offset_of
from clothfit.engine.forces.touch import (
    FRICTION,
    LAW,
    SHAPE,
    STIFFNESS,
    contact,
    counts,
    held_change,
    leaving,
    surface_change,
    surface_gradient,
    surface_velocity,
)
from clothfit.engine.solve.sparse import add_block
from clothfit.kernels.kernel import kernel
from clothfit.kernels.lanes.operations import add, fma, lane0, lane1, lane2, load3, mul, splat, sub
from clothfit.kernels.vectors import dot


@kernel
def pressing(colliders, y, u, i, c):
    """The push κ d, γ, n and U of vertex i at collider c; 0 where it is outside."""
    depth, _, _, n, _, spot = contact(colliders, y, i, c)
    push, gamma, U = colliders.rows[c, LAW, STIFFNESS] * max(depth, 0.0), 0.0, splat(0.0)
    if push > 0.0:
        U = sub(load3(u, i), surface_velocity(colliders, y, i, c, spot))
        gamma = rubbing(push, colliders.rows[c, LAW, FRICTION], n, U)[1]
    return push, gamma, n, U


@kernel
def met(colliders, y, u, w, s, h, i, c):
    """Whether a step that goes by s from y, at last with w for u, knows of vertex i at collider c; its `contact`."""
    depth, k, j, n, t, spot = contact(colliders, y, i, c)
    way = fma(splat(h), sub(load3(u, i), load3(w, i)), load3(s, i))  # h u where the step begins at y, else 0
    return counts(colliders, depth, n, c, i, load3(y, i), way), depth, k, j, n, t, spot


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
            _, gamma, n, U = pressing(colliders, y, u, i, c)
            total -= gamma * dot(across(n, U), add(U, sub(load3(w, i), load3(u, i))))  # past the collider
    return total


@kernel(empty=0.0, apart=0.0)
def power(colliders, y, u, w, s, h, begin, f):
    """What colliders that move do at the end of a step, W, by the forces of its model, which are added to f; `begin`
    has when it begins and how long it is, s, h what its model takes for that.
    """
    total = 0.0
    for c in range(len(colliders.rows)):
        own = colliders.rows[c]
        for i in range(len(y)):
            there, depth, _, _, n, _, spot = met(colliders, y, u, w, s, h, i, c)
            if there:
                V, kappa = surface_velocity(colliders, y, i, c, spot), own[LAW, STIFFNESS]
                gamma = rubbing(kappa * depth, own[LAW, FRICTION], n, sub(load3(u, i), V))[1]
                push = kappa * (depth - dot(n, load3(s, i)))
                T = law.force(push, gamma, n, sub(load3(w, i), V))
                add_along(f, i, 1.0, T)
                total += dot(T, V) + push * leaving(colliders, c, i, begin[0], begin[1])
    return total


@kernel(empty=None, apart=None)
def add_force(colliders, y, u, f):
    for c in range(len(colliders.rows)):
        for i in range(len(y)):
            push, gamma, n, U = pressing(colliders, y, u, i, c)
            if push > 0.0:
                add_along(f, i, 1.0, law.force(push, gamma, n, U))


@kernel(empty=None, apart=None)
def add_damping(colliders, y, u, scale, q, out):
    for c in range(len(colliders.rows)):
        for i in range(len(y)):
            _, gamma, n, _ = pressing(colliders, y, u, i, c)
            if gamma > 0.0:
                add_along(out, i, -scale * gamma, across(n, load3(q, i)))


@kernel(empty=0.0, apart=0.0)
def add_step(colliders, y, u, h, ahead, A, b):
    stored, reach = 0.0, 0.0 if ahead else h
    for c in range(len(colliders.rows)):
        kappa, mu = colliders.rows[c, LAW, STIFFNESS], colliders.rows[c, LAW, FRICTION]
        for i in range(len(y)):
            depth, _, _, n, _, spot = contact(colliders, y, i, c)
            colliders.depth[c, i] = depth
            if counts(colliders, depth, n, c, i, load3(y, i), mul(splat(reach), load3(u, i))):
                V = surface_velocity(colliders, y, i, c, spot)
                rub = h * rubbing(kappa * depth, mu, n, sub(load3(u, i), V))[1]
                low, high = law.block(h * h * kappa, rub, n)
                add_block(A.diagonal, i, low, high)
                if len(b) > 0:
                    stored += 0.5 * kappa * max(depth, 0.0) * depth
                    leaving = dot(n, load3(u, i)) if ahead else 0.0
                    add_along(b, i, 1.0, law.force(h * kappa * (depth + h * leaving), -rub, n, V))
    return stored


@kernel(empty=None, apart=None)
def add_pullback(colliders, y, u, w, s, lam, h, grad, gy, gu):
    for c in range(len(colliders.rows)):
        own = colliders.rows[c]
        for i in range(len(y)):
            there, depth, k, j, n, t, spot = met(colliders, y, u, w, s, h, i, c)
            if there:
                V = surface_velocity(colliders, y, i, c, spot)
                row = own[LAW, STIFFNESS], own[LAW, FRICTION], depth, n, sub(load3(u, i), V)
                vectors, (by_delta, by_mu, by_kappa) = law.pull(row, load3(s, i), sub(load3(w, i), V), load3(lam, i))
                by_n, by_U, _, by_Z, _ = vectors
                by_y = fma(splat(k), across(n, by_n), mul(splat(j * dot(t, by_n)), t))
                by_y = sub(by_y, surface_gradient(colliders.bodies, own, spot, add(by_U, by_Z)))
                by_y = fma(splat(by_delta), n, by_y)
                add_along(gy, i, h, by_y)
                add_along(gu, i, h, by_U)
                if len(grad.friction) > 0:
                    grad.friction[c] += h * by_mu
                if len(grad.contact) > 0:
                    grad.contact[c] += h * by_kappa
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
        own = colliders.rows[c]
        dmu = direction.friction[c] if len(direction.friction) > 0 else 0.0
        dkappa = direction.contact[c] if len(direction.contact) > 0 else 0.0
        for i in range(len(y)):
            there, depth, k, j, n, t, spot = met(colliders, y, u, w, s, h, i, c)
            if there:
                V, dy_i = surface_velocity(colliders, y, i, c, spot), sub(load3(dy, i), offset)
                row = own[LAW, STIFFNESS], own[LAW, FRICTION], depth, n, sub(load3(u, i), V)
                dn = fma(splat(k), across(n, dy_i), mul(splat(j * dot(t, dy_i)), t))
                ddelta = dot(n, dy_i) + held_change(colliders, c, i, offset)
                dV = surface_change(colliders.bodies, own, spot, dy_i)
                moved = dn, ddelta, sub(load3(du, i), dV), splat(0.0), sub(splat(0.0), dV)
                dT = law.change(row, load3(s, i), sub(load3(w, i), V), moved, dmu, dkappa)[1]
                add_along(out, i, h, dT)
