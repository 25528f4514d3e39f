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
from clothfit.engine.forces import law
from clothfit.engine.solve.sparse import add_block
from clothfit.kernels.kernel import kernel
from clothfit.kernels.lanes.operations import add, div, lane0, lane1, lane2, load3, mul, pack, splat, store3, sub
from clothfit.kernels.vectors import dot, vector

STIFFNESS = 1000.0  # κ, N/m


class Spheres(NamedTuple):
    """The sphere colliders of a scene; no rows when there are none, and then no pass over the vertices is made."""

    centre: Array  # c, (C, 3), m
    radius: Array  # r, (C,), m
    predictive: bool = False  # whether a step also knows the contacts that a vertex's own way leads to (`enters`)


def build(centres: npt.ArrayLike, radii: npt.ArrayLike) -> Spheres:
    """Spheres at some centres (C, 3), m, with radii (C,), m; C may be 0."""
    return Spheres(np.array(centres, float).reshape(-1, 3), np.array(radii, float))


@kernel
def contact(spheres, y, i, c):
    """Depth r − δ (negative: no contact), distance δ, and normal n of vertex i at sphere c."""
    p = sub(load3(y, i), load3(spheres.centre, c))
    delta = sqrt(dot(p, p))
    if delta == 0.0:
        return spheres.radius[c], np.inf, pack(0.0, 1.0, 0.0, 0.0)  # an infinite δ: the normal does not turn with y
    return spheres.radius[c] - delta, delta, div(p, splat(delta))


@kernel
def enters(spheres, y, u, h, i, c):
    """Whether the way y + t u, 0 < t ≤ h, of vertex i enters sphere c from outside: with `predictive` steps know such
    contacts too, with the gap as a negative depth.
    """
    p, u_i = sub(load3(y, i), load3(spheres.centre, c)), load3(u, i)
    way = h * dot(p, u_i)
    if not way < 0.0:
        return False
    part = min(1.0, -way / (h * h * dot(u_i, u_i)))  # to the nearest point
    p = add(p, mul(splat(part * h), u_i))
    return dot(p, p) < spheres.radius[c] * spheres.radius[c]


@kernel
def add_times(out, i, scale, n):
    """out_i += scale · n, the product rounded: existing scenes move to the last bit as they did."""
    store3(add(load3(out, i), mul(splat(scale), n)), out, i)


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
            depth, _, n = contact(spheres, y, i, c)
            if depth > 0.0:
                add_times(f, i, STIFFNESS * depth, n)


@kernel(empty=0.0, apart=0.0)
def add_step(spheres, y, u, h, ahead, A, b):
    stiff, stored = h * h * STIFFNESS, 0.0
    for c in range(len(spheres.radius)):
        for i in range(len(y)):
            depth, delta, n = contact(spheres, y, i, c)
            if depth > 0.0 or (spheres.predictive and enters(spheres, y, u, h, i, c)):
                low, high = law.block(stiff, -law.turning(h, stiff, depth) / delta, n)
                add_block(A.diagonal, i, low, high)
                if len(b) > 0:
                    stored += STIFFNESS * max(depth, 0.0) * depth
                    outward = dot(load3(u, i), n) if ahead else 0.0
                    push = h * STIFFNESS * (depth + h * outward)
                    add_times(b, i, push, n)
    return 0.5 * stored


@kernel(empty=None, apart=None)
def add_pullback(spheres, y, u, w, s, lam, h, grad, gy, gu):
    # φ = h κ [(r − δ) ν − ν σ],  ν = n·λ,  σ = n·s;  ∂ν/∂y = (λ − ν n)/δ,  ∂σ/∂y = (s − σ n)/δ
    for c in range(len(spheres.radius)):
        for i in range(len(y)):
            depth, delta, n = contact(spheres, y, i, c)
            if depth > 0.0 or (spheres.predictive and enters(spheres, y, u, h, i, c)):
                lam_i, s_i = load3(lam, i), load3(s, i)
                nu, sigma = dot(n, lam_i), dot(n, s_i)
                cl, cs = (depth - sigma) / delta, -nu / delta
                cn = -nu - cl * nu - cs * sigma
                g = add(add(mul(splat(cl), lam_i), mul(splat(cs), s_i)), mul(splat(cn), n))
                g = mul(splat(h * STIFFNESS), g)
                store3(add(load3(gy, i), g), gy, i)
                if len(grad.offset) > 0:  # the force depends on y − c
                    grad.offset[0] -= lane0(g)
                    grad.offset[1] -= lane1(g)
                    grad.offset[2] -= lane2(g)


@kernel
def offset_of(direction):
    """How a change of the elements moves all colliders, m."""
    return vector(direction.offset) if len(direction.offset) > 0 else splat(0.0)


@kernel(empty=None, apart=None)
def add_pushforward(spheres, y, u, w, s, dy, du, direction, h, out):
    # F = κ (r − δ − σ) n, of y − c
    offset = offset_of(direction)
    for c in range(len(spheres.radius)):
        for i in range(len(y)):
            depth, delta, n = contact(spheres, y, i, c)
            if depth > 0.0 or (spheres.predictive and enters(spheres, y, u, h, i, c)):
                d, s_i = sub(load3(dy, i), offset), load3(s, i)
                ddelta = dot(n, d)
                m = div(sub(d, mul(splat(ddelta), n)), splat(delta))
                push = h * STIFFNESS * (depth - dot(n, s_i))
                change = -h * STIFFNESS * (ddelta + dot(m, s_i))
                store3(add(load3(out, i), add(mul(splat(change), n), mul(splat(push), m))), out, i)
