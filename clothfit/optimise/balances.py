"""The balances of momentum along a target motion.

The step's residual r (`step.implicit`) is linear in masses and stiffnesses. Where a vertex and its neighbours are seen
in successive frames, positions give the velocities, v⁺ = (x⁺ − x)/h, and so everything else in r. With several Newton
iterations the residual of the converged step is used.

A BDF2 step (`step.bdf2`) gives v⁺ = (x⁺ − x̃)/h' from three positions, and its balance needs two velocities before it:
five positions in all. Its first step is an implicit Euler step; others that the guard made so are not in balance.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from clothfit.base import interrupts
from clothfit.base.arrays import Array, Flags, Indices
from clothfit.derivative.stencil import Stencil, stencil
from clothfit.derivative.step_jacobian import differentiate, jacobian
from clothfit.engine.forces import meeting, total, touch
from clothfit.engine.inputs.tables import couple_change, set_inputs
from clothfit.engine.solve import sparse
from clothfit.engine.step import bdf2, implicit
from clothfit.engine.system import BDF2, EXPLICIT, IMPLICIT, System, mobile
from clothfit.kernels.kernel import kernel
from clothfit.kernels.vectors import add, add_mass, copy
from clothfit.objective.target import Target

if TYPE_CHECKING:
    from scipy.sparse import csr_array

    from clothfit.engine.forces.selfcontact.pairs import Surface


class Track(NamedTuple):
    """What a target shows of one cloth at each of T + 1 steps."""

    x: Array  # (T + 1, n, 3), m
    seen: Flags  # (T + 1, n)


def track(goal: Target, system: System) -> Track:
    """What a target shows of a cloth at the times of the steps; the start, fixed vertices and pins are known, but not
    those whose paths are fitted.
    """
    whole = np.flatnonzero(goal.fraction == 0)
    frames, n = goal.last_step + 1, len(system.x0)
    x, seen = np.broadcast_to(system.x0, (frames, n, 3)).copy(), np.zeros((frames, n), bool)
    for frame in whole:  # several frames may fall on one step: the last counts
        here = goal.observed[frame] & mobile(system)
        x[goal.step[frame], here] = goal.positions[frame, here]
        seen[goal.step[frame], here] = True
    if system.inputs is not None and len(system.inputs.path):
        known = ~mobile(system)[system.inputs.pins]
        x[:, system.inputs.pins[known]] = system.inputs.path[:frames, known]
    x[0], seen[0] = system.x0, True
    return Track(x, seen)


class Balances(NamedTuple):
    """The rows of the problem, for T steps."""

    residual: Array  # r at p₀, (T, n, 3), N s
    mass: Array  # C of each mass, (T, n, 3)
    stiffness: Array  # C of each stiffness at both ends of its spring, (T, S, 2, 3)
    valid: Flags  # (T, n), whether all that row needs was seen


def balances(system: System, track: Track) -> Balances:
    """The balances of momentum along a track, with the system's masses and stiffnesses as p₀."""
    near = stencil(system, 1)
    steps = len(track.x) - (2 if system.method == EXPLICIT else 1)
    n, springs = len(system.x0), len(system.springs.rest)
    r, mass, stiffness = (np.zeros((steps, *shape)) for shape in ((n, 3), (n, 3), (springs, 2, 3)))
    out = Balances(r, mass, stiffness, valid_rows(system, near, track, steps))
    alone = near._replace(start=np.zeros(n + 1, np.int32), neighbour=np.zeros(0, np.int32))
    x, v = np.ascontiguousarray(track.x), velocities(system, track.x)
    two = system.method == BDF2
    forms = bdf2.forms(system) if two else (system, system)
    fill(*forms, two, alone, x, v, implicit.workspace(system), jacobian(system, alone), out)
    interrupts.check()
    return out


def velocities(system: System, x: Array) -> Array:
    """Velocities (T + 1, n, 3) that the integration method gives positions (T + 1, n, 3)."""
    moved = np.diff(x, axis=0) / system.h
    rest = system.v0[None]
    if system.method == BDF2:
        moved[1:] = 1.5 * moved[1:] - 0.5 * moved[:-1]
    return np.concatenate([moved, moved[-1:]] if system.method == EXPLICIT else [rest, moved])


def valid_rows(system: System, near: Stencil, track: Track, steps: int) -> Flags:
    """Which rows (T, n) have all their positions seen: of a free vertex and its neighbours, at three steps or five."""
    from scipy.sparse import csr_array

    n = len(system.x0)
    unseen = ~(track.seen | ~mobile(system))
    touched = csr_array((np.ones(len(near.neighbour)), near.neighbour, near.start), shape=(n, n))
    missing = np.asarray((touched @ unseen.T.astype(float)).T > 0)  # (T + 1, n), of a vertex or a neighbour
    bad = missing[:steps] | missing[1 : steps + 1]
    if system.method == EXPLICIT:
        bad |= missing[2 : steps + 2]
    for back in {EXPLICIT: (), BDF2: (1, 2, 3)}.get(system.method, (1,)):
        bad[back:] |= missing[: max(steps - back, 0)]
    if system.colliders is not None and system.method >= IMPLICIT and len(system.colliders.rows):
        bad |= met_rows(system, system.colliders, track.x, steps)
    if system.surface is not None:
        bad |= touched_rows(system.surface, track.x, steps)
    return np.ascontiguousarray(~bad & system.vertex.free)  # in one order, however few steps: to compile once for


def met_rows(system: System, colliders: touch.Colliders, x: Array, steps: int) -> Flags:
    """Which rows (T, n) belong to vertices that may only end their step in a collider (`forces.meeting`): whether the
    step knew them, the positions do not show.
    """
    met = np.zeros((steps, x.shape[1]), bool)
    for t in range(steps):
        set_inputs(system.inputs, system, t)
        y, way = np.ascontiguousarray(x[t]), x[t + 1] - x[t]
        depth, normal = touch.depths(colliders, y)
        met[t] = ((depth <= 0) & (depth > np.einsum("cni,ni->cn", normal, way))).any(axis=0)
    return met


def touched_rows(surface: Surface, x: Array, steps: int) -> Flags:
    """Which rows (T, n) belong to vertices that self-contact may push in the step: of which forces the rows know
    nothing.
    """
    from clothfit.engine.forces.selfcontact import pairs

    near = np.zeros((steps + 1, x.shape[1]), bool)
    for t, y in enumerate(np.ascontiguousarray(x[: steps + 1])):
        near[t, pairs.touching(surface, y).vertices] = True
    return np.asarray(near[:-1] | near[1:])


@kernel
def fill(system, inner, two, near, x, v, work, step, out):
    """Write the rows of all steps: with `two` those of the `bdf2.forms`, from the second step on of the inner one."""
    late = system.method == IMPLICIT and system.newton_iterations > 1
    meeting.clear(system.colliders)
    for t in range(len(out.residual)):
        set_inputs(system.inputs, system, t)
        w, now = v[t + 1], (out.residual[t], out.mass[t], out.stiffness[t])
        if two and t > 0:
            bdf2.extrapolate(inner.h, x[t], v[t], x[t - 1], v[t - 1], work)
            write(inner, near, work.x_base, work.v_base, w if late else work.u, w, True, work, step, now)
        else:
            write(system, near, x[t], v[t], w if late else v[t], w, late, work, step, now)


@kernel
def write(system, near, x, v, u, w, later, work, step, row):
    """Write the row of a step to w that is linearised with u, at (x, u) or at a `later` point, (x + h u, u)."""
    A, b, mass = work.A, work.b, system.vertex.mass
    r, by_mass, by_stiffness = row
    differentiate(system, near, x, v, w, u, later, work, step)
    copy(step.by_mass, by_mass)
    for i in range(len(by_stiffness)):
        copy(step.by_stiffness[i], by_stiffness[i])
    r[:] = 0.0
    if system.method == IMPLICIT:
        if later:
            implicit.assemble_newton(system, x, v, u, work.y, A, work.gy, b)
        else:
            add_mass(mass, 1.0, v, b)  # to what `differentiate` left
        couple_change(system.inputs, system, w, u, later, work.y if later else x, work.s, b)
        sparse.multiply(A, w, r)
        add(-1.0, b, r)
    else:
        b[:] = 0.0
        total.add_force(system, x, v, b)
        add_mass(mass, 1.0, w, r)
        add(-system.h, b, r)
        add_mass(mass, -1.0, v, r)


def summed_twice(rows: Balances, method: int = IMPLICIT) -> Balances:
    """The balances summed twice over time as the step does, up to where a vertex' first row is missing."""
    valid: Flags = np.asarray(np.minimum.accumulate(rows.valid, axis=0), bool)
    known = [np.where(mask(rows.valid, a), a, 0.0) for a in rows[:2]]
    residual, mass, stiffness = (summed(summed(a, method), method, 1.5) for a in (*known, rows.stiffness))
    return Balances(residual, mass, stiffness, valid)


def summed(a: Array, method: int, first: float = 1.0) -> Array:
    """What the steps of a method make of changes a (T, …): sums, or of BDF2 y = (4 y₋ − y₋₋)/3 + a from the second step
    on; there the first change counts `first` times, 1.5 = h/h' for velocities that are summed to positions over h'.
    """
    from scipy.signal import lfilter

    if method != BDF2:
        return np.asarray(np.cumsum(a, axis=0))
    return np.asarray(lfilter([1.0], [1.0, -4.0 / 3.0, 1.0 / 3.0], np.concatenate([first * a[:1], a[1:]]), axis=0))


def mask(valid: Flags, a: Array) -> Flags:
    """`valid` (T, n) with as many axes as `a`."""
    return valid.reshape(valid.shape + (1,) * (a.ndim - 2))


def smoothed(track: Track, x0: Array, frames: int) -> Track:
    """The track with every position replaced by that of a parabola through `frames` frames around it."""
    from scipy.signal import savgol_filter

    if frames > len(track.x):
        return track
    x = savgol_filter(track.x, frames, 2, axis=0)
    x[0] = x0
    windows = np.lib.stride_tricks.sliding_window_view(track.seen, frames, axis=0)
    whole: Flags = np.asarray(windows.min(axis=-1), bool)
    half = frames // 2
    seen = np.concatenate([np.repeat(whole[:1], half, axis=0), whole, np.repeat(whole[-1:], half, axis=0)])
    seen[0] = True
    return Track(x, seen)


class Rows(NamedTuple):
    """N rows of the problem for Q parameters."""

    C: csr_array  # (N, Q)
    r: Array  # (N,)
    step: Indices  # (N,), the step that each belongs to, of those that have rows, counted from 0

    def only(self, kept: Flags) -> Rows:
        """Some of the rows (N,)."""
        return Rows(self.C[kept], self.r[kept], self.step[kept])

    def times(self, factor: Array) -> Rows:
        """The rows for parameters q / factor, (Q,)."""
        C = self.C
        return self._replace(C=type(C)((C.data * factor[C.indices], C.indices, C.indptr), shape=C.shape))

    def residuals(self, q: Array) -> Array:
        """The root of the squares of each step's residuals at q (Q,)."""
        return np.sqrt(np.bincount(self.step, weights=(self.r - self.C @ q) ** 2))

    def terms(self, q: Array) -> Array:
        """The root of the squares of Σ_j |C_ij q_j| in each step, at q (Q,): what residuals are small beside."""
        return np.sqrt(np.bincount(self.step, weights=(abs(self.C) @ np.abs(q)) ** 2))


def matrix(rows: Balances, system: System) -> Rows:
    """The valid rows for all masses and stiffnesses, per vertex mass."""
    from scipy.sparse import csr_array

    steps, n = rows.valid.shape
    springs, ends = len(system.springs.rest), system.springs.ends
    weight = 1.0 / system.vertex.mass
    row = np.arange(n * 3).reshape(n, 3)  # of one step; all have the same pattern
    row = np.concatenate([row.ravel(), row[ends].ravel()])
    column = np.concatenate([np.repeat(np.arange(n), 3), np.repeat(n + np.arange(springs), 6)])
    order = np.lexsort((column, row))
    by_mass, by_stiffness = rows.mass * weight[:, None], rows.stiffness * weight[ends][:, :, None]
    values = np.concatenate([by_mass.reshape(steps, n * 3), by_stiffness.reshape(steps, springs * 6)], axis=1)[:, order]
    start = np.arange(steps)[:, None] * len(order) + np.searchsorted(row[order], np.arange(n * 3))
    pattern = np.tile(column[order], steps), np.append(start.ravel(), values.size)
    whole = csr_array((values.ravel(), *pattern), shape=(steps * n * 3, n + springs))
    kept = np.flatnonzero(np.repeat(rows.valid.ravel(), 3))
    step = np.unique(kept // (3 * n), return_inverse=True)[1].astype(np.int32)
    return Rows(whole[kept], (rows.residual * weight[:, None]).ravel()[kept], step)


def stacked(parts: Sequence[Rows]) -> Rows:
    """The rows of several runs, one below the other."""
    from scipy.sparse import csr_array, vstack

    before = np.cumsum([0] + [int(part.step.max(initial=-1)) + 1 for part in parts])
    steps = [first + part.step for first, part in zip(before[:-1], parts, strict=True)]
    C = csr_array(vstack([part.C for part in parts]))
    return Rows(C, np.concatenate([part.r for part in parts]), np.concatenate(steps))
