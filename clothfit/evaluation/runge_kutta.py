"""The classical Runge–Kutta method of order 4 on a cloth's equations of motion, for reference motions only.

    x' = v,   v' = a(x, v) = M⁻¹ f(x, v)   (0 at fixed vertices)

    u₂ = v + h/2 a₁   u₃ = v + h/2 a₂   u₄ = v + h a₃        a₁ = a(x, v)
    y₂ = x + h/2 v    y₃ = x + h/2 u₂   y₄ = x + h u₃        aᵢ = a(yᵢ, uᵢ)
    x⁺ = x + h v + h²/6 (a₁ + a₂ + a₃)
    v⁺ = v + h/6 (a₁ + 2 a₂ + 2 a₃ + a₄)

It shares only the forces with the steps of `clothfit.engine.step`. All of them solve this equation: the terms that the
implicit steps add to their matrix or leave out vanish with h. The error falls as h⁴ where the forces are smooth; a
sphere's force has a kink where a vertex enters, which leaves about h². E. Hairer, S. Nørsett, G. Wanner, *Solving
Ordinary Differential Equations I* (1993), II.1. Arrays are (n, 3).
"""

from __future__ import annotations

import numpy as np

from clothfit.base import interrupts
from clothfit.base.arrays import Array
from clothfit.base.limits import FARTHEST
from clothfit.engine.forces import total
from clothfit.engine.rollout import stretches
from clothfit.engine.system import System
from clothfit.kernels.kernel import kernel


def record(system: System, delta: float, frames: int, substeps: int) -> Array | None:
    """Positions (frames, n, 3) at multiples of `delta` s, with `substeps` steps per frame; None where it diverges."""
    x, v = system.x0.copy(), system.v0.copy()
    positions = np.empty((frames, *x.shape))
    work = np.zeros((5, *x.shape))
    positions[0] = x
    for frame in range(1, frames):
        for first, last in stretches(substeps, 4 * len(x)):
            advance(system, x, v, delta / substeps, last - first, work)
            interrupts.check()
        if not np.abs(x).max(initial=0.0) < FARTHEST:  # NaN as well
            return None
        positions[frame] = x
    return positions


@kernel
def advance(system, x, v, h, steps, work):
    """Move x and v by `steps` steps of h; work (5, n, 3) is scratch space."""
    y, u, a, dx, dv = work[0], work[1], work[2], work[3], work[4]
    for _ in range(steps):
        start(x, v, h, y, u, dx, dv)
        for stage in range(4):
            accelerate(system, y, u, a)
            weight = h / 6.0 if stage == 0 or stage == 3 else h / 3.0
            reach = h if stage == 2 else 0.5 * h
            for i in range(len(x)):
                for c in range(3):
                    dv[i, c] += weight * a[i, c]
                    if stage < 3:
                        dx[i, c] += h * h / 6.0 * a[i, c]
                        y[i, c] = x[i, c] + reach * u[i, c]
                        u[i, c] = v[i, c] + reach * a[i, c]
        for i in range(len(x)):
            for c in range(3):
                x[i, c] += dx[i, c]
                v[i, c] += dv[i, c]


@kernel
def start(x, v, h, y, u, dx, dv):
    """Set up the first stage of a step, and its sums without acceleration."""
    for i in range(len(x)):
        for c in range(3):
            y[i, c], u[i, c] = x[i, c], v[i, c]
            dx[i, c], dv[i, c] = h * v[i, c], 0.0


@kernel
def accelerate(system, y, u, a):
    """a = M⁻¹ f(y, u); 0 at fixed vertices."""
    a[:] = 0.0
    total.add_force(system, y, u, a)
    for i in range(len(a)):
        scale = 1.0 / system.vertex.mass[i] if system.vertex.free[i] else 0.0
        for c in range(3):
            a[i, c] *= scale
