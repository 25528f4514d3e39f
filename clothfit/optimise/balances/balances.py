"""The balances of momentum along a target motion.

The step's residual r (`step.implicit`) is linear in masses and stiffnesses. Where a vertex and its neighbours are seen
in successive frames, positions give the velocities, v⁺ = (x⁺ − x)/h, and so everything else in r. With several Newton
iterations the residual of the converged step is used.

A BDF2 step (`step.bdf2`) gives v⁺ = (x⁺ − x̃)/h' from three positions, and its balance needs two velocities before it:
five positions in all. Its first step is an implicit Euler step; others that the guard made so are not in balance.

Steps may have been taken otherwise than as the scene says (`step.guard`): with the clamped matrix, or only a part of
them, v⁺ = θ w. Their balances are as linear as the others', in another `Form`; which steps these are is not known
before the parameters are (`trimming`).
"""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple

import numpy as np
from numpy.typing import NDArray

from clothfit.base import interrupts
from clothfit.base.arrays import Array, Flags
from clothfit.derivative.step_jacobian import Stencil, differentiate, jacobian, stencil
from clothfit.engine.forces import meeting, total, touch
from clothfit.engine.inputs.tables import couple_change, set_inputs
from clothfit.engine.solve import sparse
from clothfit.engine.step import bdf2, implicit
from clothfit.engine.system import BDF2, EXPLICIT, IMPLICIT, System, clamped, meets_itself, mobile
from clothfit.kernels.kernel import kernel
from clothfit.kernels.vectors import add, add_mass, copy
from clothfit.objective.target import Target

if TYPE_CHECKING:
    from clothfit.engine.forces.selfcontact.pairs import Surface


Places = NDArray[np.intp]
"""Numbers of steps."""


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

    def of(self, steps: slice | Places) -> Balances:
        """Those of some steps."""
        return Balances(self.residual[steps], self.mass[steps], self.stiffness[steps], self.valid[steps])


class Form(NamedTuple):
    """How a step was taken."""

    clamped: bool = False  # with the matrix that is positive definite whatever the state
    theta: float = 1.0  # the part of it


AS_GIVEN, CLAMPED = Form(), Form(clamped=True)

SHORTENED = tuple(Form(clamped, theta) for theta in (0.5, 0.25, 0.125) for clamped in (False, True))
"""Steps that were shortened; hardly one is shorter."""

CHUNK = 4_000_000
"""Numbers between two looks at interrupts."""


def forms(system: System) -> tuple[Form, ...]:
    """The forms that steps of a system may have besides the one that is given. Converged steps do not know with which
    matrix they were solved, and what the guard makes of BDF2 steps changes the velocities of those after them.
    """
    if system.method != IMPLICIT:
        return ()
    return SHORTENED[::2] if system.newton_iterations > 1 else (CLAMPED, *SHORTENED)


def balances(system: System, track: Track, form: Form = AS_GIVEN, only: Places | None = None) -> Balances:
    """The balances of momentum along a track, with the system's masses and stiffnesses as p₀, of steps of one form; of
    all T steps, or of some `only`.
    """
    near = stencil(system, 1)
    steps = len(track.x) - (2 if system.method == EXPLICIT else 1)
    n, springs = len(system.x0), len(system.springs.rest)
    wanted = np.arange(steps) if only is None else only
    r, mass, stiffness = (np.zeros((len(wanted), *shape)) for shape in ((n, 3), (n, 3), (springs, 2, 3)))
    out = Balances(r, mass, stiffness, valid_rows(system, near, track, steps)[wanted])
    alone = near._replace(start=np.zeros(n + 1, np.int32), neighbour=np.zeros(0, np.int32))
    x, v = np.ascontiguousarray(track.x), velocities(system, track.x)
    system = clamped(system) if form.clamped else system
    two = system.method == BDF2
    pair = bdf2.forms(system) if two else (system, system)
    memory = implicit.workspace(system), jacobian(system, alone)
    meeting.clear(system.colliders)
    length = max(CHUNK // max(6 * (n + springs), 1), 1)
    for first in range(0, len(wanted), length):
        own = wanted[first : first + length]
        w = v[own + 1] / form.theta
        fill(*pair, two, alone, x, v, w, own, *memory, out.of(slice(first, first + len(own))))
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
    if system.surface and meets_itself(system):
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


@kernel(nogil=True)
def fill(system, inner, two, near, x, v, after, steps, work, step, out):
    """Write the rows of K steps (K,) to the velocities `after` (K, n, 3): with `two` of BDF2's `forms`, all but the
    first step of the inner one.
    """
    late = system.method == IMPLICIT and system.newton_iterations > 1
    for k in range(len(steps)):
        t, w = steps[k], after[k]
        set_inputs(system.inputs, system, t)
        now = (out.residual[k], out.mass[k], out.stiffness[k])
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
