"""What moves together: pairs that would pass through each other whatever the forces are.

Pairs that share vertices form a zone. All of its vertices get the velocity of its centre of mass, or that of its fixed
vertices where it has such: an inelastic impact, which keeps the momentum. So nothing in a zone passes through
anything else in it. For the velocities u that a step has found, with M the mass of the zone,

    w = Σ m u / M,    dw = Σ (m du + (u − w) dm)/M.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from clothfit.base.arrays import Array, Elements, Indices
from clothfit.base.eigen import connected_components
from clothfit.engine.forces.vertex import Vertex
from clothfit.kernels.kernel import kernel
from clothfit.kernels.vectors import copy_row


class Zones(NamedTuple):
    """Z zones of N vertices in all."""

    first: Indices  # (Z + 1,): zone z has the vertices member[first[z]] … member[first[z + 1] − 1]
    member: Indices  # (N,)
    found: Array  # (N, 3), m/s, u of each


def of_pairs(vertices: Indices, n: int, found: Array) -> Zones:
    """The zones of pairs with these vertices (P, 4), of a cloth with n, whose velocities are `found` (n, 3)."""
    label = connected_components(np.stack([np.repeat(vertices[:, 0], 3), vertices[:, 1:].ravel()], 1), n)
    touched = np.unique(vertices)
    member = touched[np.argsort(label[touched], kind="stable")].astype(np.int32)
    first = np.flatnonzero(np.diff(label[member], prepend=-1, append=-1)).astype(np.int32)
    return Zones(first, member, found[member])


@kernel
def means(zones, vertex):
    """The part (N,) that each member has in the velocity of its zone, those velocities (Z, 3), and 1/M (Z,), 0 where
    something is fixed.
    """
    count = len(zones.first) - 1
    part, mean, light = np.zeros(len(zones.member)), np.zeros((count, 3)), np.zeros(count)
    for z in range(count):
        mass, fixed = 0.0, 0
        for e in range(zones.first[z], zones.first[z + 1]):
            mass += vertex.mass[zones.member[e]]
            fixed += 0 if vertex.free[zones.member[e]] else 1
        light[z] = 0.0 if fixed > 0 else 1.0 / mass
        for e in range(zones.first[z], zones.first[z + 1]):
            i = zones.member[e]
            part[e] = vertex.mass[i] / mass
            if fixed > 0:
                part[e] = 0.0 if vertex.free[i] else 1.0 / fixed
            for c in range(3):
                mean[z, c] += part[e] * zones.found[e, c]
    return part, mean, light


@kernel
def join(zones, vertex, w):
    """Give the free vertices of each zone its velocity, in w (n, 3)."""
    _, mean, _ = means(zones, vertex)
    for z in range(len(mean)):
        for e in range(zones.first[z], zones.first[z + 1]):
            if vertex.free[zones.member[e]]:
                for c in range(3):
                    w[zones.member[e], c] = mean[z, c]


def work(zones: Zones, vertex: Vertex, w: Array) -> float:
    """What the fixed vertices in zones do on the others, whose velocities are w (n, 3), J."""
    own = w[zones.member]
    return float(np.einsum("i,ij,ij", (vertex.mass * vertex.free)[zones.member], own - zones.found, own))


@kernel
def pull(zones, vertex, h, x_bar, v_bar, grad):
    """Turn v_bar, the gradient by w, into that by u, where x_bar (n, 3) holds that by x + h w; add to `grad`."""
    part, mean, light = means(zones, vertex)
    for z in range(len(mean)):
        for c in range(3):
            total = 0.0
            for e in range(zones.first[z], zones.first[z + 1]):
                i = zones.member[e]
                if vertex.free[i]:
                    total += v_bar[i, c] + h * x_bar[i, c]
                    v_bar[i, c] = -h * x_bar[i, c]
            for e in range(zones.first[z], zones.first[z + 1]):
                v_bar[zones.member[e], c] += part[e] * total
                grad.mass[zones.member[e]] += light[z] * (zones.found[e, c] - mean[z, c]) * total


def push(zones: Zones, vertex: Vertex, h: float, direction: Elements, dx: Array, dv: Array) -> None:
    """Turn dv, the change of u, into that of w, and dx (n, 3), the change of x + h u, into that of x + h w."""
    every = np.arange(len(dx) + 1, dtype=np.int32)
    mass = every, np.zeros(len(dx), np.int32), direction.mass
    push_columns(zones, vertex, every, h, mass, dx.reshape(-1, 1), dv.reshape(-1, 1))


@kernel
def push_columns(zones, vertex, place, h, mass, dx, dv):
    """The same for all columns (3 f, Q) of the vertices that have a `place` there, others have −1; `mass` has which
    entries, columns and factors each mass has.
    """
    part, mean, light = means(zones, vertex)
    start, column, factor = mass
    change = np.zeros(dx.shape[1])
    for z in range(len(mean)):
        for c in range(3):
            change[:] = 0.0
            for e in range(zones.first[z], zones.first[z + 1]):
                i = zones.member[e]
                if place[i] >= 0:
                    add_row(part[e], dv[3 * place[i] + c], change)
                for entry in range(start[i], start[i + 1]):
                    if column[entry] >= 0:
                        change[column[entry]] += factor[entry] * light[z] * (zones.found[e, c] - mean[z, c])
            for e in range(zones.first[z], zones.first[z + 1]):
                i = zones.member[e]
                if vertex.free[i]:
                    row = 3 * place[i] + c
                    add_row(h, change, dx[row])
                    add_row(-h, dv[row], dx[row])
                    copy_row(change, dv[row])


@kernel
def add_row(factor, row, out):
    """out += factor · row."""
    if factor != 0.0:
        for q in range(len(out)):
            out[q] += factor * row[q]
