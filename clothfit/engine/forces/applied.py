"""Forces that are given in each step, and springs that pull vertices to given places: f_i = u_i + κ_i (R_i − y_i),
K = −κ_i I and D = 0, so that in the step's model F(w) = u + κ (R − x⁺).

They are the rows of tables (`inputs.tables`), which writes those of a step here before it. In a scene without such
forces the tables are empty, and so are these arrays.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from clothfit.base.arrays import Array
from clothfit.engine.solve.sparse import XX, YY, ZZ
from clothfit.kernels.kernel import kernel


class Applied(NamedTuple):
    """The forces of the step that is computed, their change, and the gradient by them."""

    force: Array  # u, (n, 3), N; (0, 3) where there are none, as those below
    change: Array  # (n, 3), N, along a direction
    bar: Array  # (n, 3), 1/N times the unit of the cost
    gain: Array  # κ, (n,), N/m; (0,) where nothing is pulled
    place: Array  # R, (n, 3), m; (0, 3) where nothing is


def build(pushed: int, pulled: int) -> Applied:
    """Memory for so many vertices that are pushed and pulled: all, or none."""
    force, change, bar = (np.zeros((pushed, 3)) for _ in range(3))
    return Applied(force, change, bar, np.zeros(pulled), np.zeros((pulled, 3)))


@kernel
def add_force(applied, y, u, f):
    add_times(applied, y, 1.0, f)


@kernel(absent=None)
def add_times(applied, y, scale, out):
    """out += scale f, where there are forces."""
    for i in range(len(applied.force)):
        for c in range(3):
            out[i, c] += scale * applied.force[i, c]
    for i in range(len(applied.gain)):
        for c in range(3):
            out[i, c] += scale * applied.gain[i] * (applied.place[i, c] - y[i, c])


@kernel(absent=0.0)
def energy(applied, y):
    """−Σ u·y + ½ κ |R − y|², J."""
    total = 0.0
    for i in range(len(applied.force)):
        for c in range(3):
            total -= applied.force[i, c] * y[i, c]
    for i in range(len(applied.gain)):
        for c in range(3):
            total += 0.5 * applied.gain[i] * (applied.place[i, c] - y[i, c]) ** 2
    return total


@kernel(absent=0.0, apart=0.0)
def add_step(applied, y, u, h, ahead, A, b):
    if len(b) > 0:
        add_times(applied, y, h, b)
    for i in range(len(applied.gain)):
        pull = h * h * applied.gain[i]
        A.diagonal[i, XX] += pull
        A.diagonal[i, YY] += pull
        A.diagonal[i, ZZ] += pull
        if ahead and len(b) > 0:
            for c in range(3):
                b[i, c] += pull * u[i, c]
    return 0.0


@kernel(absent=None, apart=None)
def add_pullback(applied, y, u, w, s, lam, h, grad, gy, gu):
    # φ = h λ·(u + κ (R − y − s)): no velocity.
    for i in range(len(applied.gain)):
        for c in range(3):
            gy[i, c] -= h * applied.gain[i] * lam[i, c]
    if len(grad.force) > 0:
        for i in range(len(applied.bar)):
            for c in range(3):
                applied.bar[i, c] += h * lam[i, c]


@kernel(absent=None, apart=None)
def add_pushforward(applied, y, u, w, s, dy, du, direction, h, out):
    for i in range(len(applied.gain)):
        for c in range(3):
            out[i, c] -= h * applied.gain[i] * dy[i, c]
    if len(direction.force) > 0:
        for i in range(len(applied.change)):
            for c in range(3):
                out[i, c] += h * applied.change[i, c]
