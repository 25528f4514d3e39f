"""A substep of XPBD: predict, correct by all constraints in turn some times over, take the velocity from the way.

With h the substep, f the drag of the air at (x, v), α the damping of the vertices:

    v* = v / (1 + h α) + h (g + w f),   y = x + h v*,   y ← corrected `iterations` times,   x⁺ = y,   v⁺ = (y − x)/h

Pins go to their places. Wind, gravity, spheres and pins at a substep are between their values before and after the
step. The adjoint takes the corrections backwards one by one, from what `History` kept of each. (M. Macklin et al.,
*Small steps in physics simulation*, 2019: many substeps of one iteration converge faster than the reverse.)
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from clothfit.base.arrays import NO_NUMBERS, Array, Flags, Indices
from clothfit.engine.forces import wind
from clothfit.kernels.kernel import kernel
from clothfit.simulators.projection import (
    project,
    pull_project,
    pull_touch,
    push_project,
    push_touch,
    touch,
)  # fmt: skip


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


class History(NamedTuple):
    """What a substep keeps of its corrections, for the adjoint; I iterations."""

    points: Array  # (I, K, 4, 3), m, of the members before each
    multiplier: Array  # (I, K)
    touched: Array  # (I, R, n, 4), places of vertices and multipliers before each contact


class Work(NamedTuple):
    """Scratch space for one model."""

    start: Array  # (n, 3), x before the substep
    change: Array  # (n, 3), the same of dx, or the gradient by `start`
    force: Array  # (n, 3)
    lam: Array  # (n, 3)
    still: Array  # (n, 3), zeros
    by_x: Array  # (n, 3)
    by_v: Array  # (n, 3)
    local: Array  # (3, 4, 3)
    normal: Array  # (3,)
    multiplier: Array  # (2, K), and its change
    pressing: Array  # (2, R, n), and its change
    gravity: Array  # (3,)
    centre: Array  # (R, 3)


def workspace(model: Model) -> Work:
    """Scratch space for a model."""
    n, count, spheres = len(model.x0), len(model.rest), len(model.radius)
    start, change, force, lam, still, by_x, by_v = np.zeros((7, n, 3))
    return Work(
        start, change, force, lam, still, by_x, by_v, np.zeros((3, 4, 3)), np.zeros(3), np.zeros((2, count)),
        np.zeros((2, spheres, n)), np.zeros(3), np.zeros((spheres, 3)),
    )  # fmt: skip


def history(model: Model) -> History:
    """Memory for the corrections of a substep."""
    n, count, spheres, times = len(model.x0), len(model.rest), len(model.radius), model.iterations
    return History(np.zeros((times, count, 4, 3)), np.zeros((times, count)), np.zeros((times, spheres, n, 4)))


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
def keep(model, past, k, c, x, multiplier):
    """Keep what correction c of iteration k begins with, where the history has room."""
    if len(past.multiplier) > 0:
        past.multiplier[k, c] = multiplier
        for a in range(2 if model.members[c, 2] < 0 else 4):
            for j in range(3):
                past.points[k, c, a, j] = x[model.members[c, a], j]


@kernel
def keep_touch(past, k, r, i, x, multiplier):
    """Keep what the contact of vertex i with sphere r begins with."""
    if len(past.touched) > 0:
        past.touched[k, r, i, 3] = multiplier
        for j in range(3):
            past.touched[k, r, i, j] = x[i, j]


@kernel
def step(model, t, s, x, v, work, past):
    """Take substep s of step t; `past` keeps its corrections, or has no rows."""
    h = model.h / model.substeps
    predict(model, t, s, x, v, work)
    multiplier, pressing = work.multiplier[0], work.pressing[0]
    multiplier[:] = 0.0
    pressing[:] = 0.0
    stiff = model.contact / (h * h)
    for k in range(model.iterations):
        for c in range(len(model.rest)):
            keep(model, past, k, c, x, multiplier[c])
            multiplier[c] = project(model, c, h, x, work.start, multiplier[c], work.local[0])
        for r in range(len(model.radius)):
            for i in range(len(x)):
                if model.free[i]:
                    keep_touch(past, k, r, i, x, pressing[r, i])
                    pressing[r, i] = touch(
                        stiff, model.inverse[i], work.centre[r], model.radius[r], x, i, pressing[r, i], work.normal
                    )
    finish(model, x, v, work)


@kernel
def pushforward(model, direction, t, s, x, v, dx, dv, work):
    """Take the substep, and turn dx, dv, the change of the state before it, into that after it."""
    h = model.h / model.substeps
    push_predict(model, direction, t, s, x, v, dx, dv, work)
    work.multiplier[:] = 0.0
    work.pressing[:] = 0.0
    own, change = work.multiplier[0], work.multiplier[1]
    pressing, dpressing = work.pressing[0], work.pressing[1]
    stiff = model.contact / (h * h)
    for _ in range(model.iterations):
        for c in range(len(model.rest)):
            own[c], change[c] = push_project(
                model, direction, c, h, x, work.start, own[c], dx, work.change, change[c], work.local
            )
        for r in range(len(model.radius)):
            for i in range(len(x)):
                if model.free[i]:
                    pressing[r, i], dpressing[r, i] = push_touch(
                        stiff, model.inverse[i], direction.inverse[i], work.centre[r], model.radius[r], x, i,
                        pressing[r, i], dx, dpressing[r, i], work.normal,
                    )  # fmt: skip
    finish(model, x, v, work)
    for i in range(len(x)):
        for j in range(3):
            dv[i, j] = (dx[i, j] - work.change[i, j]) / h


@kernel
def push_predict(model, direction, t, s, x, v, dx, dv, work):
    """`predict`, and the change of its results; that of x before it goes to `change`."""
    set_world(model, t, s, work)
    h = model.h / model.substeps
    work.lam[:] = 0.0  # h df
    wind.add_pushforward(model.faces, x, v, v, work.still, dx, dv, direction, h, work.lam)
    wind.add_damping(model.faces, x, v, h, dv, work.lam)
    predict(model, t, s, x, v, work)
    for i in range(len(x)):
        slow = 1.0 / (1.0 + h * model.damping[i])
        for j in range(3):
            work.change[i, j] = dx[i, j]
            if model.free[i]:
                pushed = model.inverse[i] * work.lam[i, j] + h * direction.inverse[i] * work.force[i, j]
                kept = v[i, j] - h * (work.gravity[j] + model.inverse[i] * work.force[i, j])
                dv[i, j] = slow * (dv[i, j] - h * direction.damping[i] * kept) + pushed
                dx[i, j] += h * dv[i, j]


@kernel
def pullback(model, t, s, x, v, x_bar, v_bar, grad, work, past):
    """Turn x_bar, v_bar, the gradient by the state after the substep, into that by x, v before it; add to `grad`. x and
    v are overwritten.
    """
    h = model.h / model.substeps
    work.by_x[:] = x
    work.by_v[:] = v
    step(model, t, s, x, v, work, past)
    work.change[:] = 0.0
    for i in range(len(x)):
        for j in range(3):
            x_bar[i, j] += v_bar[i, j] / h
            work.change[i, j] = -v_bar[i, j] / h
    pull_corrections(model, h, x, x_bar, grad, work, past)
    x[:] = work.by_x
    v[:] = work.by_v
    pull_predict(model, h, x, v, x_bar, v_bar, grad, work)


@kernel
def pull_corrections(model, h, x, x_bar, grad, work, past):
    """Turn x_bar by x⁺ into that by y, and add to `change`, the gradient by x before the substep."""
    stiff = model.contact / (h * h)
    own, pressing = work.multiplier[1], work.pressing[1]  # gradients by the multipliers
    own[:] = 0.0
    pressing[:] = 0.0
    for k in range(model.iterations - 1, -1, -1):
        for r in range(len(model.radius) - 1, -1, -1):
            for i in range(len(x)):
                if model.free[i]:
                    for j in range(3):
                        x[i, j] = past.touched[k, r, i, j]
                    pressing[r, i] = pull_touch(
                        stiff, model.inverse[i], work.centre[r], model.radius[r], x, i, past.touched[k, r, i, 3],
                        x_bar, pressing[r, i], grad, work.normal,
                    )  # fmt: skip
        for c in range(len(model.rest) - 1, -1, -1):
            for a in range(2 if model.members[c, 2] < 0 else 4):
                for j in range(3):
                    x[model.members[c, a], j] = past.points[k, c, a, j]
            own[c] = pull_project(
                model, c, h, x, work.start, past.multiplier[k, c], x_bar, work.change, own[c], grad, work.local
            )


@kernel
def pull_predict(model, h, x, v, x_bar, v_bar, grad, work):
    """Turn x_bar by y into the gradients by x and v before the substep, with that by x from the corrections."""
    work.force[:] = 0.0
    wind.add_force(model.faces, x, v, work.force)
    for i in range(len(x)):
        slow = 1.0 / (1.0 + h * model.damping[i])
        for j in range(3):
            if not model.free[i]:
                work.lam[i, j] = 0.0
                continue
            by_v = h * x_bar[i, j]
            v_bar[i, j] = slow * by_v
            work.lam[i, j] = model.inverse[i] * by_v
            grad.inverse[i] += h * work.force[i, j] * by_v
            grad.damping[i] -= h * slow * slow * v[i, j] * by_v
            x_bar[i, j] += work.change[i, j]
    work.by_x[:] = 0.0
    work.by_v[:] = 0.0
    wind.add_pullback(model.faces, x, v, v, work.still, work.lam, h, grad, work.by_x, work.by_v)
    wind.add_damping(model.faces, x, v, h, work.lam, work.by_v)
    for i in range(len(x)):
        for j in range(3):
            x_bar[i, j] = x_bar[i, j] + work.by_x[i, j] if model.free[i] else 0.0
            v_bar[i, j] = v_bar[i, j] + work.by_v[i, j] if model.free[i] else 0.0
