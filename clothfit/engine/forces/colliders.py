"""Colliders that a cloth slides on, with friction: planes, round cones (capsules and spheres), boxes; some move.

A vertex at the signed distance δ < d₀ from the surface (`surfaces`), d₀ the thickness, is at the depth d = d₀ − δ.
With the outward normal n, P = I − n nᵀ, the velocity V = ċ + ω × (y − c) of the collider at y, and that of the vertex
past it, v = u − V, it feels

    f = κ d n − γ P v,   γ = μ κ d / q,   q = sqrt(|P v|² + ε²),       K = −κ n nᵀ,   D = −γ P:

Coulomb's friction, of which the part |P v|/q acts at slow speeds. The step's model keeps γ as it is at (y, u),

    F = κ (d − n·s) n − γ P z,   z = w − V,

so that D is negative semi-definite and the step stable, however long it is. That γ lags behind costs μ h |g| of speed
where a vertex starts to slide, and nothing once its velocity stays, or with several Newton iterations.

With dV = ω × dy, and from `surfaces` dδ = n·dy and dn = H dy, H = k P + j t tᵀ:

    dq = v_t·(du − dV − (n·v) dn)/q, v_t = P v,    d(P z) = −P dV − (n·z) dn − (z·dn) n.
"""

from __future__ import annotations

from math import sqrt
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from clothfit.base.arrays import Array, Indices
from clothfit.engine.forces.surfaces import distance
from clothfit.engine.solve.sparse import add_block, outer
from clothfit.kernels.kernel import kernel
from clothfit.kernels.lanes.operations import add, fma, lane0, lane1, lane2, load3, mul, pack, splat, store3, sub
from clothfit.kernels.vectors import cross, dot

CREEP = 1e-3
"""ε, m/s. On a slope of angle θ < arctan μ a vertex creeps by ε r/sqrt(1 − r²), r = tan θ/μ: by ε at r = 0.7, 7 ε at
0.99.
"""

PLACE, VELOCITY, SPIN, AXES = 0, 1, 2, 3
"""Rows of a collider's state: c, m; ċ, m/s; ω, 1/s; from the last on its three axes, unit vectors."""


class Colliders(NamedTuple):
    """Colliders of a scene but for its plain spheres; no rows where there are none."""

    shape: Indices  # (C,), see `surfaces`
    size: Array  # (C, 3), m: r, s, l of a cone; half of the lengths of a box
    thickness: Array  # d₀, (C,), m
    stiffness: Array  # κ, (C,), N/m
    friction: Array  # μ, (C,)
    state: Array  # (C, 6, 3)


def build(
    shape: npt.ArrayLike,
    size: npt.ArrayLike,
    thickness: npt.ArrayLike,
    stiffness: npt.ArrayLike,
    friction: npt.ArrayLike,
    state: npt.ArrayLike,
) -> Colliders:
    """So many colliders, C of them, which may be 0; shapes as above."""
    return Colliders(
        np.array(shape, np.int32).reshape(-1),
        np.array(size, float).reshape(-1, 3),
        np.array(thickness, float).reshape(-1),
        np.array(stiffness, float).reshape(-1),
        np.array(friction, float).reshape(-1),
        np.array(state, float).reshape(-1, 6, 3),
    )


@kernel
def contact(colliders, y, i, c):
    """Depth d (0 or less: no contact), k, j, n and t of vertex i at collider c."""
    state = colliders.state[c]
    a, b, e = load3(state, AXES), load3(state, AXES + 1), load3(state, AXES + 2)
    p = sub(load3(y, i), load3(state, PLACE))
    delta, k, j, n, t = distance(colliders.shape[c], colliders.size[c], dot(a, p), dot(b, p), dot(e, p))
    return colliders.thickness[c] - delta, k, j, turned(a, b, e, n), turned(a, b, e, t)


@kernel
def turned(a, b, e, v):
    """v₀ a + v₁ b + v₂ e."""
    return fma(splat(lane2(v)), e, fma(splat(lane1(v)), b, mul(splat(lane0(v)), a)))


@kernel
def across(n, v):
    """P v."""
    return fma(splat(-dot(n, v)), n, v)


@kernel
def surface(colliders, y, i, c):
    """V at vertex i."""
    state = colliders.state[c]
    away = sub(load3(y, i), load3(state, PLACE))
    return add(load3(state, VELOCITY), cross(load3(state, SPIN), away))


@kernel
def slide(colliders, y, u, i, c, depth, n):
    """V, v, q and γ of vertex i."""
    V = surface(colliders, y, i, c)
    v = sub(load3(u, i), V)
    vt = across(n, v)
    q = sqrt(dot(vt, vt) + CREEP * CREEP)
    return V, v, q, colliders.friction[c] * colliders.stiffness[c] * depth / q


@kernel
def add_along(out, i, scale, n):
    """out_i += scale · n."""
    store3(fma(splat(scale), n, load3(out, i)), out, i)


def depths(colliders: Colliders, y: Array) -> tuple[Array, Array]:
    """Depth (C, n), m, 0 or less outside, and normal (C, n, 3) of points y (n, 3)."""
    depth = np.zeros((len(colliders.shape), len(y)))
    normal = np.zeros((*depth.shape, 3))
    fill_depths(colliders, y, depth, normal)
    return depth, normal


@kernel
def fill_depths(colliders, y, depth, normal):
    """The same, written to arrays."""
    for c in range(len(colliders.shape)):
        for i in range(len(y)):
            depth[c, i], _, _, n, _ = contact(colliders, y, i, c)
            store3(n, normal[c], i)


@kernel
def energy(colliders, y):
    total = 0.0  # ½ κ d²
    for c in range(len(colliders.shape)):
        for i in range(len(y)):
            depth = max(contact(colliders, y, i, c)[0], 0.0)
            total += 0.5 * colliders.stiffness[c] * depth * depth
    return total


@kernel
def damping_power(colliders, y, u, w):
    total = 0.0
    for c in range(len(colliders.shape)):
        for i in range(len(y)):
            depth, _, _, n, _ = contact(colliders, y, i, c)
            if depth > 0.0:
                _, v, _, gamma = slide(colliders, y, u, i, c, depth, n)
                total -= gamma * dot(across(n, v), load3(w, i))
    return total


@kernel
def add_force(colliders, y, u, f):
    for c in range(len(colliders.shape)):
        for i in range(len(y)):
            depth, _, _, n, _ = contact(colliders, y, i, c)
            if depth > 0.0:
                _, v, _, gamma = slide(colliders, y, u, i, c, depth, n)
                add_along(f, i, colliders.stiffness[c] * depth, n)
                add_along(f, i, -gamma, across(n, v))


@kernel
def add_damping(colliders, y, u, scale, q, out):
    for c in range(len(colliders.shape)):
        for i in range(len(y)):
            depth, _, _, n, _ = contact(colliders, y, i, c)
            if depth > 0.0:
                gamma = slide(colliders, y, u, i, c, depth, n)[3]
                add_along(out, i, -scale * gamma, across(n, load3(q, i)))


@kernel
def add_step(colliders, y, u, h, ahead, A, b):
    stored = 0.0
    for c in range(len(colliders.shape)):
        kappa = colliders.stiffness[c]
        for i in range(len(y)):
            depth, _, _, n, _ = contact(colliders, y, i, c)
            if depth > 0.0:
                V, _, _, gamma = slide(colliders, y, u, i, c, depth, n)
                rub = h * gamma
                low, high = outer(mul(splat(h * h * kappa - rub), n), n)
                low = add(low, pack(rub, 0.0, 0.0, 0.0))
                add_block(A.diagonal, i, low, add(high, pack(rub, 0.0, rub, 0.0)))
                if len(b) > 0:
                    stored += 0.5 * kappa * depth * depth
                    outward = dot(n, load3(u, i)) if ahead else 0.0
                    add_along(b, i, h * kappa * (depth + h * outward), n)
                    add_along(b, i, rub, across(n, V))
    return stored


@kernel
def add_pullback(colliders, y, u, w, s, lam, h, grad, gy, gu):
    # φ/h = κ (d − σ) ν − γ π,  ν = n·λ,  σ = n·s,  π = λ·P z;  dγ = −μκ/q dδ − γ/q dq
    for c in range(len(colliders.shape)):
        kappa, spin = colliders.stiffness[c], load3(colliders.state[c], SPIN)
        for i in range(len(y)):
            depth, k, j, n, t = contact(colliders, y, i, c)
            if depth > 0.0:
                V, v, q, gamma = slide(colliders, y, u, i, c, depth, n)
                lam_i, s_i, z = load3(lam, i), load3(s, i), sub(load3(w, i), V)
                nu, push = dot(n, lam_i), kappa * (depth - dot(n, s_i))
                pi = dot(lam_i, z) - nu * dot(n, z)
                by_u = mul(splat(gamma * pi / (q * q)), across(n, v))
                by_v = sub(mul(splat(gamma), across(n, lam_i)), by_u)  # by V
                by_n = fma(splat(-kappa * nu), s_i, mul(splat(push + gamma * dot(n, z)), lam_i))
                by_n = fma(splat(gamma * nu), z, fma(splat(-dot(n, v)), by_u, by_n))
                by_y = fma(splat(k), across(n, by_n), mul(splat(j * dot(t, by_n)), t))
                by_y = add(by_y, cross(by_v, spin))
                by_y = fma(splat(gamma / depth * pi - kappa * nu), n, by_y)
                add_along(gy, i, h, by_y)
                add_along(gu, i, h, by_u)


@kernel
def add_pushforward(colliders, y, u, w, s, dy, du, direction, h, out):
    for c in range(len(colliders.shape)):
        kappa, spin = colliders.stiffness[c], load3(colliders.state[c], SPIN)
        for i in range(len(y)):
            depth, k, j, n, t = contact(colliders, y, i, c)
            if depth > 0.0:
                V, v, q, gamma = slide(colliders, y, u, i, c, depth, n)
                dy_i, s_i, z = load3(dy, i), load3(s, i), sub(load3(w, i), V)
                dn = fma(splat(k), across(n, dy_i), mul(splat(j * dot(t, dy_i)), t))
                ddelta, dV = dot(n, dy_i), cross(spin, dy_i)
                change = sub(sub(load3(du, i), dV), mul(splat(dot(n, v)), dn))
                dq = dot(across(n, v), change) / q
                dgamma = -gamma / depth * ddelta - gamma / q * dq
                dpz = fma(splat(-dot(n, z)), dn, mul(splat(-1.0), across(n, dV)))
                dpz = fma(splat(-dot(z, dn)), n, dpz)
                add_along(out, i, h * kappa * (depth - dot(n, s_i)), dn)
                add_along(out, i, -h * kappa * (ddelta + dot(dn, s_i)), n)
                add_along(out, i, -h * dgamma, across(n, z))
                add_along(out, i, -h * gamma, dpz)
