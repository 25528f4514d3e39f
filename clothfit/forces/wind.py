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

from clothfit.arrays import Array, Indices
from clothfit.kernel import kernel
from clothfit.sparse import add_outer


class Faces(NamedTuple):
    """Constants of the faces of one cloth that feel the air."""

    corners: Indices  # (T, 3), the vertices a, b, c; no rows where nobody needs the air
    drag: float  # drag coefficient, kg/(m⁶ s)
    wind: Array  # W, (3,), m/s


def build(triangles: Indices, drag: float, wind: Array, fitted: bool = False) -> Faces:
    """The faces, or none of them where the drag coefficient is 0 and not `fitted`: no pass over them is ever made."""
    corners = triangles if drag > 0 or fitted else triangles[:0]
    return Faces(np.ascontiguousarray(corners), float(drag), np.array(wind, float))


@kernel
def edges(faces, y, i):
    """p = y_b − y_a and q = y_c − y_a of face i, as six numbers."""
    a, b, c = faces.corners[i, 0], faces.corners[i, 1], faces.corners[i, 2]
    return (
        y[b, 0] - y[a, 0], y[b, 1] - y[a, 1], y[b, 2] - y[a, 2],
        y[c, 0] - y[a, 0], y[c, 1] - y[a, 1], y[c, 2] - y[a, 2],
    )  # fmt: skip


@kernel
def normal(faces, y, i):
    """n of face i, and κ."""
    p0, p1, p2, q0, q1, q2 = edges(faces, y, i)
    n0, n1, n2 = p1 * q2 - p2 * q1, p2 * q0 - p0 * q2, p0 * q1 - p1 * q0
    return n0, n1, n2, faces.drag / 6.0 * sqrt(n0 * n0 + n1 * n1 + n2 * n2)


@kernel
def mean(faces, u, i, component):
    """Mean of one component of u over the corners of face i."""
    return (
        u[faces.corners[i, 0], component] + u[faces.corners[i, 1], component] + u[faces.corners[i, 2], component]
    ) / 3.0


@kernel
def inflow(faces, u, i, n0, n1, n2):
    """n·(W − ū) of face i."""
    return (
        n0 * (faces.wind[0] - mean(faces, u, i, 0))
        + n1 * (faces.wind[1] - mean(faces, u, i, 1))
        + n2 * (faces.wind[2] - mean(faces, u, i, 2))
    )


@kernel
def along(x, i, n0, n1, n2):
    """n·x_i."""
    return n0 * x[i, 0] + n1 * x[i, 1] + n2 * x[i, 2]


@kernel
def add_along(out, i, scale, n0, n1, n2):
    """out_i += scale · n."""
    out[i, 0] += scale * n0
    out[i, 1] += scale * n1
    out[i, 2] += scale * n2


@kernel
def add_force(faces, y, u, f):
    for i in range(len(faces.corners)):
        n0, n1, n2, kappa = normal(faces, y, i)
        push = kappa * inflow(faces, u, i, n0, n1, n2)
        for corner in range(3):
            add_along(f, faces.corners[i, corner], push, n0, n1, n2)


@kernel
def add_damping(faces, y, scale, q, out):
    for i in range(len(faces.corners)):
        n0, n1, n2, kappa = normal(faces, y, i)
        for corner in range(3):
            j = faces.corners[i, corner]
            add_along(out, j, -scale * kappa * along(q, j, n0, n1, n2), n0, n1, n2)


@kernel
def add_step(faces, y, u, h, A, b):
    for i in range(len(faces.corners)):
        n0, n1, n2, kappa = normal(faces, y, i)
        push = inflow(faces, u, i, n0, n1, n2)
        c = h * kappa
        for corner in range(3):
            j = faces.corners[i, corner]
            add_outer(A.diagonal, j, c, n0, n1, n2)
            add_along(b, j, c * (push + along(u, j, n0, n1, n2)), n0, n1, n2)


@kernel
def add_pullback(faces, y, u, w, s, lam, h, grad, gy, gu):
    for i in range(len(faces.corners)):
        n0, n1, n2, kappa = normal(faces, y, i)
        size = n0 * n0 + n1 * n1 + n2 * n2
        if size == 0.0:
            continue  # φ is of third order in n: its derivative is 0
        eta = inflow(faces, u, i, n0, n1, n2)
        g0 = g1 = g2 = 0.0  # ∂[φ/(h κ)]/∂n at fixed κ
        t0, t1, t2 = 0.0, 0.0, 0.0  # Λ
        value = 0.0
        for corner in range(3):
            j = faces.corners[i, corner]
            q0, q1, q2 = w[j, 0] - u[j, 0], w[j, 1] - u[j, 1], w[j, 2] - u[j, 2]
            theta = n0 * q0 + n1 * q1 + n2 * q2
            nu = along(lam, j, n0, n1, n2)
            value -= nu * theta
            g0 -= lam[j, 0] * theta + q0 * nu
            g1 -= lam[j, 1] * theta + q1 * nu
            g2 -= lam[j, 2] * theta + q2 * nu
            t0, t1, t2 = t0 + lam[j, 0], t1 + lam[j, 1], t2 + lam[j, 2]
            add_along(gu, j, h * kappa * nu, n0, n1, n2)
        total = n0 * t0 + n1 * t1 + n2 * t2
        for corner in range(3):
            add_along(gu, faces.corners[i, corner], -h * kappa * total / 3.0, n0, n1, n2)
        value += total * eta
        if len(grad.drag) > 0:
            grad.drag[0] += h / 6.0 * sqrt(size) * value
        if len(grad.wind) > 0:
            grad.wind[0] += h * kappa * total * n0
            grad.wind[1] += h * kappa * total * n1
            grad.wind[2] += h * kappa * total * n2
        # κ = drag |n| / 6, so ∂κ/∂n = κ n / |n|²
        g0 += t0 * eta + total * (faces.wind[0] - mean(faces, u, i, 0)) + value * n0 / size
        g1 += t1 * eta + total * (faces.wind[1] - mean(faces, u, i, 1)) + value * n1 / size
        g2 += t2 * eta + total * (faces.wind[2] - mean(faces, u, i, 2)) + value * n2 / size
        add_normal_pullback(faces, y, i, h * kappa * g0, h * kappa * g1, h * kappa * g2, gy)


@kernel
def add_normal_pullback(faces, y, i, g0, g1, g2, gy):
    """gy += gᵀ ∂n/∂y of face i: with n = p × q, g·(dp × q) = dp·(q × g) and g·(p × dq) = dq·(g × p)."""
    a, b, c = faces.corners[i, 0], faces.corners[i, 1], faces.corners[i, 2]
    p0, p1, p2, q0, q1, q2 = edges(faces, y, i)
    b0, b1, b2 = q1 * g2 - q2 * g1, q2 * g0 - q0 * g2, q0 * g1 - q1 * g0
    c0, c1, c2 = g1 * p2 - g2 * p1, g2 * p0 - g0 * p2, g0 * p1 - g1 * p0
    add_along(gy, b, 1.0, b0, b1, b2)
    add_along(gy, c, 1.0, c0, c1, c2)
    add_along(gy, a, -1.0, b0 + c0, b1 + c1, b2 + c2)


@kernel
def normal_pushforward(faces, y, dy, i):
    """dn of face i: dp × q + p × dq."""
    p0, p1, p2, q0, q1, q2 = edges(faces, y, i)
    dp0, dp1, dp2, dq0, dq1, dq2 = edges(faces, dy, i)
    return (
        dp1 * q2 - dp2 * q1 + p1 * dq2 - p2 * dq1,
        dp2 * q0 - dp0 * q2 + p2 * dq0 - p0 * dq2,
        dp0 * q1 - dp1 * q0 + p0 * dq1 - p1 * dq0,
    )


@kernel
def add_pushforward(faces, y, u, w, s, dy, du, direction, h, out):
    # F_j = κ n (η − θ_j): the product rule over κ, n, η and θ_j.
    for i in range(len(faces.corners)):
        n0, n1, n2, kappa = normal(faces, y, i)
        size = n0 * n0 + n1 * n1 + n2 * n2
        if size == 0.0:
            continue
        m0, m1, m2 = normal_pushforward(faces, y, dy, i)
        dkappa = kappa * (n0 * m0 + n1 * m1 + n2 * m2) / size
        if len(direction.drag) > 0:
            dkappa += direction.drag[0] / 6.0 * sqrt(size)
        eta = inflow(faces, u, i, n0, n1, n2)
        deta = inflow(faces, u, i, m0, m1, m2) - (
            n0 * mean(faces, du, i, 0) + n1 * mean(faces, du, i, 1) + n2 * mean(faces, du, i, 2)
        )
        if len(direction.wind) > 0:
            deta += n0 * direction.wind[0] + n1 * direction.wind[1] + n2 * direction.wind[2]
        for corner in range(3):
            j = faces.corners[i, corner]
            theta = along(w, j, n0, n1, n2) - along(u, j, n0, n1, n2)
            dtheta = along(w, j, m0, m1, m2) - along(u, j, m0, m1, m2) - along(du, j, n0, n1, n2)
            flow = eta - theta
            add_along(out, j, h * (dkappa * flow + kappa * (deta - dtheta)), n0, n1, n2)
            add_along(out, j, h * kappa * flow, m0, m1, m2)
