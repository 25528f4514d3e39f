"""What moves together: pairs that would pass through each other whatever the forces are.

Pairs that share vertices form a zone. All of its vertices get the velocity of its centre of mass, or that of its fixed
vertices where it has such: an inelastic impact, which keeps the momentum. So nothing in a zone passes through
anything else in it. For the velocities u that a step has found, with M the mass of the zone,

    w = Σ m u / M,    dw = Σ (m du + (u − w) dm)/M.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from clothfit.base.arrays import Array, Indices
from clothfit.kernels.kernel import kernel


class Zones(NamedTuple):
    """Z zones of N vertices in all."""

    first: Indices  # (Z + 1,): zone z has the vertices member[first[z]] … member[first[z + 1] − 1]
    member: Indices  # (N,)
    found: Array  # (N, 3), m/s, u of each


def of_pairs(vertices: Indices, n: int, found: Array) -> Zones:
    """The zones of pairs with these vertices (P, 4), of a cloth with n, whose velocities are `found` (n, 3)."""
    from scipy.sparse import coo_array
    from scipy.sparse.csgraph import connected_components

    ends = np.repeat(vertices[:, 0], 3), vertices[:, 1:].ravel()
    label = connected_components(coo_array((np.ones(len(ends[0])), ends), shape=(n, n)), directed=False)[1]
    touched = np.unique(vertices)
    member = touched[np.argsort(label[touched], kind="stable")].astype(np.int32)
    first = np.flatnonzero(np.diff(label[member], prepend=-1, append=-1)).astype(np.int32)
    return Zones(first, member, found[member])


@kernel
def masses(zones, vertex, z):
    """The mass of the free vertices of zone z, and how many are fixed."""
    mass, fixed = 0.0, 0
    for e in range(zones.first[z], zones.first[z + 1]):
        i = zones.member[e]
        if vertex.free[i]:
            mass += vertex.mass[i]
        else:
            fixed += 1
    return mass, fixed


@kernel
def centre(zones, vertex, z, w):
    """Write the velocity of zone z to w (3,)."""
    mass, fixed = masses(zones, vertex, z)
    w[:] = 0.0
    for e in range(zones.first[z], zones.first[z + 1]):
        i = zones.member[e]
        if fixed > 0 and vertex.free[i]:
            continue
        part = 1.0 / fixed if fixed > 0 else vertex.mass[i] / mass
        for c in range(3):
            w[c] += part * zones.found[e, c]


@kernel
def join(zones, vertex, w):
    """Give the free vertices of each zone its velocity, in w (n, 3)."""
    mean = np.zeros(3)
    for z in range(len(zones.first) - 1):
        centre(zones, vertex, z, mean)
        for e in range(zones.first[z], zones.first[z + 1]):
            i = zones.member[e]
            if vertex.free[i]:
                for c in range(3):
                    w[i, c] = mean[c]


@kernel
def pull(zones, vertex, h, x_bar, v_bar, grad):
    """Turn v_bar, the gradient by w, into that by u, where x_bar (n, 3) holds that by x + h w; add to `grad`."""
    mean, total = np.zeros(3), np.zeros(3)
    for z in range(len(zones.first) - 1):
        mass, fixed = masses(zones, vertex, z)
        centre(zones, vertex, z, mean)
        total[:] = 0.0
        for e in range(zones.first[z], zones.first[z + 1]):
            i = zones.member[e]
            if vertex.free[i]:
                for c in range(3):
                    total[c] += v_bar[i, c] + h * x_bar[i, c]
        for e in range(zones.first[z], zones.first[z + 1]):
            i = zones.member[e]
            if vertex.free[i]:
                for c in range(3):
                    v_bar[i, c] = -h * x_bar[i, c]
                    if fixed == 0:
                        v_bar[i, c] += vertex.mass[i] / mass * total[c]
                        grad.mass[i] += (zones.found[e, c] - mean[c]) * total[c] / mass
            else:
                for c in range(3):
                    v_bar[i, c] += total[c] / fixed


@kernel
def push(zones, vertex, h, direction, dx, dv):
    """Turn dv, the change of u, into that of w, and dx (n, 3), the change of x + h u, into that of x + h w."""
    mean, change = np.zeros(3), np.zeros(3)
    for z in range(len(zones.first) - 1):
        mass, fixed = masses(zones, vertex, z)
        centre(zones, vertex, z, mean)
        change[:] = 0.0
        for e in range(zones.first[z], zones.first[z + 1]):
            i = zones.member[e]
            if vertex.free[i] and fixed == 0:
                for c in range(3):
                    more = vertex.mass[i] * dv[i, c] + direction.mass[i] * (zones.found[e, c] - mean[c])
                    change[c] += more / mass
            elif not vertex.free[i]:
                for c in range(3):
                    change[c] += dv[i, c] / fixed
        for e in range(zones.first[z], zones.first[z + 1]):
            i = zones.member[e]
            if vertex.free[i]:
                for c in range(3):
                    dx[i, c] += h * (change[c] - dv[i, c])
                    dv[i, c] = change[c]
