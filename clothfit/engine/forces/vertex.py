"""Weight and node damping: f_i = m_i (g − α v_i), with K = 0 and D = −α m_i I.

Symbols: m (n,) kg, α 1/s, g (3,) m/s². Linear in v, so in the step's model the velocity before the step drops
out: F(w) = m (g − α w).
"""

from __future__ import annotations

from typing import NamedTuple

from clothfit.base.arrays import Array, Flags, Indices
from clothfit.engine.solve.sparse import XX, YY, ZZ
from clothfit.kernels.kernel import kernel
from clothfit.kernels.vectors import item


class Vertex(NamedTuple):
    """Constants of the vertices of one cloth."""

    mass: Array  # m, (n,), kg
    damping: Array  # α of each object, (K,), 1/s
    gravity: Array  # g, (3,), m/s²
    free: Flags  # (n,), False where the vertex is fixed
    object: Indices | None = None  # (n,), the object of each vertex; None: there is one


@kernel
def energy(vertex, y):
    total = 0.0  # −m g·y
    for i in range(len(vertex.mass)):
        for c in range(3):
            total -= vertex.mass[i] * vertex.gravity[c] * y[i, c]
    return total


@kernel
def damping_power(vertex, y, u, w):
    total = 0.0
    for i in range(len(vertex.mass)):
        for c in range(3):
            total -= vertex.damping[item(vertex.object, i)] * vertex.mass[i] * u[i, c] * w[i, c]
    return total


@kernel
def add_force(vertex, y, u, f):
    for i in range(len(vertex.mass)):
        m, alpha = vertex.mass[i], vertex.damping[item(vertex.object, i)]
        for c in range(3):
            f[i, c] += m * (vertex.gravity[c] - alpha * u[i, c])


@kernel
def add_damping(vertex, y, u, scale, q, out):
    for i in range(len(vertex.mass)):
        alpha = vertex.damping[item(vertex.object, i)]
        for c in range(3):
            out[i, c] -= scale * alpha * vertex.mass[i] * q[i, c]


@kernel
def add_step(vertex, y, u, h, ahead, A, b):
    for i in range(len(vertex.mass)):
        m = vertex.mass[i]
        damping = h * vertex.damping[item(vertex.object, i)] * m
        A.diagonal[i, XX] += damping
        A.diagonal[i, YY] += damping
        A.diagonal[i, ZZ] += damping
        if len(b) > 0:
            for c in range(3):
                b[i, c] += h * m * vertex.gravity[c]
    return 0.0


@kernel
def add_pullback(vertex, y, u, w, s, lam, h, grad, gy, gu):
    # φ = h m λ·(g − α w): no y, no u.
    for i in range(len(vertex.mass)):
        own = item(vertex.object, i)
        for c in range(3):
            grad.mass[i] += h * lam[i, c] * (vertex.gravity[c] - vertex.damping[own] * w[i, c])
            if len(grad.damping) > 0:
                grad.damping[own] -= h * vertex.mass[i] * lam[i, c] * w[i, c]
            if len(grad.gravity) > 0:
                grad.gravity[c] += h * vertex.mass[i] * lam[i, c]


@kernel
def add_pushforward(vertex, y, u, w, s, dy, du, direction, h, out):
    for i in range(len(vertex.mass)):
        own = item(vertex.object, i)
        for c in range(3):
            out[i, c] += h * direction.mass[i] * (vertex.gravity[c] - vertex.damping[own] * w[i, c])
            if len(direction.damping) > 0:
                out[i, c] -= h * vertex.mass[i] * direction.damping[own] * w[i, c]
            if len(direction.gravity) > 0:
                out[i, c] += h * vertex.mass[i] * direction.gravity[c]
