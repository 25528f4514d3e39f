"""The momentum fit: masses and stiffnesses straight from the balance of momentum along the target motion.

The step's residual r (`step.implicit`) is linear in masses and stiffnesses, and where a vertex and its neighbours are
seen in successive frames, positions give the velocities, v⁺ = (x⁺ − x)/h, and so everything else in r. All these
balances together are one sparse linear least-squares problem,

    min_p Σ_t Σ_i |r_ti(p₀) − C_ti (p − p₀)|² / m_i²,      lower ≤ p ≤ upper,

without a starting point's luck and without a simulation. Directions that the balances do not determine (masses and
stiffnesses by a common factor where nothing else acts) keep their part of p₀.

Noise: an error of a position enters three balances, with weights 1, −2, 1 over h². Summing the balances twice over time
undoes that: row t then compares where the forces so far carry the vertex with where it is, and the errors
of different rows are independent again, which is how least squares weighs right. What is left is the noise within the
forces, lessened by smoothing the target over a few frames. Which treatment is best is for the motion to say: see
`TREATMENTS`.

With several Newton iterations the residual of the converged step is used. Reference for equation-error estimation: L.
Ljung, System Identification, 1999, chapter 7.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from clothfit import bounded, interrupts, sparse
from clothfit.arrays import Array, Flags, Indices
from clothfit.block import Block
from clothfit.columns import columns
from clothfit.fit_vector import bounds
from clothfit.forces import total
from clothfit.kernel import kernel
from clothfit.kinds import LETTERED
from clothfit.objective import Objective, Run
from clothfit.sensitivity import Columns
from clothfit.stencil import Stencil, stencil
from clothfit.step import implicit
from clothfit.step.jacobian import differentiate, jacobian
from clothfit.system import EXPLICIT, IMPLICIT, System, with_elements
from clothfit.target import Target
from clothfit.vectors import add, add_mass, combine

if TYPE_CHECKING:
    from scipy.sparse import csr_array


DENSE = 6000
"""Parameters up to which the normal equations are a dense matrix."""


class Treatment(NamedTuple):
    """What is done to the target and to the balances against noise."""

    frames: int  # over which the target is smoothed, odd
    summed: bool  # whether the balances are summed twice over time


TREATMENTS = (
    Treatment(1, False),
    Treatment(1, True),
    Treatment(7, True),
    Treatment(15, True),
    Treatment(7, False),
    Treatment(15, False),
)
"""From exact targets to very noisy ones."""


class Track(NamedTuple):
    """What a target tells of one cloth at each of T + 1 steps."""

    x: Array  # (T + 1, n, 3), m
    seen: Flags  # (T + 1, n)


def track(goal: Target, system: System) -> Track:
    """What a target tells of a cloth at the times of the steps; its start, and fixed vertices, are known."""
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
    return np.asarray(~bad & system.vertex.free)


@kernel
def fill(system, near, x, v, work, step, out):
    """Write the rows of all steps."""
    h, mass, b = system.h, system.vertex.mass, work.b
    newton = system.method == IMPLICIT and system.newton_iterations > 1
    for t in range(len(out.residual)):
        r = out.residual[t]
        u = v[t + 1] if newton else v[t]
        differentiate(system, near, x[t], v[t], v[t + 1], u, 1 if newton else 0, work, step)
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
        out.mass[t] = step.by_mass
        out.stiffness[t] = step.by_stiffness


def fit(objective: Objective, p: Array, fitted: Flags, treatment: Treatment = TREATMENTS[0]) -> Array:
    """Fit the masses and stiffnesses among the parameters p (P,) that are `fitted` (P,); the rest stays.

    What no complete balance tells of stays as well: everything, where the target has no three successive steps.
    """
    lower, upper = bounds(objective.scene)
    found = p.copy()
    for cloth in objective.cloths:
        own = [block for block in objective.blocks if block.cloth == cloth and block.name in LETTERED]
        places = np.concatenate([np.arange(b.start, b.start + b.count) for b in own] or [np.zeros(0, int)])
        places = places[fitted[places]]
        if not len(places):
            continue
        column = np.full(len(p), -1, np.int32)
        column[places] = np.arange(len(places))
        parts = [rows_of(objective, run, p, own, column, treatment) for run in objective.runs if run.cloth == cloth]
        found[places] = solve(*stacked(parts), p[places], lower[places], upper[places])
    return found


def information(
    objective: Objective, p: Array, fitted: Flags, factor: Array
) -> tuple[Array, Array, float, int] | None:
    """H = CᵀC and g = −Cᵀr (Q,) of the balances at p (P,), by the parameters that are `fitted`, times `factor` (P,);
    their sum of squares and number. None unless every free vertex is seen at every step and only masses and
    stiffnesses are fitted: then a direction that the balances do not show leaves the motion as it is, and only then.
    """
    kinds = {block.name for block in objective.blocks if fitted[block.part].any()}
    if not (objective.plain and kinds <= set(LETTERED)) or int(fitted.sum()) > DENSE:
        return None
    places = np.flatnonzero(fitted)
    H, g, squares, count = np.zeros((len(places),) * 2), np.zeros(len(places)), 0.0, 0
    for run in objective.runs:
        own = [block for block in objective.blocks if block.cloth == run.cloth]
        column = np.full(len(p), -1, np.int32)
        for block in own:
            column[block.part] = np.where(fitted[block.part], (np.cumsum(fitted) - 1)[block.part], -1)
        C, r = rows_of(objective, run, p, own, column, TREATMENTS[0], len(places))
        steps = run.comparison.last_step - (1 if run.system.method == EXPLICIT else 0)
        if len(r) < 3 * steps * int(run.system.vertex.free.sum()):
            return None
        scaled = C.multiply(factor[places][None, :]).tocsr()
        H += (scaled.T @ scaled).toarray()
        g -= scaled.T @ r
        squares, count = squares + float(r @ r), count + len(r)
    return H, g, squares, count


def rows_of(
    objective: Objective,
    run: Run,
    p: Array,
    own: Sequence[Block],
    column: Indices,
    treatment: Treatment,
    width: int | None = None,
) -> tuple[csr_array, Array]:
    """C (N, Q) and r (N,) of one run, by the parameters of its masses and stiffnesses; Q is `width`, or as many as
    `column` (P,) has.
    """
    system = with_elements(run.system, objective.elements(run, p))
    seen = track(run.comparison.goal, system)
    rows = balances(system, smoothed(seen, system.x0, treatment.frames) if treatment.frames > 1 else seen)
    C, r = matrix(summed_twice(rows) if treatment.summed else rows, system)
    wanted = columns(system, own, column, np.ones(len(p)), width or int(column.max()) + 1)
    return C @ spread(wanted), r


def spread(wanted: Columns) -> csr_array:
    """∂(masses, stiffnesses)/∂parameters (n + S, Q)."""
    from scipy.sparse import csr_array

    column = np.concatenate([wanted.mass.column, wanted.stiffness.column])
    factor = np.concatenate([wanted.mass.factor, wanted.stiffness.factor])
    moved = np.flatnonzero(column >= 0)
    return csr_array((factor[moved], (moved, column[moved])), shape=(len(column), wanted.width))


def stacked(parts: Sequence[tuple[csr_array, Array]]) -> tuple[csr_array, Array]:
    """The rows of several runs, one below the other."""
    from scipy.sparse import csr_array, vstack

    return csr_array(vstack([C for C, _ in parts])), np.concatenate([r for _, r in parts])


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


def iterated(scaled: csr_array, r: Array) -> Array:
    """The least-squares solution q (Q,) of scaled q = r by LSMR, for problems too large for a dense matrix."""
    from scipy.sparse.linalg import lsmr

    q, *_ = lsmr(scaled, r, atol=1e-15, btol=1e-15, conlim=0.0, maxiter=4000)
    return np.asarray(q)


def solve(C: csr_array, r: Array, p: Array, lower: Array, upper: Array) -> Array:
    """The parameters (Q,) within the bounds that make r − C (q − p) least, from p (Q,); C (N, Q).

    What the rows do not determine stays as it is in p. Two rounds of refinement with the rows themselves undo what
    squaring the matrix costs.
    """
    from scipy.sparse import diags_array

    size = np.sqrt(np.asarray(C.multiply(C).sum(axis=0)).reshape(-1))
    told = size > 0
    scale = np.where(told, size, 1.0)
    scaled = C @ diags_array(1.0 / scale)
    low, high = (lower - p) * scale, (upper - p) * scale
    if len(p) > DENSE:
        q = iterated(scaled, r)
        return np.asarray(np.where(told, np.clip(p + q / scale, lower, upper), p))
    H = (scaled.T @ scaled).toarray()
    q = np.zeros(len(p))
    for _ in range(3):
        g = -(scaled.T @ (r - scaled @ q))
        q = q + bounded.solve(H, g, low - q, high - q)
    return np.asarray(np.where(told, np.clip(p + q / scale, lower, upper), p))
