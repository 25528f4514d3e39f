"""Self-contact: a cloth pushes itself apart where it comes nearer than its thickness, and rubs.

A pair, of a vertex and a triangle or of two edges, at the distance δ has the depth d = d₀ − δ, with the thickness d₀,
or the pair's distance at the start where that is less. Its closest points (`nearest`: cᵢ, n, δ) go past each other at
U = Σ cᵢ uᵢ. Between them acts the T of `law`, with S = Σ cᵢ sᵢ, Z = Σ cᵢ wᵢ and, for the share s of the pair, the
stiffness κ s; vertex i feels cᵢ T. As cᵢ n is the derivative of δ, the push has the energy ½ κ s d²,

    K = −κ s cᵢ cⱼ n nᵀ,   D = −γ cᵢ cⱼ P,

K is what of its second derivative is definite, and the forces of a pair have neither a sum nor a moment.

Which pairs there are the step says (`engine.touching`): those that end nearer than d₀, so that none pulls; some of them
begin farther away, with d < 0, and do not rub yet.
"""

from __future__ import annotations

from math import sqrt
from typing import NamedTuple

import numpy as np

from clothfit.base.arrays import Array, Indices
from clothfit.engine.forces import law
from clothfit.engine.forces.law import across, rubbing
from clothfit.engine.forces.selfcontact import nearest
from clothfit.engine.solve.joined import keep, mixed, spread
from clothfit.engine.solve.sparse import add_block
from clothfit.kernels.kernel import kernel
from clothfit.kernels.lanes.operations import add, load3, mul, splat
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
    """c, which parameters are free, r, n, δ, the share and the depth of pair k."""
    own, kind = contact.vertices[k], contact.kind[k]
    c, free, r = nearest.closest(kind, own, y)
    delta = sqrt(dot(r, r))
    if free == nearest.BOTH and nearest.side(kind, own, y) != contact.side[k]:
        delta = -delta
    return c, free, r, mul(splat(1.0 / delta), r), delta, nearest.share(kind, own, y), contact.thickness[k] - delta


@kernel
def pressing(contact, y, u, k):
    """The vertices, c, κ s, d, γ, n and U of pair k."""
    own = contact.vertices[k]
    c, _, _, n, _, share, depth = touch(contact, y, k)
    kappa, U = contact.stiffness * share, mixed(c, own, u)
    return own, c, kappa, depth, rubbing(kappa * depth, contact.friction, n, U)[1], n, U


@kernel(absent=0.0)
def energy(contact, y):
    total = 0.0  # ½ κ s d²
    for k in range(len(contact.kind)):
        _, _, _, _, _, share, depth = touch(contact, y, k)
        total += 0.5 * contact.stiffness * share * depth * depth
    return total


@kernel(absent=0.0)
def damping_power(contact, y, u, w):
    total = 0.0
    for k in range(len(contact.kind)):
        own, c, _, _, gamma, n, U = pressing(contact, y, u, k)
        total -= gamma * dot(across(n, U), mixed(c, own, w))
    return total


@kernel(empty=None, apart=None)
def add_force(contact, y, u, f):
    for k in range(len(contact.kind)):
        own, c, kappa, depth, gamma, n, U = pressing(contact, y, u, k)
        spread(c, own, law.force(kappa * depth, gamma, n, U), f)


@kernel(empty=None, apart=None)
def add_damping(contact, y, u, scale, q, out):
    if contact.friction == 0.0:
        return
    for k in range(len(contact.kind)):
        own, c, _, _, gamma, n, _ = pressing(contact, y, u, k)
        spread(c, own, mul(splat(-scale * gamma), across(n, mixed(c, own, q))), out)


@kernel(empty=0.0, apart=0.0)
def add_step(contact, y, u, h, ahead, A, b):
    stored = 0.0
    for k in range(len(contact.kind)):
        own, c, kappa, depth, gamma, n, U = pressing(contact, y, u, k)
        keep(A.joined, k, c, n, h * h * kappa, h * gamma)
        low, high = law.block(h * h * kappa, h * gamma, n)
        for e in range(4):
            square = splat(c[e] * c[e])
            add_block(A.diagonal, own[e], mul(square, low), mul(square, high))
        if len(b) > 0:
            stored += 0.5 * kappa * depth * depth
            leaving = dot(n, U) if ahead else 0.0
            spread(c, own, mul(splat(h * kappa * (depth + h * leaving)), n), b)
    return stored


@kernel
def depths(contact, y, s):
    """d − n·S (P,): how deep, m, each pair is for the model of a step that ends at y + s."""
    found = np.zeros(len(contact.kind))
    for k in range(len(contact.kind)):
        c, _, _, n, _, _, depth = touch(contact, y, k)
        found[k] = depth - dot(n, mixed(c, contact.vertices[k], s))
    return found


@kernel
def find_parts(contact, y, out):
    """out (P,) = which parameters of each pair's closest points are free (`nearest`)."""
    for k in range(len(contact.kind)):
        out[k] = nearest.closest(contact.kind[k], contact.vertices[k], y)[1]


@kernel(empty=None, apart=None)
def add_pullback(contact, y, u, w, s, lam, h, grad, gy, gu):
    for k in range(len(contact.kind)):
        own, kind = contact.vertices[k], contact.kind[k]
        c, free, r, n, delta, share, depth = touch(contact, y, k)
        row = contact.stiffness * share, contact.friction, depth, n, mixed(c, own, u)
        vectors, by_law = law.pull(row, mixed(c, own, s), mixed(c, own, w), mixed(c, own, lam))
        (by_n, by_U, by_S, by_Z, by_L), (by_delta, by_mu, by_kappa) = vectors, by_law
        by_c = (
            weight_slope(own[0], by_L, lam, by_S, s, by_Z, w, by_U, u),
            weight_slope(own[1], by_L, lam, by_S, s, by_Z, w, by_U, u),
            weight_slope(own[2], by_L, lam, by_S, s, by_Z, w, by_U, u),
            weight_slope(own[3], by_L, lam, by_S, s, by_Z, w, by_U, u),
        )
        nearest.add_moved_back(kind, own, y, free, c, r, delta, n, by_c, by_n, by_delta, h, gy)
        if share < 1.0:
            nearest.add_share_back(own, y, h * contact.stiffness * by_kappa, gy)
        spread(c, own, mul(splat(h), by_U), gu)
        if len(grad.friction) > 0:
            grad.friction[-1] += h * by_mu
        if len(grad.contact) > 0:
            grad.contact[-1] += h * share * by_kappa


@kernel
def weight_slope(i, by_L, lam, by_S, s, by_Z, w, by_U, u):
    """The gradient by the weight of vertex i, from those by the sums that it is in."""
    total = dot(by_L, load3(lam, i)) + dot(by_S, load3(s, i))
    return total + dot(by_Z, load3(w, i)) + dot(by_U, load3(u, i))


@kernel(empty=None, apart=None)
def add_pushforward(contact, y, u, w, s, dy, du, direction, h, out):
    dmu = direction.friction[-1] if len(direction.friction) > 0 else 0.0
    dkappa = direction.contact[-1] if len(direction.contact) > 0 else 0.0
    for k in range(len(contact.kind)):
        own, kind = contact.vertices[k], contact.kind[k]
        c, free, r, n, delta, share, depth = touch(contact, y, k)
        row = contact.stiffness * share, contact.friction, depth, n, mixed(c, own, u)
        dc, dn, ddelta = nearest.moved(kind, own, y, free, c, r, delta, n, dy)
        moved = dn, ddelta, add(mixed(dc, own, u), mixed(c, own, du)), mixed(dc, own, s), mixed(dc, own, w)
        more = nearest.share_change(own, y, dy) if share < 1.0 else 0.0
        more = dkappa * share + contact.stiffness * more
        T, dT = law.change(row, mixed(c, own, s), mixed(c, own, w), moved, dmu, more)
        spread(dc, own, mul(splat(h), T), out)
        spread(c, own, mul(splat(h), dT), out)
