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

    dq = v_t·(du − dV − (n·v) dn)/q, v_t = P v,    d(P z) = −P dV − (n·z) dn − (z·dn) n,

and by the parameters ∂F/∂μ = −(κ d/q) P z, ∂F/∂κ = (d − n·s) n − (μ d/q) P z, ∂F/∂c = −∂F/∂y.
"""

from __future__ import annotations

from collections.abc import Sequence
from math import sqrt
from typing import NamedTuple

import numpy as np

from clothfit.base.arrays import Array
from clothfit.engine.forces.spheres import offset_of
from clothfit.engine.forces.surfaces import distance
from clothfit.engine.solve.sparse import add_block, outer
from clothfit.kernels.kernel import kernel
from clothfit.kernels.lanes.operations import add, fma, lane0, lane1, lane2, load3, mul, pack, splat, store3, sub
from clothfit.kernels.vectors import cross, dot

CREEP = 1e-3
"""ε, m/s. On a slope of angle θ < arctan μ a vertex creeps by ε r/sqrt(1 − r²), r = tan θ/μ: by ε at r = 0.7, 7 ε at
0.99.
"""

PLACE, VELOCITY, SPIN, AXES, SIZE, LAW, SHAPE = 0, 1, 2, 3, 6, 7, 8
"""Rows of a collider: c, m; ċ, m/s; ω, 1/s; three unit vectors, its axes; r, s, l of a cone or half of the lengths of a
box, m; d₀, m, κ, N/m, and μ; the number of `surfaces`. Those before SIZE are its state.
"""

THICKNESS, STIFFNESS, FRICTION = 0, 1, 2
"""Places in the row LAW."""


class Colliders(NamedTuple):
    """Colliders of a scene but for its plain spheres: one array, as each one that a step carries costs time.

    A scene without them, in which nothing changes, has None in this place: of what depends on an argument that is None,
    nothing is compiled.
    """

    rows: Array  # (C, 9, 3)

    @property
    def state(self) -> Array:
        """What changes as they move, (C, 6, 3), not a copy."""
        return self.rows[:, :SIZE]

    @property
    def thickness(self) -> Array:
        """d₀, (C,), m."""
        return self.rows[:, LAW, THICKNESS]

    @property
    def stiffness(self) -> Array:
        """κ, (C,), N/m."""
        return self.rows[:, LAW, STIFFNESS]

    @property
    def friction(self) -> Array:
        """μ, (C,)."""
        return self.rows[:, LAW, FRICTION]


def build(shape: Sequence[int], size: Sequence[Array], law: Sequence[Sequence[float]], state: Array) -> Colliders:
    """So many colliders, C of them, which may be 0: shapes, sizes (3,), laws (3,) and the states (C, 6, 3)."""
    rows = np.zeros((len(shape), 9, 3))
    rows[:, :SIZE] = state
    for row, number, extent, numbers in zip(rows, shape, size, law, strict=True):
        row[SIZE], row[LAW], row[SHAPE] = extent, numbers, number
    return Colliders(rows)


@kernel
def contact(colliders, y, i, c):
    """Depth d (0 or less: no contact), k, j, n and t of vertex i at collider c."""
    own = colliders.rows[c]
    a, b, e = load3(own, AXES), load3(own, AXES + 1), load3(own, AXES + 2)
    p = sub(load3(y, i), load3(own, PLACE))
    delta, k, j, n, t = distance(int(own[SHAPE, 0]), own[SIZE], dot(a, p), dot(b, p), dot(e, p))
    return own[LAW, THICKNESS] - delta, k, j, turned(a, b, e, n), turned(a, b, e, t)


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
    own = colliders.rows[c]
    away = sub(load3(y, i), load3(own, PLACE))
    return add(load3(own, VELOCITY), cross(load3(own, SPIN), away))


@kernel
def slide(colliders, y, u, i, c, depth, n):
    """V, v, q and γ of vertex i."""
    V = surface(colliders, y, i, c)
    v = sub(load3(u, i), V)
    vt = across(n, v)
    q = sqrt(dot(vt, vt) + CREEP * CREEP)
    return V, v, q, colliders.rows[c, LAW, FRICTION] * colliders.rows[c, LAW, STIFFNESS] * depth / q


@kernel
def add_along(out, i, scale, n):
    """out_i += scale · n."""
    store3(fma(splat(scale), n, load3(out, i)), out, i)


def depths(colliders: Colliders, y: Array) -> tuple[Array, Array]:
    """Depth (C, n), m, 0 or less outside, and normal (C, n, 3) of points y (n, 3)."""
    depth = np.zeros((len(colliders.rows), len(y)))
    normal = np.zeros((*depth.shape, 3))
    fill_depths(colliders, y, depth, normal)
    return depth, normal


@kernel
def fill_depths(colliders, y, depth, normal):
    """The same, written to arrays."""
    for c in range(len(colliders.rows)):
        for i in range(len(y)):
            depth[c, i], _, _, n, _ = contact(colliders, y, i, c)
            store3(n, normal[c], i)


@kernel
def energy(colliders, y):
    if colliders is None:
        return 0.0
    total = 0.0  # ½ κ d²
    for c in range(len(colliders.rows)):
        for i in range(len(y)):
            depth = max(contact(colliders, y, i, c)[0], 0.0)
            total += 0.5 * colliders.rows[c, LAW, STIFFNESS] * depth * depth
    return total


@kernel
def damping_power(colliders, y, u, w):
    if colliders is None:
        return 0.0
    total = 0.0
    for c in range(len(colliders.rows)):
        for i in range(len(y)):
            depth, _, _, n, _ = contact(colliders, y, i, c)
            if depth > 0.0:
                _, v, _, gamma = slide(colliders, y, u, i, c, depth, n)
                total -= gamma * dot(across(n, v), load3(w, i))
    return total


@kernel
def add_force(colliders, y, u, f):
    if colliders is None:
        return
    for c in range(len(colliders.rows)):
        for i in range(len(y)):
            depth, _, _, n, _ = contact(colliders, y, i, c)
            if depth > 0.0:
                _, v, _, gamma = slide(colliders, y, u, i, c, depth, n)
                add_along(f, i, colliders.rows[c, LAW, STIFFNESS] * depth, n)
                add_along(f, i, -gamma, across(n, v))


@kernel
def add_damping(colliders, y, u, scale, q, out):
    if colliders is None:
        return
    for c in range(len(colliders.rows)):
        for i in range(len(y)):
            depth, _, _, n, _ = contact(colliders, y, i, c)
            if depth > 0.0:
                gamma = slide(colliders, y, u, i, c, depth, n)[3]
                add_along(out, i, -scale * gamma, across(n, load3(q, i)))


@kernel
def add_step(colliders, y, u, h, ahead, A, b):
    if colliders is None:
        return 0.0
    stored = 0.0
    for c in range(len(colliders.rows)):
        kappa = colliders.rows[c, LAW, STIFFNESS]
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
    if colliders is None:
        return
    # φ/h = κ (d − σ) ν − γ π,  ν = n·λ,  σ = n·s,  π = λ·P z;  dγ = −μκ/q dδ − γ/q dq
    for c in range(len(colliders.rows)):
        kappa, spin = colliders.rows[c, LAW, STIFFNESS], load3(colliders.rows[c], SPIN)
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
                add_to_law(grad, c, h, colliders.rows[c, LAW], depth / q * pi, push / kappa * nu)
                if len(grad.offset) > 0:
                    grad.offset[0] -= h * lane0(by_y)
                    grad.offset[1] -= h * lane1(by_y)
                    grad.offset[2] -= h * lane2(by_y)


@kernel
def add_to_law(grad, c, h, law, rub, push):
    """Add to the gradient by μ and κ of collider c, with `rub` d π/q and `push` (d − σ) ν of a vertex."""
    if len(grad.friction) > 0:
        grad.friction[c] -= h * law[STIFFNESS] * rub
    if len(grad.contact) > 0:
        grad.contact[c] += h * (push - law[FRICTION] * rub)


@kernel
def change_of_law(direction, c):
    """The change of μ and κ of collider c."""
    dmu = direction.friction[c] if len(direction.friction) > 0 else 0.0
    dkappa = direction.contact[c] if len(direction.contact) > 0 else 0.0
    return dmu, dkappa


@kernel
def add_pushforward(colliders, y, u, w, s, dy, du, direction, h, out):
    if colliders is None:
        return
    o0, o1, o2 = offset_of(direction)
    offset = pack(o0, o1, o2, 0.0)
    for c in range(len(colliders.rows)):
        kappa, spin = colliders.rows[c, LAW, STIFFNESS], load3(colliders.rows[c], SPIN)
        dmu, dkappa = change_of_law(direction, c)
        for i in range(len(y)):
            depth, k, j, n, t = contact(colliders, y, i, c)
            if depth > 0.0:
                V, v, q, gamma = slide(colliders, y, u, i, c, depth, n)
                dy_i, s_i, z = sub(load3(dy, i), offset), load3(s, i), sub(load3(w, i), V)
                dn = fma(splat(k), across(n, dy_i), mul(splat(j * dot(t, dy_i)), t))
                ddelta, dV = dot(n, dy_i), cross(spin, dy_i)
                change = sub(sub(load3(du, i), dV), mul(splat(dot(n, v)), dn))
                dq = dot(across(n, v), change) / q
                dgamma = -gamma / depth * ddelta - gamma / q * dq
                dgamma += (dmu * kappa + colliders.rows[c, LAW, FRICTION] * dkappa) * depth / q
                dpz = fma(splat(-dot(n, z)), dn, mul(splat(-1.0), across(n, dV)))
                dpz = fma(splat(-dot(z, dn)), n, dpz)
                add_along(out, i, h * kappa * (depth - dot(n, s_i)), dn)
                add_along(out, i, -h * kappa * (ddelta + dot(dn, s_i)), n)
                add_along(out, i, h * dkappa * (depth - dot(n, s_i)), n)
                add_along(out, i, -h * dgamma, across(n, z))
                add_along(out, i, -h * gamma, dpz)
