"""Pairs of a cloth that come nearer than its thickness, as rows of `contact`.

A pair, of a vertex and a triangle or of two edges, at the distance δ has the depth d = d₀ − δ, with the thickness d₀,
or the pair's distance at the start where that is less; c, n and δ are those of `nearest`. Its stiffness is κ s for the
share s of the pair, and V = 0: the forces of a pair have neither a sum nor a moment.

Which pairs may touch in a step `engine.contact_steps` says, and which of them press each iteration finds
(`contact.update_active`): those that end nearer than d₀, so that none pulls; some of them begin farther away, with d <
0.
"""

from __future__ import annotations

from math import sqrt
from typing import NamedTuple

import numpy as np

from clothfit.base.arrays import Array, Flags, Indices
from clothfit.engine.forces import law
from clothfit.engine.forces.law import mixed
from clothfit.engine.forces.selfcontact import nearest
from clothfit.engine.solve.sparse import add_block
from clothfit.kernels.kernel import kernel
from clothfit.kernels.lanes.operations import load3, mul, splat
from clothfit.kernels.vectors import dot

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
    turn: Indices  # (1,), the iteration that is computed, as `collider_rows.Colliders` has it
    depth: Array  # (P,), m, where the step was linearised at last
    slot: Indices  # (P, 6), places of the blocks between its vertices in the step's matrix (`sparse.SIDES`)


@kernel
def count(contact, y):
    return len(contact.kind)


@kernel
def row(contact, y, k):
    own, kind = contact.vertices[k], contact.kind[k]
    c, free, r = nearest.closest(kind, own, y)
    delta, share = sqrt(dot(r, r)), nearest.share(kind, own, y)
    if free == nearest.BOTH and nearest.side(kind, own, y) != contact.side[k]:
        delta = -delta
    ends, n, more = (own[0], own[1], own[2], own[3]), mul(splat(1.0 / delta), r), (-1, share, free, r, delta, kind)
    depth, kappa = contact.thickness[k] - delta, contact.stiffness * share
    return ends, c, n, depth, kappa, contact.friction, splat(0.0), more


@kernel
def level(contact, y, k):
    _, _, _, depth, kappa, _, _, _ = row(contact, y, k)
    return kappa, depth


@kernel
def behind(contact, y, k):
    return splat(0.0)


@kernel
def most(contact, y, k):
    return np.inf


@kernel
def load(contact, k):
    return -1.0, 0.0, 0.0


@kernel
def give_load(contact, k, by_load):
    return None


@kernel
def thick(contact, y, k):
    """Whether a pair passes through is asked instead."""
    return np.inf


@kernel
def is_far(contact, y, k, way, depth):
    return not contact.on[contact.turn[0], k]


@kernel
def knows(contact, y, k, found, way):
    return contact.on[contact.turn[0], k]


@kernel
def lay(contact, k, found, push, rub, turn, sign, A):
    own, c, n, _, _, _, _, _ = found
    low, high = law.block(sign * push, sign * rub, n)
    side = 0
    for e in range(4):
        square = splat(c[e] * c[e])
        add_block(A.diagonal, own[e], mul(square, low), mul(square, high))
        for f in range(e + 1, 4):
            both = splat(c[e] * c[f])
            add_block(A.upper, contact.slot[k, side], mul(both, low), mul(both, high))
            side += 1


@kernel
def is_open(contact, k):
    return True


@kernel
def is_reached(contact, k, free, y, end, least):
    return True


@kernel
def may_change(contact, k, found, presses, at, end, h):
    """Whether pair k does not begin to press, or is near at y, ends so, deeper than FLAT says, or passes through on its
    way from x to `end`, (n, 3) each.
    """
    if not presses or found[3] > 0.0 or row(contact, end, k)[3] > FLAT * contact.thick:
        return True
    thickness = contact.thickness[k]
    return nearest.passes(contact.kind[k], contact.vertices[k], at[0], end, contact.thick, thickness)


@kernel(empty=False, apart=False)
def passing(contact, x, end):
    """Whether a pair passes through on the way from x to `end`, (n, 3) each."""
    for k in range(len(contact.kind)):
        if nearest.passes(contact.kind[k], contact.vertices[k], x, end, contact.thick, contact.thickness[k]):
            return True
    return False


@kernel
def changes(contact, y, found, dy, direction):
    own, c, n, _, _, _, _, (_, share, free, r, delta, kind) = found
    dc, dn, ddelta = nearest.moved(kind, own, y, free, c, r, delta, n, dy)
    more = nearest.share_change(own, y, dy) if share < 1.0 else 0.0
    return dc, dn, ddelta, splat(0.0), contact.stiffness * more, splat(0.0)


@kernel
def add_back(contact, found, vectors, by_law, at, h, grad, gy):
    own, c, n, _, _, _, _, (_, share, free, r, delta, kind) = found
    by_c = (
        weight_slope(own[0], vectors, at), weight_slope(own[1], vectors, at), weight_slope(own[2], vectors, at),
        weight_slope(own[3], vectors, at),
    )  # fmt: skip
    nearest.add_moved_back(kind, own, at[0], free, c, r, delta, n, by_c, vectors[0], by_law[0], h, gy)
    if share < 1.0:
        nearest.add_share_back(own, at[0], h * contact.stiffness * by_law[2], gy)


@kernel
def weight_slope(i, vectors, at):
    """The gradient by the weight of vertex i, from those by the sums that it is in."""
    _, by_U, by_S, by_Z, by_L = vectors
    _, u, w, s, lam = at
    total = dot(by_L, load3(lam, i)) + dot(by_S, load3(s, i))
    return total + dot(by_Z, load3(w, i)) + dot(by_U, load3(u, i))


@kernel
def leaving(contact, found, begin):
    return 0.0


@kernel
def pass_on(contact, k, free, at, h, end):
    return contact.on[contact.turn[0], k]


@kernel
def stopped(contact, mass, x, v):
    """The kinetic energy, J, of the two of each pair towards each other, at x with velocities v (n, 3)."""
    total = 0.0
    for k in range(len(contact.kind)):
        own, c, n, _, _, _, _, _ = row(contact, x, k)
        light, towards = 0.0, min(dot(n, mixed(c, own, v)), 0.0)
        for e in range(4):
            light += c[e] * c[e] * contact.free[own[e]] / mass[own[e]]
        total += 0.5 * towards * towards / light if light > 0.0 else 0.0
    return total


@kernel
def find_parts(contact, y, out):
    """out (P,) = which parameters of each pair's closest points are free (`nearest`)."""
    for k in range(len(contact.kind)):
        out[k] = nearest.closest(contact.kind[k], contact.vertices[k], y)[1]
