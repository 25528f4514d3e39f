"""A substep of XPBD: predict, correct by all constraints in turn some times over, take the velocity from the way.

With h the substep, f the drag of the air at (x, v), α the damping of the vertices:

    v* = v / (1 + h α) + h (g + w f),   y = x + h v*,   y ← corrected `iterations` times,   x⁺ = y,   v⁺ = (y − x)/h

Pins go to their places. Wind, gravity, spheres and pins at a substep are between their values before and after the
step. (M. Macklin et al., *Small steps in physics simulation*, 2019: many substeps of one iteration converge faster
than the reverse.)
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from clothfit.base import interrupts
from clothfit.base.arrays import NO_NUMBERS, Array, Flags, Indices
from clothfit.base.limits import FARTHEST
from clothfit.base.memory import check_memory
from clothfit.engine.forces import wind
from clothfit.kernels.kernel import kernel
from clothfit.simulators.projection import project, touch


class Values(NamedTuple):
    """What a fit may change of a model with K constraints: a direction in it, or a gradient by it."""

    compliance: Array  # (K,), m/N, of angles rad²/J
    time: Array  # (K,), s, of damping: the coefficient of damping times the compliance
    rest: Array  # (K,), m or rad
    inverse: Array  # (n,), 1/kg
    damping: Array  # (n,), 1/s, of the vertices
    drag: Array  # (1,), kg/(m⁶ s), of the faces
    relaxation: Array  # (K,)
    wind: Array = NO_NUMBERS  # never


class Model(NamedTuple):
    """A cloth of n vertices and K constraints, as XPBD has it, in a world of R spheres over T steps."""

    x0: Array  # (n, 3), m, at the start
    v0: Array  # (n, 3), m/s
    free: Flags  # (n,), what is not fixed
    inverse: Array  # (n,), 1/kg, inverse masses, 0 where fixed
    members: Indices  # (K, 4), vertices; of distances the last two are −1
    rest: Array  # (K,), m or rad
    compliance: Array  # (K,), m/N, of angles rad²/J
    time: Array  # (K,), s
    relaxation: Array  # (K,), of corrections
    damping: Array  # (n,), 1/s
    faces: wind.Faces  # that feel the air; its wind is that of the substep
    radius: Array  # (R,), m
    contact: float  # m/N, compliance of contacts
    wind: Array  # (T + 1, 3), m/s
    gravity: Array  # (T + 1, 3), m/s²
    centre: Array  # (T + 1, R, 3), m
    path: Array  # (T + 1, P, 3), m, of the pins
    pins: Indices  # (P,)
    h: float  # s, a step
    substeps: int
    iterations: int


class Work(NamedTuple):
    """Scratch space for one model."""

    start: Array  # (n, 3), x before the substep
    force: Array  # (n, 3)
    still: Array  # (n, 3), zeros
    local: Array  # (3, 4, 3)
    normal: Array  # (3,)
    multiplier: Array  # (K,)
    pressing: Array  # (R, n)
    gravity: Array  # (3,)
    centre: Array  # (R, 3)


def workspace(model: Model) -> Work:
    """Scratch space for a model."""
    n, count, spheres = len(model.x0), len(model.rest), len(model.radius)
    start, force, still = np.zeros((3, n, 3))
    return Work(start, force, still, np.zeros((3, 4, 3)), np.zeros(3), np.zeros(count), np.zeros((spheres, n)),
                np.zeros(3), np.zeros((spheres, 3)))


def zeros(model: Model) -> Values:
    """Zeros for all values of a model."""
    many = np.zeros((4, len(model.rest)))
    return Values(many[0], many[1], many[2], np.zeros_like(model.inverse), np.zeros_like(model.inverse), np.zeros(1),
                  many[3])


@kernel
def set_world(model, t, s, work):
    """Write the world at the end of substep s of step t to where it is read; returns the part of the step that is over.
    """
    part = (s + 1.0) / model.substeps
    for j in range(3):
        model.faces.wind[j] = model.wind[t, j] + part * (model.wind[t + 1, j] - model.wind[t, j])
        work.gravity[j] = model.gravity[t, j] + part * (model.gravity[t + 1, j] - model.gravity[t, j])
        for c in range(len(model.radius)):
            work.centre[c, j] = model.centre[t, c, j] + part * (model.centre[t + 1, c, j] - model.centre[t, c, j])
    return part


@kernel
def predict(model, t, s, x, v, work):
    """Write v* to v and y to x, and x before that to `start`."""
    part, h = set_world(model, t, s, work), model.h / model.substeps
    work.force[:] = 0.0
    wind.add_force(model.faces, x, v, work.force)
    for i in range(len(x)):
        slow = 1.0 / (1.0 + h * model.damping[i])
        for j in range(3):
            work.start[i, j] = x[i, j]
            if model.free[i]:
                v[i, j] = slow * v[i, j] + h * (work.gravity[j] + model.inverse[i] * work.force[i, j])
                x[i, j] += h * v[i, j]
    for k in range(len(model.pins)):
        for j in range(3):
            x[model.pins[k], j] = model.path[t, k, j] + part * (model.path[t + 1, k, j] - model.path[t, k, j])


@kernel
def finish(model, x, v, work):
    """Write v⁺ to v."""
    h = model.h / model.substeps
    for i in range(len(x)):
        for j in range(3):
            v[i, j] = (x[i, j] - work.start[i, j]) / h


@kernel
def step(model, t, s, x, v, work):
    """Take substep s of step t."""
    h = model.h / model.substeps
    predict(model, t, s, x, v, work)
    multiplier, pressing = work.multiplier, work.pressing
    multiplier[:] = 0.0
    pressing[:] = 0.0
    stiff = model.contact / (h * h)
    for _ in range(model.iterations):
        for c in range(len(model.rest)):
            multiplier[c] = project(model, c, h, x, work.start, multiplier[c], work.local[0])
        for r in range(len(model.radius)):
            for i in range(len(x)):
                if model.free[i]:
                    pressing[r, i] = touch(
                        stiff, model.inverse[i], work.centre[r], model.radius[r], x, i, pressing[r, i], work.normal
                    )
    finish(model, x, v, work)


@kernel
def advance(model, t, x, v, work):
    """Take step t."""
    for s in range(model.substeps):
        step(model, t, s, x, v, work)


def simulate(model: Model, frames: int) -> tuple[Array, int]:
    """Positions (frames, n, 3), m, and how many of them are good: fewer where the motion runs away."""
    check_memory(frames, len(model.x0), 0)
    positions, work = np.empty((frames, *model.x0.shape)), workspace(model)
    x, v = model.x0.copy(), model.v0.copy()
    positions[0] = x
    for t in range(frames - 1):
        advance(model, t, x, v, work)
        interrupts.check()
        if not np.abs(x).max(initial=0.0) < FARTHEST:
            return positions, t + 1
        positions[t + 1] = x
    return positions, frames
