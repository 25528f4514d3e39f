"""Substeps of XPBD, and with them the changes of a state along many directions at once: the derivative of a motion, or
the motion alone where there is no direction.

A direction is a relative change of values: of compliances, times of damping and rest lengths, of a mass, or of the
damping of a vertex. The changes lie side by side, (n, 3, D), so that one pass over the constraints serves all of them.
Of a constraint with the vertices' changes d, those p of the places before the substep, and ε of the multiplier, the
correction changes by

    dΔ = a·d + (γ/b) ∇C·p − (α̃/b) ε + (the values' own),   b the denominator of Δ,
    a = −((1 + γ) ∇C + γ H (x − p) + 2 (1 + γ) Δ H W ∇C)/b

ω Δ by ω dΔ + dω Δ, and each vertex by wᵢ (ω Δ (H d)ᵢ + ∇ᵢC d(ω Δ)); see `substep`, whose derivative this is.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from clothfit.base import interrupts
from clothfit.base.arrays import NO_NUMBERS, Array, Indices
from clothfit.base.limits import FARTHEST
from clothfit.base.memory import check_memory
from clothfit.engine.forces import wind
from clothfit.kernels.kernel import kernel
from clothfit.kernels.vectors import copy_row
from clothfit.simulators import substep
from clothfit.simulators.substep import Model, Work, workspace


class Seeds(NamedTuple):
    """The direction that changes the logarithm of each value, an index, −1: none."""

    compliance: Indices  # (K,)
    time: Indices  # (K,)
    rest: Indices  # (K,)
    mass: Indices  # (n,)
    damping: Indices  # (n,)
    relaxation: Indices  # (K,)
    drag: Indices  # (1,)


class Air(NamedTuple):
    """What the forces of the air take of a direction."""

    drag: Array  # (1,), kg/(m⁶ s), of the faces
    wind: Array = NO_NUMBERS  # never


class Tangents(NamedTuple):
    """Changes along D directions, and space to work in."""

    x: Array  # (n, 3, D), of the places
    v: Array  # (n, 3, D), of the velocities
    start: Array  # (n, 3, D), of the places before the substep
    multiplier: Array  # (K, D)
    pressing: Array  # (R, n, D)
    local: Array  # (12, D), of the vertices of a constraint
    change: Array  # (D,), of its correction
    one: Array  # (3, n, 3), the places, the velocities and the force along a single direction
    matrix: Array  # (12, 12)
    unit: Array  # (4, 3)
    air: Air


def tangents(model: Model, directions: int) -> Tangents:
    """Space for so many directions, whose changes are 0."""
    n, count, spheres = len(model.x0), len(model.rest), len(model.radius)
    x, v, start = np.zeros((3, n, 3, directions))
    return Tangents(x, v, start, np.zeros((count, directions)), np.zeros((spheres, n, directions)),
                np.zeros((12, directions)), np.zeros(directions), np.zeros((3, n, 3)), np.zeros((12, 12)),
                np.zeros((4, 3)), Air(np.zeros(1)))


def no_seeds(model: Model) -> Seeds:
    """Of no value."""
    none, each = (np.full(count, -1, np.int32) for count in (len(model.rest), len(model.x0)))
    return Seeds(none, none, none, each, each, none, np.full(1, -1, np.int32))


class Sweep:
    """A state of a model and its changes along the directions of some seeds, step by step (`values.State`)."""

    def __init__(self, model: Model, seeds: Seeds, directions: int) -> None:
        self.model, self.seeds, self.tangents = model, seeds, tangents(model, directions)
        self.h, self.free = model.h, model.free
        self.dx, self.dv = self.tangents.x, self.tangents.v
        self.work: Work = workspace(model)
        self.x, self.v = model.x0.copy(), model.v0.copy()

    def advance(self, t: int) -> None:
        """Take step t."""
        take_step(self.model, self.seeds, t, self.x, self.v, self.tangents, self.work)


def simulate(model: Model, frames: int) -> tuple[Array, int]:
    """Positions (frames, n, 3), m, and how many of them are good: fewer where the motion runs away."""
    check_memory(frames, len(model.x0), 0)
    positions, own = np.empty((frames, *model.x0.shape)), Sweep(model, no_seeds(model), 0)
    positions[0] = own.x
    for t in range(frames - 1):
        own.advance(t)
        interrupts.check()
        if not np.abs(own.x).max(initial=0.0) < FARTHEST:
            return positions, t + 1
        positions[t + 1] = own.x
    return positions, frames


@kernel
def take_step(model, seeds, t, x, v, tangents, work):
    """Take step t."""
    for s in range(model.substeps):
        pushforward(model, seeds, t, s, x, v, tangents, work)


@kernel
def pushforward(model, seeds, t, s, x, v, tangents, work):
    """Take a substep, and turn the changes of the state before it into those after it."""
    h, multiplier, pressing = model.h / model.substeps, work.multiplier, work.pressing
    pushes = tangents.x.shape[2] > 0
    push_predict(model, seeds, t, s, x, v, tangents, work)
    multiplier[:] = 0.0
    pressing[:] = 0.0
    tangents.multiplier[:] = 0.0
    tangents.pressing[:] = 0.0
    stiff = model.contact / (h * h)
    for _ in range(model.iterations):
        for c in range(len(model.rest)):
            if pushes:
                multiplier[c] = project(model, seeds, c, h, x, work.start, multiplier[c], tangents, work.local)
            else:
                multiplier[c] = substep.project(model, c, h, x, work.start, multiplier[c], work.local[0])
        for r in range(len(model.radius)):
            for i in range(len(x)):
                if model.free[i]:
                    pressing[r, i] = contact_tangent(model, seeds, stiff, r, i, x, pressing[r, i], tangents, work)
    substep.finish(model, x, v, work)
    for i in range(len(x)):
        for j in range(3):
            v_row, x_row, start = tangents.v[i, j], tangents.x[i, j], tangents.start[i, j]
            for k in range(len(v_row)):
                v_row[k] = (x_row[k] - start[k]) / h


@kernel
def push_predict(model, seeds, t, s, x, v, tangents, work):
    """`predict`, and the changes of its results."""
    substep.set_world(model, t, s, work)
    h = model.h / model.substeps
    for place in np.ndindex(tangents.x.shape):  # see `vectors.copy`
        tangents.start[place] = tangents.x[place]
    if len(model.faces.corners) > 0 and model.faces.drag[0] > 0.0:
        push_air(model, seeds, x, v, h, tangents, work)
    substep.predict(model, t, s, x, v, work)
    for i in range(len(x)):
        if not model.free[i]:
            continue
        slow = 1.0 / (1.0 + h * model.damping[i])
        for j in range(3):
            pushed = h * model.inverse[i] * work.force[i, j]
            kept = v[i, j] - h * work.gravity[j] - pushed
            v_row, x_row = tangents.v[i, j], tangents.x[i, j]
            if seeds.damping[i] >= 0:
                v_row[seeds.damping[i]] -= h * model.damping[i] * kept
            for k in range(len(v_row)):
                v_row[k] *= slow
            if len(model.faces.corners) > 0 and model.faces.drag[0] > 0.0:
                add_air(tangents, i, j)
            if seeds.mass[i] >= 0:
                v_row[seeds.mass[i]] -= pushed
            for k in range(len(v_row)):
                x_row[k] += h * v_row[k]


@kernel
def push_air(model, seeds, x, v, h, tangents, work):
    """Write w h df, the change of the air's forces, to `start`, whose places are not asked for until `add_air`."""
    dx, dv, force = tangents.one[0], tangents.one[1], tangents.one[2]
    for k in range(tangents.x.shape[2]):
        for i in range(len(x)):
            for j in range(3):
                dx[i, j], dv[i, j], force[i, j] = tangents.x[i, j, k], tangents.v[i, j, k], 0.0
        tangents.air.drag[0] = model.faces.drag[0] if seeds.drag[0] == k else 0.0
        wind.add_pushforward(model.faces, x, v, v, work.still, dx, dv, tangents.air, h, force)
        wind.add_damping(model.faces, x, v, h, dv, force)
        for i in range(len(x)):
            for j in range(3):
                tangents.start[i, j, k] = model.inverse[i] * force[i, j]


@kernel
def add_air(tangents, i, j):
    """Add what `push_air` left to the change of a velocity, and put back the change of the place."""
    v_row, x_row, start = tangents.v[i, j], tangents.x[i, j], tangents.start[i, j]
    for k in range(len(v_row)):
        # what damping slows is not the force
        v_row[k] += start[k]
        start[k] = x_row[k]


@kernel
def project(model, seeds, c, h, x, p, multiplier, tangents, local):
    """Correct x by constraint c, and its changes; returns λ⁺."""
    g = local[0]
    stiff, gamma = substep.factors(model, c, h)
    change, below, slide, weight = substep.parts(model, c, h, x, p, multiplier, g)
    if below == 0.0:
        return multiplier
    count = substep.size_of(model.members, c)
    turns(model, c, x, tangents.matrix, local[1], tangents.unit)
    row = local[2]  # a
    for k in range(count):
        for j in range(3):
            row[k, j] = (1.0 + gamma) * g[k, j]
            for m in range(count):
                i = model.members[c, m]
                for q in range(3):
                    slip = gamma * (x[i, q] - p[i, q]) + 2.0 * (1.0 + gamma) * change * model.inverse[i] * g[m, q]
                    row[k, j] += tangents.matrix[3 * k + j, 3 * m + q] * slip
            row[k, j] *= -1.0 / below
    gather(model, c, count, tangents)
    change_of(model, c, count, gamma / below, stiff / below, g, row, tangents)
    own_values(model, seeds, c, h, g, multiplier, change, below, slide, weight, tangents)
    change = relaxed(model, seeds, c, change, tangents.change)
    if count == 2:
        spread_pair(model, c, g, change, tangents)
    else:
        spread(model, c, g, change, tangents)
    for k in range(count):
        i = model.members[c, k]
        for j in range(3):
            if seeds.mass[i] >= 0:
                tangents.x[i, j, seeds.mass[i]] -= model.inverse[i] * g[k, j] * change
            x[i, j] += model.inverse[i] * g[k, j] * change
    total = tangents.multiplier[c]
    for q in range(len(total)):
        total[q] += tangents.change[q]
    return multiplier + change


@kernel
def relaxed(model, seeds, c, change, changes):
    """ω Δ of constraint c; turns the changes of Δ into those of ω Δ."""
    omega = model.relaxation[c]
    if omega != 1.0:
        for q in range(len(changes)):
            changes[q] *= omega
    if seeds.relaxation[c] >= 0:
        changes[seeds.relaxation[c]] += omega * change
    return omega * change


@kernel
def turns(model, c, x, matrix, out, unit):
    """Write H of constraint c to `matrix`."""
    count = substep.size_of(model.members, c)
    unit[:] = 0.0
    for k in range(count):
        for j in range(3):
            unit[k, j] = 1.0
            substep.bend(model.members, c, x, unit, out)
            unit[k, j] = 0.0
            for m in range(count):
                for q in range(3):
                    matrix[3 * m + q, 3 * k + j] = out[m, q]


@kernel
def gather(model, c, count, tangents):
    """Write the changes of the vertices of constraint c to `local`; of two, the difference, and before the substep."""
    first, second = model.members[c, 0], model.members[c, 1]
    for j in range(3):
        if count == 2:
            held, a, b = tangents.local[j], tangents.x[first, j], tangents.x[second, j]
            for q in range(len(held)):
                held[q] = a[q] - b[q]
        else:
            for k in range(count):
                copy_row(tangents.x[model.members[c, k], j], tangents.local[3 * k + j])


@kernel
def change_of(model, c, count, slip, keep, g, row, tangents):
    """Write the changes of the correction, but for the values' own, to `change`."""
    found, own = tangents.change, tangents.multiplier[c]
    for q in range(len(found)):
        found[q] = -keep * own[q]
    if count == 2:  # both depend on the difference alone
        a, b, d = row[0, 0], row[0, 1], row[0, 2]
        e, f, k = tangents.local[0], tangents.local[1], tangents.local[2]
        for q in range(len(found)):
            found[q] += a * e[q] + b * f[q] + d * k[q]
    else:
        for r in range(3 * count):
            a, held = row[r // 3, r % 3], tangents.local[r]
            for q in range(len(found)):
                found[q] += a * held[q]
    if slip != 0.0:
        for k in range(count):
            a, b, d = slip * g[k, 0], slip * g[k, 1], slip * g[k, 2]
            place = tangents.start[model.members[c, k]]
            e, f, held = place[0], place[1], place[2]
            for q in range(len(found)):
                found[q] += a * e[q] + b * f[q] + d * held[q]


@kernel
def own_values(model, seeds, c, h, g, multiplier, change, below, slide, weight, tangents):
    """Add what the values of constraint c and the masses of its vertices do to its correction by themselves."""
    stiff, gamma = substep.factors(model, c, h)
    if seeds.compliance[c] >= 0:
        tangents.change[seeds.compliance[c]] -= stiff * (multiplier + change) / below
    if seeds.time[c] >= 0:
        tangents.change[seeds.time[c]] -= gamma * (slide + change * weight) / below
    if seeds.rest[c] >= 0:
        tangents.change[seeds.rest[c]] += model.rest[c] / below
    for k in range(substep.size_of(model.members, c)):
        i = model.members[c, k]
        if seeds.mass[i] >= 0:
            square = g[k, 0] * g[k, 0] + g[k, 1] * g[k, 1] + g[k, 2] * g[k, 2]
            tangents.change[seeds.mass[i]] += (1.0 + gamma) * model.inverse[i] * square * change / below


@kernel
def spread_pair(model, c, g, change, tangents):
    """Change the two vertices of constraint c, whose H is P, −P, −P, P."""
    e, f, d, along = tangents.local[0], tangents.local[1], tangents.local[2], tangents.change
    for k in range(2):
        i, sign = model.members[c, k], 1.0 - 2.0 * k
        w = model.inverse[i]
        if w == 0.0:
            continue
        for j in range(3):
            turn = sign * w * change
            row, n = tangents.matrix[j], w * g[k, j]
            p, q, r = turn * row[0], turn * row[1], turn * row[2]
            found = tangents.x[i, j]
            for m in range(len(found)):
                found[m] += p * e[m] + q * f[m] + r * d[m] + n * along[m]


@kernel
def spread(model, c, g, change, tangents):
    """Change the vertices of constraint c."""
    count = substep.size_of(model.members, c)
    for r in range(3 * count):
        i = model.members[c, r // 3]
        w = model.inverse[i]
        found, along, n = tangents.x[i, r % 3], tangents.change, w * g[r // 3, r % 3]
        for q in range(len(found)):
            found[q] += n * along[q]
        for m in range(3 * count):
            factor, d = w * change * tangents.matrix[r, m], tangents.local[m]
            for q in range(len(found)):
                found[q] += factor * d[q]


@kernel
def contact_tangent(model, seeds, stiff, r, i, x, multiplier, tangents, work):
    """Correct vertex i by its contact with sphere r, and its changes; returns λ⁺."""
    w, n, own = model.inverse[i], work.normal, tangents.pressing[r, i]
    depth, distance = substep.gap(work.centre[r], model.radius[r], x, i, n)
    change, presses = substep.push_out(stiff, w, depth, multiplier)
    for q in range(len(own)):
        along = n[0] * tangents.x[i, 0, q] + n[1] * tangents.x[i, 1, q] + n[2] * tangents.x[i, 2, q]
        dw = -w if seeds.mass[i] == q else 0.0
        dchange = -own[q]
        if presses:
            dchange = -(along + stiff * own[q] + change * dw) / (w + stiff)
        for j in range(3):
            turn = (tangents.x[i, j, q] - along * n[j]) / distance
            tangents.x[i, j, q] += w * (turn * change + n[j] * dchange) + dw * n[j] * change
        own[q] += dchange
    for j in range(3):
        x[i, j] += w * n[j] * change
    return multiplier + change
