"""Air drag of the faces, in still air or wind.

Triangle (a, b, c): un-normalised normal n = (y_b − y_a) × (y_c − y_a), area |n|/2, mean velocity ū, wind W. Each
of the three vertices feels

    f = κ n (n·(W − ū)),   κ = drag · area / 3 = drag |n| / 6,  D = −κ n nᵀ (lumped: per vertex, not per mean),  K = 0.

n is not divided by its length: existing scenes are tuned to that. With Λ = Σ λ_i and per vertex θ_i = n·(w_i − u_i),
ν_i = n·λ_i:

    φ = h Σ λ_i·F_i = h κ [ (n·Λ)(n·(W − ū)) − Σ ν_i θ_i ].
"""

from __future__ import annotations

from math import sqrt
from typing import NamedTuple

import numpy as np

from clothfit.base.arrays import Array, Indices
from clothfit.engine.solve.sparse import add_block, outer
from clothfit.kernels.kernel import kernel
from clothfit.kernels.lanes.operations import add, fma, lane0, lane1, lane2, load3, mul, splat, store3, sub
from clothfit.kernels.vectors import cross, dot, vector


class Faces(NamedTuple):
    """Constants of the faces of one cloth that feel the air."""

    corners: Indices  # (T, 3), the vertices a, b, c; no rows where the air does nothing
    drag: float  # drag coefficient, kg/(m⁶ s)
    wind: Array  # W, (3,), m/s


def build(triangles: Indices, drag: float, wind: Array, fitted: bool = False) -> Faces:
    """The faces, or none of them where the drag coefficient is 0 and not `fitted`: no pass over them is ever made."""
    corners = triangles if drag > 0 or fitted else triangles[:0]
    return Faces(np.ascontiguousarray(corners), float(drag), np.array(wind, float))


@kernel
def at(x, faces, i):
    """The rows of x (n, 3) of the corners of face i."""
    return load3(x, faces.corners[i, 0]), load3(x, faces.corners[i, 1]), load3(x, faces.corners[i, 2])


@kernel
def edges(faces, y, i):
    """p = y_b − y_a and q = y_c − y_a of face i."""
    a, b, c = at(y, faces, i)
    return sub(b, a), sub(c, a)


@kernel
def normal(faces, y, i):
    """n of face i, and κ."""
    p, q = edges(faces, y, i)
    n = cross(p, q)
    return n, faces.drag / 6.0 * sqrt(dot(n, n))


@kernel
def mean(faces, u, i):
    """ū, the mean over the corners of face i."""
    a, b, c = at(u, faces, i)
    return mul(splat(1.0 / 3.0), add(add(a, b), c))


@kernel
def relative(faces, u, i):
    """W − ū of face i."""
    return sub(vector(faces.wind), mean(faces, u, i))


@kernel
def add_along(out, i, scale, n):
    """out_i += scale · n."""
    store3(fma(splat(scale), n, load3(out, i)), out, i)


@kernel
def powers(faces, y, u, w):
    """f·w, W, in its two parts: the push of the wind on a cloth that is still, and what its own velocity adds."""
    wind, drag = 0.0, 0.0
    still = vector(faces.wind)
    for i in range(len(faces.corners)):
        n, kappa = normal(faces, y, i)
        along = 3.0 * kappa * dot(n, mean(faces, w, i))
        wind += along * dot(n, still)
        drag -= along * dot(n, mean(faces, u, i))
    return wind, drag


@kernel(empty=None, apart=None)
def add_force(faces, y, u, f):
    for i in range(len(faces.corners)):
        n, kappa = normal(faces, y, i)
        push = kappa * dot(n, relative(faces, u, i))
        for corner in range(3):
            add_along(f, faces.corners[i, corner], push, n)


@kernel(empty=None, apart=None)
def add_damping(faces, y, u, scale, q, out):
    for i in range(len(faces.corners)):
        n, kappa = normal(faces, y, i)
        for corner in range(3):
            j = faces.corners[i, corner]
            add_along(out, j, -scale * kappa * dot(load3(q, j), n), n)


@kernel(empty=0.0, apart=0.0)
def add_step(faces, y, u, h, ahead, A, b):
    for i in range(len(faces.corners)):
        n, kappa = normal(faces, y, i)
        c = h * kappa
        low, high = outer(mul(splat(c), n), n)
        for corner in range(3):
            add_block(A.diagonal, faces.corners[i, corner], low, high)
        if len(b) > 0:
            push = dot(n, relative(faces, u, i))
            for corner in range(3):
                j = faces.corners[i, corner]
                add_along(b, j, c * (push + dot(load3(u, j), n)), n)
    return 0.0


@kernel(empty=None, apart=None)
def add_pullback(faces, y, u, w, s, lam, h, grad, gy, gu):
    for i in range(len(faces.corners)):
        n, kappa = normal(faces, y, i)
        size = dot(n, n)
        if size == 0.0:
            continue  # φ is of third order in n: its derivative is 0
        flow = relative(faces, u, i)
        eta = dot(n, flow)
        a, b, c = at(lam, faces, i)
        lam_sum = add(add(a, b), c)  # Λ
        total = dot(n, lam_sum)
        g = fma(splat(eta), lam_sum, mul(splat(total), flow))  # ∂[φ/(h κ)]/∂n at fixed κ
        value = total * eta
        for corner in range(3):
            j = faces.corners[i, corner]
            lam_j, change = load3(lam, j), sub(load3(w, j), load3(u, j))
            nu, theta = dot(n, lam_j), dot(n, change)
            value -= nu * theta
            g = fma(splat(-theta), lam_j, fma(splat(-nu), change, g))
            add_along(gu, j, h * kappa * (nu - total / 3.0), n)
        if len(grad.drag) > 0:
            grad.drag[0] += h / 6.0 * sqrt(size) * value
        if len(grad.wind) > 0:
            grad.wind[0] += h * kappa * total * lane0(n)
            grad.wind[1] += h * kappa * total * lane1(n)
            grad.wind[2] += h * kappa * total * lane2(n)
        g = fma(splat(value / size), n, g)  # κ = drag |n| / 6, so ∂κ/∂n = κ n / |n|²
        g, (p, q) = mul(splat(h * kappa), g), edges(faces, y, i)
        by_b, by_c = cross(q, g), cross(g, p)  # n = p × q: g·(dp × q) = dp·(q × g) and g·(p × dq) = dq·(g × p)
        add_along(gy, faces.corners[i, 1], 1.0, by_b)
        add_along(gy, faces.corners[i, 2], 1.0, by_c)
        add_along(gy, faces.corners[i, 0], -1.0, add(by_b, by_c))


@kernel(empty=None, apart=None)
def add_pushforward(faces, y, u, w, s, dy, du, direction, h, out):
    # F_j = κ n (η − θ_j): the product rule over κ, n, η and θ_j.
    for i in range(len(faces.corners)):
        n, kappa = normal(faces, y, i)
        size = dot(n, n)
        if size == 0.0:
            continue
        (p, q), (dp, dq) = edges(faces, y, i), edges(faces, dy, i)
        dn = add(cross(dp, q), cross(p, dq))
        dkappa = kappa * dot(n, dn) / size
        if len(direction.drag) > 0:
            dkappa += direction.drag[0] / 6.0 * sqrt(size)
        flow = relative(faces, u, i)
        eta = dot(n, flow)
        deta = dot(dn, flow) - dot(n, mean(faces, du, i))
        if len(direction.wind) > 0:
            deta += dot(n, vector(direction.wind))
        for corner in range(3):
            j = faces.corners[i, corner]
            change = sub(load3(w, j), load3(u, j))
            through = eta - dot(n, change)
            dthrough = deta - dot(dn, change) + dot(n, load3(du, j))
            add_along(out, j, h * (dkappa * through + kappa * dthrough), n)
            add_along(out, j, h * kappa * through, dn)
