"""The law of contact, one for colliders and for a cloth that touches itself: it is pushed apart, and rubs.

Who touches is a row: of a vertex at a collider, or of the closest points of two parts of a cloth. It has a normal n, a
depth d, a stiffness κ, N/m, and a coefficient of friction μ. Where its two sides go past each other at U, the one feels

    f = κ d n − γ P U,   γ = μ N/q,   q = sqrt(|P U|² + ε²),   P = I − n nᵀ,   K = −κ n nᵀ,   D = −γ P:

Coulomb's friction, of which the part |P U|/q acts at slow speeds. The step's model keeps γ as it is at (y, u): for the
way S past each other from y on, and the velocity Z at the end,

    T = κ (d − n·S) n − γ P Z,

so that D is negative semi-definite and the step stable, however long it is. That γ lags behind costs μ h |g| of speed
where a vertex starts to slide, and nothing once its velocity stays, or with several Newton iterations. N is κ max(d, 0)
or, in implicit steps at colliders, the load: the push κ (d − n·S) of the step before, by its model. Where a surface is
curved, the depth at which a step is linearised is off by u² h²/2R, mostly far more than the weight of a cloth presses
it in, but the push of a step balances that. With the distance δ, dd = −dδ,

    dq = P U·(dU − (n·U) dn)/q,    d(P Z) = P dZ − (n·Z) dn − (Z·dn) n,    dγ = (N dμ + μ dN)/q − γ dq/q.

What a shape gives is n, d, U, S and Z, and how they change with the vertices: `contact` has the forces.
"""

from __future__ import annotations

from math import sqrt

from clothfit.engine.solve.sparse import outer
from clothfit.kernels.kernel import kernel
from clothfit.kernels.lanes.operations import add, fma, load3, mul, pack, splat, store3
from clothfit.kernels.vectors import dot

ENDLESS = 1e8
"""Time step, s, of a cloth at rest (`equilibrium`), whose K is exact: there +κ d ∂n/∂y belongs to it."""

STICTION_SPEED = 1e-3
"""ε, m/s. On a slope of angle θ < arctan μ a vertex creeps by ε r/sqrt(1 − r²), r = tan θ/μ: by ε at r = 0.7, 7 ε at
0.99.
"""


@kernel
def remaining(time, release):
    """What is left at a time, s, of what is let go from the start on: it goes smoothly to 0, at the release, s."""
    s = min(time / release, 1.0) if release > 0.0 else 1.0
    return 1.0 - s * s * (3.0 - 2.0 * s)


@kernel
def mixed(c, own, a):
    """Σ cᵢ a_i over the four vertices `own` of an array (n, 3)."""
    total = mul(splat(c[0]), load3(a, own[0]))
    total = fma(splat(c[1]), load3(a, own[1]), total)
    total = fma(splat(c[2]), load3(a, own[2]), total)
    return fma(splat(c[3]), load3(a, own[3]), total)


@kernel
def spread(c, own, v, out):
    """out_i += cᵢ v."""
    store3(fma(splat(c[0]), v, load3(out, own[0])), out, own[0])
    store3(fma(splat(c[1]), v, load3(out, own[1])), out, own[1])
    store3(fma(splat(c[2]), v, load3(out, own[2])), out, own[2])
    store3(fma(splat(c[3]), v, load3(out, own[3])), out, own[3])


@kernel
def across(n, v):
    """P v."""
    return fma(splat(-dot(n, v)), n, v)


@kernel
def rubbing(push, mu, n, U):
    """q, and γ for a push κ d."""
    along = across(n, U)
    q = sqrt(dot(along, along) + STICTION_SPEED * STICTION_SPEED)
    return q, mu * push / q


@kernel
def pressing(load, push):
    """N of friction: the load, N, or where that is not known, < 0, the push κ d."""
    return load if load >= 0.0 else max(push, 0.0)


@kernel
def force(push, gamma, n, U):
    """push n − γ P U."""
    return fma(splat(push), n, mul(splat(-gamma), across(n, U)))


@kernel
def block(push, rub, n):
    """push n nᵀ + rub P, as a block of `sparse`."""
    low, high = outer(mul(splat(push - rub), n), n)
    return add(low, pack(rub, 0.0, 0.0, 0.0)), add(high, pack(rub, 0.0, rub, 0.0))


@kernel
def turning(h, push, depth):
    """Of a `push` h² κ what turns with the normal, h² κ d: a part of the K of a cloth at rest alone."""
    return push * max(depth, 0.0) if h == ENDLESS else 0.0


@kernel
def pull(row, S, Z, L, made):
    """The gradients of L·T by n, U, S, Z and L, and those by δ, μ, κ and the load, of a row (κ, μ, d, n, U, load);
    `made` is the gradient by the push κ (d − n·S) of its model, which it hands to the next step.
    """
    # L·T = κ (d − n·S) ν − γ π,  ν = n·L,  π = L·P Z
    kappa, mu, depth, n, U, load = row
    q, gamma = rubbing(pressing(load, kappa * depth), mu, n, U)
    nu, left, along = dot(n, L), depth - dot(n, S), dot(n, Z)
    pi, by_push = dot(L, Z) - nu * along, nu + made
    rub = mu / q * pi
    by_U = mul(splat(gamma * pi / (q * q)), across(n, U))
    by_n = fma(splat(-kappa * by_push), S, mul(splat(kappa * left + gamma * along), L))
    by_n = fma(splat(gamma * nu), Z, fma(splat(-dot(n, U)), by_U, by_n))
    by_S, by_Z = mul(splat(-kappa * by_push), n), mul(splat(-gamma), across(n, L))
    by_depth = rub if load < 0.0 and depth > 0.0 else 0.0
    by_mu, by_kappa = -pressing(load, kappa * depth) / q * pi, left * by_push - by_depth * depth
    by_law = kappa * (by_depth - by_push), by_mu, by_kappa, -rub
    return (by_n, by_U, by_S, by_Z, force(kappa * left, gamma, n, Z)), by_law


@kernel
def change(row, S, Z, moved, dmu, dkappa, dload):
    """T and dT of a row (κ, μ, d, n, U, load) for dn, dδ, dU, dS and dZ, `moved`, dμ, dκ and that of the load."""
    kappa, mu, depth, n, U, load = row
    dn, ddelta, dU, dS, dZ = moved
    pushes = pressing(load, kappa * depth)
    q, gamma = rubbing(pushes, mu, n, U)
    left = depth - dot(n, S)
    dq = dot(across(n, U), fma(splat(-dot(n, U)), dn, dU)) / q
    if load < 0.0:
        dload = dkappa * depth - kappa * ddelta if depth > 0.0 else 0.0
    dgamma = (dmu * pushes + mu * dload) / q - gamma / q * dq
    dT = force(pushed(kappa, left, n, S, (dn, ddelta, dS), dkappa), dgamma, n, Z)
    dT = fma(splat(kappa * left + gamma * dot(n, Z)), dn, dT)
    dT = fma(splat(gamma * dot(dn, Z)), n, fma(splat(-gamma), across(n, dZ), dT))
    return force(kappa * left, gamma, n, Z), dT


@kernel
def pushed(kappa, left, n, S, moved, dkappa):
    """The change of the push κ (d − n·S) for dn, dδ and dS, `moved`, and dκ."""
    dn, ddelta, dS = moved
    return dkappa * left - kappa * (ddelta + dot(dn, S) + dot(n, dS))
