"""Self-contact: a cloth pushes itself apart where it comes nearer than its thickness, and rubs.

A pair, of a vertex and a triangle or of two edges, at the distance δ has the depth d = d₀ − δ, with the thickness d₀,
or the pair's distance at the start where that is less. Its closest points (`nearest`: cᵢ, n, δ) go past each other at
U = Σ cᵢ uᵢ. Between them acts the T of `law`, with S = Σ cᵢ sᵢ, Z = Σ cᵢ wᵢ and, for the share s of the pair, the
stiffness κ s; vertex i feels cᵢ T. As cᵢ n is the derivative of δ, the push has the energy ½ κ s d²,

    K = −κ s cᵢ cⱼ n nᵀ,   D = −γ cᵢ cⱼ P,

K is what of its second derivative is definite, and the forces of a pair have neither a sum nor a moment.

Which pairs may touch in a step `engine.touching` says, and which of them press each iteration finds (`meet`): those
that end nearer than d₀, so that none pulls; some of them begin farther away, with d < 0, and do not rub yet.
"""

from __future__ import annotations

from math import sqrt
from typing import NamedTuple

import numpy as np

from clothfit.base.arrays import Array, Flags, Indices
from clothfit.engine.forces import law
from clothfit.engine.forces.law import across, rubbing
from clothfit.engine.forces.selfcontact import nearest
from clothfit.engine.solve.joined import PUSH, RUB, keep, mixed, spread
from clothfit.engine.solve.sparse import add_block
from clothfit.kernels.kernel import kernel
from clothfit.kernels.lanes.operations import add, load3, mul, splat, sub
from clothfit.kernels.vectors import combine, dot

FLAT = 1e-6
"""Depth relative to the thickness of a cloth that is too little to begin to press, lest rounds do not end."""


class Contact(NamedTuple):
    """The pairs of a step, P of them, which change from step to step, and their law."""

    vertices: Indices  # (P, 4), of a vertex and a triangle, or of two edges
    kind: Indices  # (P,), `nearest.CORNER` or EDGE
    thickness: Array  # (P,), m, of each pair
    side: Array  # (P,), 1 or −1: where the one was of the other when the step began
    free: Array  # (n,), 1 of free vertices, else 0
    thick: float  # m, the thickness of the cloth
    stiffness: float  # κ, N/m
    friction: float  # μ
    on: Flags  # (N, P), which of them press in each iteration of a step
    turn: Indices  # (1,), the iteration that is computed, as `touch.Colliders` has it


@kernel
def presses(contact, k):
    """Whether pair k does in this iteration."""
    return contact.on[contact.turn[0], k]


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
        if presses(contact, k):
            _, _, _, _, _, share, depth = touch(contact, y, k)
            total += 0.5 * contact.stiffness * share * depth * depth
    return total


@kernel(absent=0.0)
def damping_power(contact, y, u, w):
    total = 0.0
    for k in range(len(contact.kind)):
        if not presses(contact, k):
            continue
        own, c, _, _, gamma, n, U = pressing(contact, y, u, k)
        total -= gamma * dot(across(n, U), mixed(c, own, w))
    return total


@kernel(empty=None, apart=None)
def add_force(contact, y, u, f):
    for k in range(len(contact.kind)):
        if not presses(contact, k):
            continue
        own, c, kappa, depth, gamma, n, U = pressing(contact, y, u, k)
        spread(c, own, law.force(kappa * depth, gamma, n, U), f)


@kernel(empty=None, apart=None)
def add_damping(contact, y, u, scale, q, out):
    if contact.friction == 0.0:
        return
    for k in range(len(contact.kind)):
        if not presses(contact, k):
            continue
        own, c, _, _, gamma, n, _ = pressing(contact, y, u, k)
        spread(c, own, mul(splat(-scale * gamma), across(n, mixed(c, own, q))), out)


@kernel(empty=0.0, apart=0.0)
def add_step(contact, y, u, h, ahead, A, b):
    stored = 0.0
    for k in range(len(contact.kind)):
        A.joined.rows[k, PUSH] = A.joined.rows[k, RUB] = 0.0
        if presses(contact, k):
            own, c, kappa, depth, gamma, n, U = pressing(contact, y, u, k)
            add_row(k, own, c, n, (h * h * kappa, h * gamma), 1.0, A)
            if len(b) > 0:
                stored += 0.5 * kappa * depth * depth
                leaving = dot(n, U) if ahead else 0.0
                spread(c, own, mul(splat(h * kappa * (depth + h * leaving)), n), b)
    return stored


@kernel
def stopped(contact, mass, x, v):
    """The kinetic energy, J, of the two of each pair towards each other, at x with velocities v (n, 3)."""
    total = 0.0
    for k in range(len(contact.kind)):
        own, c, _, _, _, n, U = pressing(contact, x, v, k)
        light, towards = 0.0, min(dot(n, U), 0.0)
        for e in range(4):
            light += c[e] * c[e] * contact.free[own[e]] / mass[own[e]]
        total += 0.5 * towards * towards / light if light > 0.0 else 0.0
    return total


@kernel(absent=None)
def add_model(contact, y, u, w, s, f):
    """f += what pairs do in the model of a step, at its end y + s with the velocities w."""
    for k in range(len(contact.kind)):
        if not presses(contact, k):
            continue
        own, c, kappa, depth, gamma, n, _ = pressing(contact, y, u, k)
        push = kappa * (depth - dot(n, mixed(c, own, s)))
        spread(c, own, law.force(push, gamma, n, mixed(c, own, w)), f)


@kernel
def add_row(k, own, c, n, block, sign, A):
    """Add pair k with a block's push and rub to the matrix, or with a sign of −1 take it out."""
    on = 0.5 + 0.5 * sign
    keep(A.joined, k, c, n, on * block[0], on * block[1])
    low, high = law.block(sign * block[0], sign * block[1], n)
    for e in range(4):
        square = splat(c[e] * c[e])
        add_block(A.diagonal, own[e], mul(square, low), mul(square, high))


@kernel(empty=0, apart=0)
def meet(contact, at, h, end, drops, A, b):
    """What `meeting.meet` does, for pairs: those that press for the model are added where they are near at y, end
    so, deeper than FLAT says, or pass through each other on their way; where `drops` those that pull are taken out.
    """
    x, y, u, w = at
    combine(1.0, x, h, w, end)
    changed, on = 0, contact.on[contact.turn[0]]
    for k in range(len(contact.kind)):
        own, c, kappa, depth, gamma, n, _ = pressing(contact, y, u, k)
        at_y = mixed(c, own, y)
        presses = depth > dot(n, sub(mixed(c, own, end), at_y))
        if presses == on[k] or not (presses or drops):
            continue
        if presses and depth <= 0.0 and not arrives(contact, k, x, end):
            continue
        on[k] = presses
        changed += 1
        sign = 1.0 if presses else -1.0
        add_row(k, own, c, n, (h * h * kappa, h * gamma), sign, A)
        left = depth + dot(n, sub(at_y, mixed(c, own, x)))  # n·(y − x): h n·U where the step is linearised ahead
        Z = mixed(led(contact, own, c), own, w)
        spread(c, own, law.force(sign * h * kappa * (left - h * dot(n, Z)), sign * h * gamma, n, Z), b)
    return changed


@kernel
def led(contact, own, c):
    """The weights c where a pair is fixed, 0 where it is free."""
    free = contact.free
    one, other = c[0] * (1.0 - free[own[0]]), c[1] * (1.0 - free[own[1]])
    return one, other, c[2] * (1.0 - free[own[2]]), c[3] * (1.0 - free[own[3]])


@kernel
def arrives(contact, k, x, end):
    """Whether pair k ends nearer than its thickness, or passes through on its way from x to `end`, (n, 3) each."""
    if touch(contact, end, k)[-1] > FLAT * contact.thick:
        return True
    own, thickness = contact.vertices[k], contact.thickness[k]
    return nearest.passes(contact.kind[k], own, x, end, contact.thick, thickness)


@kernel(empty=None, apart=None)
def carry(contact, k):
    """Let the iteration after iteration k begin with the pairs that press in that."""
    for p in range(len(contact.kind)):
        contact.on[k + 1, p] = contact.on[k, p]


@kernel(absent=False)
def is_there(contact):
    """Whether there are pairs."""
    return len(contact.kind) > 0


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
        if not presses(contact, k):
            continue
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
        if not presses(contact, k):
            continue
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
