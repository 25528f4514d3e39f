"""Self-contact: a cloth pushes itself apart where it comes nearer than its thickness, and rubs.

A pair, of a vertex and a triangle or of two edges, at the distance δ has the depth d = d₀ − δ, with the thickness d₀,
or the pair's distance at the start where that is less. Of the closest points (`nearest`: cᵢ, n, δ; V = Σ cᵢ uᵢ is their
velocity past each other) its vertex i feels

    fᵢ = cᵢ (κ s d n − γ P V),   γ = μ κ s d / q,   q = sqrt(|P V|² + ε²),   K = −κ s cᵢ cⱼ n nᵀ,  D = −γ cᵢ cⱼ P,

P = I − n nᵀ, s the share of the pair. As cᵢ n is the derivative of δ, the push has the energy ½ κ s d², K is what of
its second derivative is definite, and the forces of a pair have neither a sum nor a moment. The step's model is

    Fᵢ = cᵢ T,   T = κ s (d − n·S) n − γ P Z,   S = Σ cᵢ sᵢ,   Z = Σ cᵢ wᵢ.

By the parameters, ∂T/∂μ = −(κ s d/q) P Z and ∂T/∂κ = s (d − n·S) n − (μ s d/q) P Z.

Which pairs there are the step says (`engine.touching`): those that end nearer than d₀, so that none pulls; some of them
begin farther away, with d < 0, and do not rub yet.
"""

from __future__ import annotations

from math import sqrt
from typing import NamedTuple

from clothfit.base.arrays import Array, Indices
from clothfit.engine.forces.selfcontact import nearest
from clothfit.engine.forces.selfcontact.nearest import mixed, spread
from clothfit.engine.forces.touch import CREEP, across
from clothfit.engine.solve.joined import keep
from clothfit.engine.solve.sparse import add_block, outer
from clothfit.kernels.kernel import kernel
from clothfit.kernels.lanes.operations import add, fma, load3, mul, pack, splat, sub
from clothfit.kernels.vectors import dot


class Contact(NamedTuple):
    """The pairs of a step, P of them, which change from step to step, and their law."""

    vertices: Indices  # (P, 4), of a vertex and a triangle, or of two edges
    kind: Indices  # (P,), `nearest.CORNER` or EDGE
    thickness: Array  # (P,), m, of each pair
    side: Array  # (P,), 1 or −1: where the one was of the other when the step began
    free: Array  # (n,), 1 of free vertices, else 0
    stiffness: float  # κ, N/m
    friction: float  # μ


@kernel
def touch(contact, y, k):
    """c, which parameters are free, r, n, δ and the share of pair k."""
    own, kind = contact.vertices[k], contact.kind[k]
    c, free, r = nearest.closest(kind, own, y)
    delta = sqrt(dot(r, r))
    if free == nearest.BOTH and nearest.side(kind, own, y) != contact.side[k]:
        delta = -delta
    return c, free, r, mul(splat(1.0 / delta), r), delta, nearest.share(kind, own, y)


@kernel
def pressing(contact, y, u, k):
    """The vertices, c, n, push, V and γ of pair k."""
    own = contact.vertices[k]
    c, _, _, n, delta, part = touch(contact, y, k)
    push = contact.stiffness * part * (contact.thickness[k] - delta)
    V, _, gamma = rubbing(contact, c, own, n, push, u)
    return own, c, n, push, V, gamma


@kernel
def rubbing(contact, c, own, n, push, u):
    """V, q and γ of a pair whose push, N, is this."""
    V = mixed(c, own, u)
    vt = across(n, V)
    q = sqrt(dot(vt, vt) + CREEP * CREEP)
    return V, q, contact.friction * max(push, 0.0) / q


@kernel(absent=0.0)
def energy(contact, y):
    total = 0.0  # ½ κ s d²
    for k in range(len(contact.kind)):
        _, _, _, _, delta, part = touch(contact, y, k)
        depth = contact.thickness[k] - delta
        total += 0.5 * contact.stiffness * part * depth * depth
    return total


@kernel(absent=0.0)
def damping_power(contact, y, u, w):
    total = 0.0
    for k in range(len(contact.kind)):
        own, c, n, _, V, gamma = pressing(contact, y, u, k)
        total -= gamma * dot(across(n, V), mixed(c, own, w))
    return total


@kernel(empty=None, apart=None)
def add_force(contact, y, u, f):
    for k in range(len(contact.kind)):
        own, c, n, push, V, gamma = pressing(contact, y, u, k)
        spread(c, own, sub(mul(splat(push), n), mul(splat(gamma), across(n, V))), f)


@kernel(empty=None, apart=None)
def add_damping(contact, y, u, scale, q, out):
    if contact.friction == 0.0:
        return
    for k in range(len(contact.kind)):
        own, c, n, _, _, gamma = pressing(contact, y, u, k)
        spread(c, own, mul(splat(-scale * gamma), across(n, mixed(c, own, q))), out)


@kernel(empty=0.0, apart=0.0)
def add_step(contact, y, u, h, ahead, A, b):
    stored = 0.0
    for k in range(len(contact.kind)):
        own = contact.vertices[k]
        c, _, _, n, delta, part = touch(contact, y, k)
        stiff, depth = contact.stiffness * part, contact.thickness[k] - delta
        rub = h * rubbing(contact, c, own, n, stiff * depth, u)[2]
        keep(A.joined, k, c, n, h * h * stiff, rub)
        low, high = outer(mul(splat(h * h * stiff - rub), n), n)
        low, high = add(low, pack(rub, 0.0, 0.0, 0.0)), add(high, pack(rub, 0.0, rub, 0.0))
        for e in range(4):
            square = splat(c[e] * c[e])
            add_block(A.diagonal, own[e], mul(square, low), mul(square, high))
            add_block(A.joined.diagonal, own[e], mul(square, low), mul(square, high))
        if len(b) > 0:
            stored += 0.5 * stiff * depth * depth
            outward = dot(n, mixed(c, own, u)) if ahead else 0.0
            spread(c, own, mul(splat(h * stiff * (depth + h * outward)), n), b)
    return stored


@kernel
def pressure(contact, y, s, out):
    """out (P,) = d − n·S: how deep, m, each pair is for the model of a step that ends at y + s."""
    for k in range(len(contact.kind)):
        own = contact.vertices[k]
        c, _, _, n, delta, _ = touch(contact, y, k)
        out[k] = contact.thickness[k] - delta - dot(n, mixed(c, own, s))


@kernel
def find_parts(contact, y, out):
    """out (P,) = which parameters of each pair's closest points are free (`nearest`)."""
    for k in range(len(contact.kind)):
        out[k] = nearest.closest(contact.kind[k], contact.vertices[k], y)[1]


@kernel(empty=None, apart=None)
def add_pullback(contact, y, u, w, s, lam, h, grad, gy, gu):
    # φ/h = κ s (d − σ) ν − γ π,  ν = n·Λ,  Λ = Σ cᵢ λᵢ,  σ = n·S,  π = Λ·P Z;  dγ = γ (ds/s − dδ/d − dq/q)
    for k in range(len(contact.kind)):
        own, kind = contact.vertices[k], contact.kind[k]
        c, free, r, n, delta, part = touch(contact, y, k)
        stiff, depth = contact.stiffness * part, contact.thickness[k] - delta
        V, q, gamma = rubbing(contact, c, own, n, stiff * depth, u)
        L, S, Z = mixed(c, own, lam), mixed(c, own, s), mixed(c, own, w)
        nu, left = dot(n, L), depth - dot(n, S)
        pi = dot(L, Z) - nu * dot(n, Z)
        by_V = mul(splat(gamma * pi / (q * q)), across(n, V))
        by_L = fma(splat(stiff * left), n, mul(splat(-gamma), across(n, Z)))
        by_Z = mul(splat(-gamma), across(n, L))
        by_S = mul(splat(-stiff * nu), n)
        by_n = fma(splat(-stiff * nu), S, mul(splat(stiff * left + gamma * dot(n, Z)), L))
        by_n = fma(splat(gamma * nu), Z, fma(splat(-gamma * pi / (q * q) * dot(n, V)), V, by_n))
        by_delta = -stiff * nu + (gamma * pi / depth if gamma != 0.0 else 0.0)
        by_c = (
            weight_slope(own[0], by_L, lam, by_S, s, by_Z, w, by_V, u),
            weight_slope(own[1], by_L, lam, by_S, s, by_Z, w, by_V, u),
            weight_slope(own[2], by_L, lam, by_S, s, by_Z, w, by_V, u),
            weight_slope(own[3], by_L, lam, by_S, s, by_Z, w, by_V, u),
        )
        nearest.add_moved_back(kind, own, y, free, c, r, delta, n, by_c, by_n, by_delta, h, gy)
        if part < 1.0:
            by_share = contact.stiffness * left * nu - (gamma * pi / part if gamma != 0.0 else 0.0)
            nearest.add_share_back(kind, own, y, h * by_share, gy)
        spread(c, own, mul(splat(h), by_V), gu)
        if len(grad.friction) > 0:
            grad.friction[-1] -= h * stiff * max(depth, 0.0) / q * pi
        if len(grad.contact) > 0:
            grad.contact[-1] += h * (part * left * nu - gamma / contact.stiffness * pi)


@kernel
def weight_slope(i, by_L, lam, by_S, s, by_Z, w, by_V, u):
    """The gradient by the weight of vertex i, from those by the sums that it is in."""
    total = dot(by_L, load3(lam, i)) + dot(by_S, load3(s, i))
    return total + dot(by_Z, load3(w, i)) + dot(by_V, load3(u, i))


@kernel(empty=None, apart=None)
def add_pushforward(contact, y, u, w, s, dy, du, direction, h, out):
    dmu = direction.friction[-1] if len(direction.friction) > 0 else 0.0
    dkappa = direction.contact[-1] if len(direction.contact) > 0 else 0.0
    for k in range(len(contact.kind)):
        own, kind = contact.vertices[k], contact.kind[k]
        c, free, r, n, delta, part = touch(contact, y, k)
        stiff, depth = contact.stiffness * part, contact.thickness[k] - delta
        V, q, gamma = rubbing(contact, c, own, n, stiff * depth, u)
        S, Z = mixed(c, own, s), mixed(c, own, w)
        left, rub = depth - dot(n, S), across(n, Z)
        dc, dn, ddelta = nearest.moved(kind, own, y, free, c, r, delta, n, dy)
        dS, dZ, dV = mixed(dc, own, s), mixed(dc, own, w), add(mixed(dc, own, u), mixed(c, own, du))
        dshare = nearest.share_change(kind, own, y, dy) if part < 1.0 else 0.0
        dpush = contact.stiffness * dshare * left - stiff * (ddelta + dot(dn, S) + dot(n, dS)) + dkappa * part * left
        dT = fma(splat(dpush), n, mul(splat(stiff * left), dn))
        if gamma != 0.0:
            dq = dot(across(n, V), dV) / q - dot(n, V) * dot(V, dn) / q
            dgamma = gamma * (dshare / part - ddelta / depth - dq / q)
            drub = sub(dZ, fma(splat(dot(n, dZ) + dot(dn, Z)), n, mul(splat(dot(n, Z)), dn)))
            dT = sub(dT, fma(splat(dgamma), rub, mul(splat(gamma), drub)))
        dlaw = (dmu * contact.stiffness + contact.friction * dkappa) * part * max(depth, 0.0) / q
        dT = sub(dT, mul(splat(dlaw), rub))
        T = fma(splat(stiff * left), n, mul(splat(-gamma), rub))
        spread(dc, own, mul(splat(h), T), out)
        spread(c, own, mul(splat(h), dT), out)
