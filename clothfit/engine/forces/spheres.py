"""Sphere colliders: a stiff push outward on vertices inside, without friction.

A vertex at distance δ < r from the centre c, with outward normal n = (y − c)/δ, feels

    f = κ (r − δ) n,   K = −κ n nᵀ  (the tangential part is left out),   D = 0,   κ = 1000 N/m,

so the step's model is F = κ [(r − δ) n − n (n·s)]. A vertex exactly at the centre is pushed up.
With P = I − n nᵀ:  ∂δ/∂y = n,  ∂n/∂y = P/δ.
"""

from __future__ import annotations

from math import sqrt
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from clothfit.base.arrays import Array
from clothfit.engine.solve.sparse import add_block, outer
from clothfit.kernels.kernel import kernel
from clothfit.kernels.lanes.operations import mul, pack, splat

STIFFNESS = 1000.0  # κ, N/m


class Spheres(NamedTuple):
    """The sphere colliders of a scene; no rows when there are none, and then no pass over the vertices is made."""

    centre: Array  # c, (C, 3), m
    radius: Array  # r, (C,), m
    early: bool = False  # whether a step also knows the contacts that a vertex's own way leads to (`begins`)


def build(centres: npt.ArrayLike, radii: npt.ArrayLike) -> Spheres:
    """Spheres at some centres (C, 3), m, with radii (C,), m; C may be 0."""
    return Spheres(np.array(centres, float).reshape(-1, 3), np.array(radii, float))


@kernel
def contact(spheres, y, i, c):
    """Depth r − δ (negative: no contact), distance δ, and normal n of vertex i at sphere c."""
    p0, p1, p2 = y[i, 0] - spheres.centre[c, 0], y[i, 1] - spheres.centre[c, 1], y[i, 2] - spheres.centre[c, 2]
    delta = sqrt(p0 * p0 + p1 * p1 + p2 * p2)
    if delta == 0.0:
        return spheres.radius[c], np.inf, 0.0, 1.0, 0.0  # an infinite δ: the normal does not turn with y
    return spheres.radius[c] - delta, delta, p0 / delta, p1 / delta, p2 / delta


@kernel
def begins(spheres, y, u, h, i, c):
    """Whether the way y + t u, 0 < t ≤ h, of vertex i enters sphere c from outside: with `early` steps know such
    contacts too, with the gap as a negative depth.
    """
    p0, p1, p2 = y[i, 0] - spheres.centre[c, 0], y[i, 1] - spheres.centre[c, 1], y[i, 2] - spheres.centre[c, 2]
    way = h * (p0 * u[i, 0] + p1 * u[i, 1] + p2 * u[i, 2])
    if not way < 0.0:
        return False
    part = min(1.0, -way / (h * h * (u[i, 0] * u[i, 0] + u[i, 1] * u[i, 1] + u[i, 2] * u[i, 2])))  # the nearest point
    p0, p1, p2 = p0 + part * h * u[i, 0], p1 + part * h * u[i, 1], p2 + part * h * u[i, 2]
    return p0 * p0 + p1 * p1 + p2 * p2 < spheres.radius[c] * spheres.radius[c]


@kernel
def energy(spheres, y):
    return energy_of_contacts(spheres, y, y)


@kernel
def energy_of_contacts(spheres, y, x):
    """The energy at y of the contacts that there are at x, (n, 3) each."""
    total = 0.0  # ½ κ (r − δ)²
    for c in range(len(spheres.radius)):
        for i in range(len(y)):
            depth = contact(spheres, y, i, c)[0]
            if depth > 0.0 and contact(spheres, x, i, c)[0] > 0.0:
                total += 0.5 * STIFFNESS * depth * depth
    return total


@kernel(empty=None, apart=None)
def add_force(spheres, y, u, f):
    for c in range(len(spheres.radius)):
        for i in range(len(y)):
            depth, _, n0, n1, n2 = contact(spheres, y, i, c)
            if depth > 0.0:
                f[i, 0] += STIFFNESS * depth * n0
                f[i, 1] += STIFFNESS * depth * n1
                f[i, 2] += STIFFNESS * depth * n2


@kernel(empty=0.0, apart=0.0)
def add_step(spheres, y, u, h, ahead, A, b):
    stiff, stored = h * h * STIFFNESS, 0.0
    for c in range(len(spheres.radius)):
        for i in range(len(y)):
            depth, _, n0, n1, n2 = contact(spheres, y, i, c)
            if depth > 0.0 or (spheres.early and begins(spheres, y, u, h, i, c)):
                n = pack(n0, n1, n2, 0.0)
                low, high = outer(mul(splat(stiff), n), n)
                add_block(A.diagonal, i, low, high)
                if len(b) > 0:
                    stored += STIFFNESS * max(depth, 0.0) * depth
                    outward = u[i, 0] * n0 + u[i, 1] * n1 + u[i, 2] * n2 if ahead else 0.0
                    push = h * STIFFNESS * (depth + h * outward)
                    b[i, 0] += push * n0
                    b[i, 1] += push * n1
                    b[i, 2] += push * n2
    return 0.5 * stored


@kernel(empty=None, apart=None)
def add_pullback(spheres, y, u, w, s, lam, h, grad, gy, gu):
    # φ = h κ [(r − δ) ν − ν σ],  ν = n·λ,  σ = n·s;  ∂ν/∂y = (λ − ν n)/δ,  ∂σ/∂y = (s − σ n)/δ
    for c in range(len(spheres.radius)):
        for i in range(len(y)):
            depth, delta, n0, n1, n2 = contact(spheres, y, i, c)
            if depth > 0.0 or (spheres.early and begins(spheres, y, u, h, i, c)):
                nu = n0 * lam[i, 0] + n1 * lam[i, 1] + n2 * lam[i, 2]
                sigma = n0 * s[i, 0] + n1 * s[i, 1] + n2 * s[i, 2]
                cl = (depth - sigma) / delta
                cs = -nu / delta
                cn = -nu - cl * nu - cs * sigma
                g0 = h * STIFFNESS * (cl * lam[i, 0] + cs * s[i, 0] + cn * n0)
                g1 = h * STIFFNESS * (cl * lam[i, 1] + cs * s[i, 1] + cn * n1)
                g2 = h * STIFFNESS * (cl * lam[i, 2] + cs * s[i, 2] + cn * n2)
                gy[i, 0] += g0
                gy[i, 1] += g1
                gy[i, 2] += g2
                if len(grad.offset) > 0:  # the force depends on y − c
                    grad.offset[0] -= g0
                    grad.offset[1] -= g1
                    grad.offset[2] -= g2


@kernel
def offset_of(direction):
    """How a change of the elements moves all colliders, m."""
    if len(direction.offset) > 0:
        return direction.offset[0], direction.offset[1], direction.offset[2]
    return 0.0, 0.0, 0.0


@kernel(empty=None, apart=None)
def add_pushforward(spheres, y, u, w, s, dy, du, direction, h, out):
    # F = κ (r − δ − σ) n, of y − c
    o0, o1, o2 = offset_of(direction)
    for c in range(len(spheres.radius)):
        for i in range(len(y)):
            depth, delta, n0, n1, n2 = contact(spheres, y, i, c)
            if depth > 0.0 or (spheres.early and begins(spheres, y, u, h, i, c)):
                d0, d1, d2 = dy[i, 0] - o0, dy[i, 1] - o1, dy[i, 2] - o2
                ddelta = n0 * d0 + n1 * d1 + n2 * d2
                m0 = (d0 - ddelta * n0) / delta
                m1 = (d1 - ddelta * n1) / delta
                m2 = (d2 - ddelta * n2) / delta
                sigma = n0 * s[i, 0] + n1 * s[i, 1] + n2 * s[i, 2]
                dsigma = m0 * s[i, 0] + m1 * s[i, 1] + m2 * s[i, 2]
                push = h * STIFFNESS * (depth - sigma)
                change = -h * STIFFNESS * (ddelta + dsigma)
                out[i, 0] += change * n0 + push * m0
                out[i, 1] += change * n1 + push * m1
                out[i, 2] += change * n2 + push * m2
