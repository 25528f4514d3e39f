"""The balances of momentum along a target motion.

The step's residual r (`step.implicit`) is linear in masses and stiffnesses. Where a vertex and its neighbours are seen
in successive frames, positions give the velocities, v⁺ = (x⁺ − x)/h, and so everything else in r. With several Newton
iterations the residual of the converged step is used.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from clothfit.base import interrupts
from clothfit.base.arrays import Array, Flags
from clothfit.derivative.stencil import Stencil, stencil
from clothfit.derivative.step_jacobian import differentiate, jacobian
from clothfit.engine.forces import total
from clothfit.engine.solve import sparse
from clothfit.engine.step import implicit
from clothfit.engine.system import EXPLICIT, IMPLICIT, System
from clothfit.kernels.kernel import kernel
from clothfit.kernels.vectors import add, add_mass, combine, copy
from clothfit.objective.target import Target

if TYPE_CHECKING:
    from scipy.sparse import csr_array


class Track(NamedTuple):
    """What a target shows of one cloth at each of T + 1 steps."""

    x: Array  # (T + 1, n, 3), m
    seen: Flags  # (T + 1, n)


def track(goal: Target, system: System) -> Track:
    """What a target shows of a cloth at the times of the steps; the start and fixed vertices are known."""
    whole = np.flatnonzero(goal.fraction == 0)
    frames, n = goal.last_step + 1, len(system.x0)
    x, seen = np.broadcast_to(system.x0, (frames, n, 3)).copy(), np.zeros((frames, n), bool)
    for frame in whole:  # several frames may fall on one step: the last counts
        here = goal.observed[frame] & system.vertex.free
        x[goal.step[frame], here] = goal.positions[frame, here]
        seen[goal.step[frame], here] = True
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
    fill(system, alone, x, v, implicit.workspace(system), jacobian(system, alone), out)
    interrupts.check()
    return out


def velocities(system: System, x: Array) -> Array:
    """Velocities (T + 1, n, 3) that the integration method gives positions (T + 1, n, 3)."""
    moved = np.diff(x, axis=0) / system.h
    rest = system.v0[None]
    return np.concatenate([moved, moved[-1:]] if system.method == EXPLICIT else [rest, moved])


def valid_rows(system: System, near: Stencil, track: Track, steps: int) -> Flags:
    """Which rows (T, n) have all their positions seen: of a free vertex and its neighbours, at three steps."""
    from scipy.sparse import csr_array

    n = len(system.x0)
    unseen = ~(track.seen | ~system.vertex.free)
    touched = csr_array((np.ones(len(near.neighbour)), near.neighbour, near.start), shape=(n, n))
    missing = np.asarray((touched @ unseen.T.astype(float)).T > 0)  # (T + 1, n), of a vertex or a neighbour
    bad = missing[:steps] | missing[1 : steps + 1]
    if system.method == EXPLICIT:
        bad |= missing[2 : steps + 2]
    else:
        bad[1:] |= missing[: steps - 1]
    return np.ascontiguousarray(~bad & system.vertex.free)  # in one order, however few steps: to compile once for


@kernel
def fill(system, near, x, v, work, step, out):
    """Write the rows of all steps."""
    h, mass, b = system.h, system.vertex.mass, work.b
    newton = system.method == IMPLICIT and system.newton_iterations > 1
    for t in range(len(out.residual)):
        r = out.residual[t]
        u = v[t + 1] if newton else v[t]
        differentiate(system, near, x[t], v[t], v[t + 1], u, newton, work, step)
        r[:] = 0.0
        if system.method == IMPLICIT and not newton:
            sparse.multiply(work.A, v[t + 1], r)  # r = A w − M v − b, with what `differentiate` left
            add(-1.0, b, r)
        else:
            b[:] = 0.0
            combine(1.0, x[t], h if newton else 0.0, u, work.y)
            total.add_force(system, work.y, u, b)
            add_mass(mass, 1.0, v[t + 1], r)
            add(-h, b, r)
        add_mass(mass, -1.0, v[t], r)
        copy(step.by_mass, out.mass[t])
        for i in range(len(step.by_stiffness)):
            copy(step.by_stiffness[i], out.stiffness[t, i])


def summed_twice(rows: Balances) -> Balances:
    """The balances summed twice over time, up to where a vertex' first row is missing."""
    valid: Flags = np.asarray(np.minimum.accumulate(rows.valid, axis=0), bool)
    sums = [np.cumsum(np.cumsum(np.where(mask(rows.valid, a), a, 0.0), axis=0), axis=0) for a in rows[:2]]
    return Balances(sums[0], sums[1], np.cumsum(np.cumsum(rows.stiffness, axis=0), axis=0), valid)


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


def matrix(rows: Balances, system: System) -> tuple[csr_array, Array]:
    """C (N, n + S) of all masses and stiffnesses, and r (N,), over the valid rows, per vertex mass."""
    from scipy.sparse import csr_array

    steps, n = rows.valid.shape
    springs, ends = len(system.springs.rest), system.springs.ends
    weight = 1.0 / system.vertex.mass
    row = np.arange(steps * n * 3).reshape(steps, n, 3)
    mass_column = np.broadcast_to(np.arange(n)[:, None], row.shape)
    spring_column = np.broadcast_to(n + np.arange(springs)[:, None, None], rows.stiffness.shape)
    values = [(rows.mass * weight[:, None]).ravel(), (rows.stiffness * weight[ends][:, :, None]).ravel()]
    places = [row.ravel(), row[:, ends].ravel()], [mass_column.ravel(), spring_column.ravel()]
    entries = (np.concatenate(values), (np.concatenate(places[0]), np.concatenate(places[1])))
    kept = np.flatnonzero(np.repeat(rows.valid.ravel(), 3))
    whole = csr_array(entries, shape=(steps * n * 3, n + springs))
    return whole[kept], (rows.residual * weight[:, None]).ravel()[kept]
