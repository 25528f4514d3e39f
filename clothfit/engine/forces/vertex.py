"""Weight and node damping: f_i = m_i (g − α v_i), with K = 0 and D = −α m_i I.

Symbols: m (n,) kg, α 1/s, g (3,) m/s². Linear in v, so in the step's model the velocity before the step drops
out: F(w) = m (g − α w).
"""

from __future__ import annotations

from typing import NamedTuple

from clothfit.base.arrays import Array, Flags
from clothfit.engine.solve.sparse import XX, YY, ZZ
from clothfit.kernels.kernel import kernel


class Vertex(NamedTuple):
    """Constants of the vertices of one cloth."""

    mass: Array  # m, (n,), kg
    damping: float  # α, 1/s
    gravity: Array  # g, (3,), m/s²
    free: Flags  # (n,), False where the vertex is fixed


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
            total -= vertex.damping * vertex.mass[i] * u[i, c] * w[i, c]
    return total


@kernel
def add_force(vertex, y, u, f):
    for i in range(len(vertex.mass)):
        m = vertex.mass[i]
        for c in range(3):
            f[i, c] += m * (vertex.gravity[c] - vertex.damping * u[i, c])


@kernel
def add_damping(vertex, y, u, scale, q, out):
    for i in range(len(vertex.mass)):
        for c in range(3):
            out[i, c] -= scale * vertex.damping * vertex.mass[i] * q[i, c]


@kernel
def add_step(vertex, y, u, h, ahead, A, b):
    for i in range(len(vertex.mass)):
        m = vertex.mass[i]
        damping = h * vertex.damping * m
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
        for c in range(3):
            grad.mass[i] += h * lam[i, c] * (vertex.gravity[c] - vertex.damping * w[i, c])
            if len(grad.damping) > 0:
                grad.damping[0] -= h * vertex.mass[i] * lam[i, c] * w[i, c]
            if len(grad.gravity) > 0:
                grad.gravity[c] += h * vertex.mass[i] * lam[i, c]


@kernel
def add_pushforward(vertex, y, u, w, s, dy, du, direction, h, out):
    for i in range(len(vertex.mass)):
        for c in range(3):
            out[i, c] += h * direction.mass[i] * (vertex.gravity[c] - vertex.damping * w[i, c])
            if len(direction.damping) > 0:
                out[i, c] -= h * vertex.mass[i] * direction.damping[0] * w[i, c]
            if len(direction.gravity) > 0:
                out[i, c] += h * vertex.mass[i] * direction.gravity[c]
