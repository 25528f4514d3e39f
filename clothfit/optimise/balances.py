"""The balances of momentum along a target motion.

The step's residual r (`step.implicit`) is linear in masses and stiffnesses. Where a vertex and its neighbours are seen
in successive frames, positions give the velocities, v⁺ = (x⁺ − x)/h, and so everything else in r. With several Newton
iterations the residual of the converged step is used.

A BDF2 step (`step.bdf2`) gives v⁺ = (x⁺ − x̃)/h' from three positions, and its balance needs two velocities before it:
five positions in all. Its first step is an implicit Euler step, v⁺ = (x⁺ − x)/h.

Steps that were taken otherwise than as the scene says (`step.guard`), with the clamped matrix, only a part θ of them,
or as Euler steps among those of BDF2, are balances of that form: of the clamped system, with w = v⁺ / θ. Which these
are is not known before the parameters are (`momentum`); taken for plain ones they spoil up to three balances each.

The rows of the balances as linear equations C q = r in Q parameters, weighted by one over each vertex' mass.

C is never formed: the entries of a row are those of its vertex' mass and springs, the same ones in every step. So each
vertex adds one small matrix to CᵀC, of all its rows, and what the parameters make of masses and stiffnesses is one
sparse matrix. The normal matrix couples masses and stiffnesses that share a vertex, so it is as sparse as the cloth.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from clothfit.base import interrupts
from clothfit.base.arrays import Array, Flags, Indices
from clothfit.derivative.step_jacobian import Stencil, differentiate, jacobian, stencil
from clothfit.engine import contact_steps
from clothfit.engine.forces import collider_rows, contact, total
from clothfit.engine.inputs.tables import couple_change, set_inputs
from clothfit.engine.prescribed import Forms
from clothfit.engine.rollout import Taken
from clothfit.engine.solve import sparse
from clothfit.engine.step import bdf2, implicit
from clothfit.engine.system import BDF2, EXPLICIT, IMPLICIT, System, meets_itself, mobile
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


STEPS = 300
"""Steps, the first ones, that a patch has at most."""

CHUNK = 4_000_000
"""Numbers between two looks at interrupts."""


def balances(system: System, track: Track, exact: bool = True, forms: Forms | None = None) -> Balances:
    """The balances of momentum along a track, with the system's masses and stiffnesses as p₀, of steps of these `forms`
    or, by default, plain ones. In an `exact` track the positions show which pairs of the cloth press, and how deep;
    else what these may push is left out.
    """
    near = stencil(system)
    steps = len(track.x) - (2 if system.method == EXPLICIT else 1)
    forms = (forms or plain(system, steps)).part(0, steps)
    euler: Flags = np.asarray(forms.euler | (system.method != BDF2))
    n, springs = len(system.x0), len(system.springs.rest)
    r, mass, stiffness = (np.zeros((steps, *shape)) for shape in ((n, 3), (n, 3), (springs, 2, 3)))
    x, v = np.ascontiguousarray(track.x), velocities(system, track.x, euler)
    (valid, loads), pressing = valid_rows(system, near, track, v, euler), dict[int, Indices]()
    valid[forms.more > 0] = False  # positions do not show where its last iteration begins
    if loads.shape[1]:
        valid[1:][forms.more[:-1] > 0] = False
    if system.surface and meets_itself(system):
        if exact and system.method >= IMPLICIT:
            pressing = pressing_pairs(system, x, v, euler, valid)
        else:
            valid &= ~touched_rows(system.surface, track.x, steps)
    out = Balances(r, mass, stiffness, valid)
    w = v[1 : steps + 1] / forms.theta[:, None, None]
    memory = implicit.workspace(system), jacobian(system, near, states=False)
    contact.clear(system.colliders)
    for part in chunks(out):
        fill(*both(system), x, v, w, euler, loads, part.start, *memory, of_steps(out, part))
    for t in np.union1d(np.flatnonzero(forms.clamped | forms.predicted), list(pressing)).astype(int).tolist():
        interrupts.check()
        form, room = Taken(system).form(bool(forms.predicted[t]), bool(forms.clamped[t])), memory[0]
        if t in pressing:
            surface = contact_steps.surface_of(system, t, x[t])
            form, room = contact_steps.with_pairs(form, room, surface, x[t], pressing[t])
        fill(*both(form), x, v, w, euler, loads, t, room, memory[1], of_steps(out, slice(t, t + 1)))
    return out


def both(system: System) -> tuple[System, System]:
    """The systems of Euler and of other steps."""
    return bdf2.forms(system) if system.method == BDF2 else (system, system)


def plain(system: System, steps: int) -> Forms:
    """The forms of steps that are all taken as the scene says, but for the first of BDF2."""
    none = np.zeros(steps, bool)
    return Forms(none, (np.arange(steps) == 0) & (system.method == BDF2), none, np.ones(steps), np.zeros(steps))


def of_steps(rows: Balances, steps: slice) -> Balances:
    """The rows of some steps."""
    return Balances(rows.residual[steps], rows.mass[steps], rows.stiffness[steps], rows.valid[steps])


def chunks(rows: Balances) -> Iterator[slice]:
    """The steps in parts, between which interrupts are looked at."""
    steps, n, _ = rows.mass.shape
    length = max(CHUNK // max(6 * (n + rows.stiffness.shape[1]), 1), 1)
    for first in range(0, steps, length):
        yield slice(first, min(first + length, steps))
        interrupts.check()


def velocities(system: System, x: Array, euler: Flags) -> Array:
    """Velocities (T + 1, n, 3) that steps, of which some are `euler` (T,) ones, give positions (T + 1, n, 3)."""
    moved = np.diff(x, axis=0) / system.h
    rest = system.v0[None]
    if system.method == BDF2:
        moved[1:] = np.where(euler[1:, None, None], moved[1:], 1.5 * moved[1:] - 0.5 * moved[:-1])
    return np.concatenate([moved, moved[-1:]] if system.method == EXPLICIT else [rest, moved])


def valid_rows(system: System, near: Stencil, track: Track, v: Array, euler: Flags) -> tuple[Flags, Array]:
    """Which rows (T, n) have all their positions seen: of a free vertex and its neighbours, at three steps or five; and
    the loads of `active_rows`.
    """
    from scipy.sparse import csr_array

    steps = len(euler)
    n = len(system.x0)
    unseen = ~(track.seen | ~mobile(system))
    touched = csr_array((np.ones(len(near.neighbour)), near.neighbour, near.start), shape=(n, n))
    missing = np.asarray((touched @ unseen.T.astype(float)).T > 0)  # (T + 1, n), of a vertex or a neighbour
    bad = missing[:steps] | missing[1 : steps + 1]
    if system.method == EXPLICIT:
        bad |= missing[2 : steps + 2]
    for back in {EXPLICIT: (), BDF2: (1, 2, 3)}.get(system.method, (1,)):
        bad[back:] |= missing[: max(steps - back, 0)]
    loads = np.zeros((steps + 1, 0))
    if system.colliders is not None and system.method >= IMPLICIT and len(system.colliders.rows):
        met, loads = active_rows(system, system.colliders, track.x, v, euler)
        bad |= met
        bad[1:] |= met[:-1]
    return np.ascontiguousarray(~bad & system.vertex.free), loads  # in one order, to compile once for all


def begun(system: System, x: Array, v: Array, t: int, euler: bool) -> Array:
    """Where the first iteration of step t is linearised, (n, 3), of positions and velocities (T + 1, n, 3)."""
    if euler:
        return np.ascontiguousarray(x[t])
    return np.asarray(x[t] + (x[t] - x[t - 1] + 2.0 * system.h * (2.0 * v[t] - v[t - 1])) / 3.0)


def active_rows(
    system: System, colliders: collider_rows.Colliders, x: Array, v: Array, euler: Flags
) -> tuple[Flags, Array]:
    """Which rows (T, n) belong to vertices that may only end their step in a collider (`forces.contact`): whether the
    step knew them, the positions do not show; and what pressed the others in the step before (T + 1, R), N.
    """
    met = np.zeros((len(euler), x.shape[1]), bool)
    loads = np.full((len(euler) + 1, colliders.load.shape[1]), -1.0)
    late, stiffness = system.newton_iterations > 1, np.repeat(colliders.stiffness, x.shape[1])
    for t, first_order in enumerate(euler):
        set_inputs(system.inputs, system, t)
        y = begun(system, x, v, t, first_order)
        collider_rows.begin(colliders, system.h if first_order else 0.0)
        depth, left = contact.depths_along(colliders, y, np.ascontiguousarray(x[t + 1]))
        met[t] = ((depth <= 0) & (left > 0)).reshape(-1, len(y)).any(axis=0)
        if late:
            collider_rows.begin(colliders, 0.0)
            left = contact.depths_along(colliders, *(np.ascontiguousarray(x[t + 1]),) * 2)[0]
        loads[t + 1] = stiffness * np.maximum(left, 0.0)
    return met, loads


def touched_rows(surface: Surface, x: Array, steps: int) -> Flags:
    """Which rows (T, n) belong to vertices that self-contact may push in the step: of which forces the rows know
    nothing.
    """
    from clothfit.engine.forces.selfcontact import pairs

    near = np.zeros((steps + 1, x.shape[1]), bool)
    for t, y in enumerate(np.ascontiguousarray(x[: steps + 1])):
        near[t, pairs.contact_at(surface, y).vertices] = True
    return np.asarray(near[:-1] | near[1:])


def pressing_pairs(system: System, x: Array, v: Array, euler: Flags, valid: Flags) -> dict[int, Indices]:
    """The numbers of the pairs that press in each step, for the step's model, of positions and velocities (T + 1, n, 3)
    of which a step finds its pairs as in `contact_steps.pressed`. Rows (T, n) are no more `valid` where a pair presses
    that is not all seen, or of which positions do not say whether the step knew it.
    """
    from clothfit.engine.forces.selfcontact import pairs, rows

    found = dict[int, Indices]()
    for t, first_order in enumerate(euler):
        surface, begin, end = contact_steps.surface_of(system, t, x[t]), x[t], x[t + 1]
        y = end if system.newton_iterations > 1 else begun(system, x, v, t, first_order)
        view = pairs.around(surface, begin, end, 0.0)
        near = pairs.of_numbers(surface, begin, view)
        depth, left = contact.depths_along(near, y, end)
        known = np.isin(view, np.union1d(pairs.near(surface, begin, view), pairs.colliding(surface, begin, end, view)))
        deep = contact.depths_along(near, end, end)[0] > rows.FLAT * surface.thickness
        known &= deep | (depth > 0.0)  # as `rows.may_change` asks
        seen = (valid[t] | ~system.vertex.free)[near.vertices].all(axis=1)
        valid[t, near.vertices[(left > 0.0) & ~(known & seen)]] = False
        if (sure := (left > 0.0) & known & seen).any():
            found[t] = view[sure]
    return found


@kernel(nogil=True)
def fill(system, inner, x, v, w, euler, loads, first, work, step, out):
    """Write the rows of K steps from the `first` on, which are solved by w (T, n, 3): of steps that are not `euler`
    (T,) with the `inner` system.
    """
    late = system.method == IMPLICIT and system.newton_iterations > 1
    for k in range(len(out.residual)):
        t = first + k
        set_inputs(system.inputs, system, t)
        contact.set_load(system.colliders, loads[t])
        now = (out.residual[k], out.mass[k], out.stiffness[k])
        if euler[t]:
            write_row(system, x[t], v[t], w[t] if late else v[t], w[t], late, work, step, now)
        else:
            bdf2.extrapolate(inner.h, x[t], v[t], x[t - 1], v[t - 1], work)
            write_row(inner, work.x_base, work.v_base, w[t] if late else work.u, w[t], True, work, step, now)


@kernel
def write_row(system, x, v, u, w, later, work, step, row):
    """Write the row of a step to w that is linearised with u, at (x, u) or at a `later` point, (x + h u, u)."""
    A, b, mass = work.A, work.b, system.vertex.mass
    r, by_mass, by_stiffness = row
    differentiate(system, x, v, w, u, later, work, step)
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


class Patch(NamedTuple):
    """The rows of R/3 vertices in the T steps in which all of them are seen, by the K masses and stiffnesses there."""

    steps: Indices  # (T,), of all
    entries: Array  # (T, R, K)
    residual: Array  # (T, R), at `base`
    base: Array  # (K,)
    spread: Array  # (K, Q), their derivative by the parameters that they depend on
    family: Indices  # (K,), of each mass or stiffness: the masses, and the families of springs

    @property
    def by_families(self) -> Patch:
        """The same by one factor on the values of each family."""
        factors = self.base[:, None] * np.equal.outer(self.family, np.unique(self.family))
        moves = np.abs(self.spread).sum(axis=1, keepdims=True) > 0.0
        return self._replace(spread=np.where(moves, factors, 0.0))

    def away(self, q: Array) -> Array:
        """The residuals of the steps after changes q (Q, M), relative to their terms, (T, M)."""
        change = self.spread @ q
        left = np.linalg.norm(self.residual[..., None] - self.entries @ change, axis=1)
        terms = np.linalg.norm(np.abs(self.entries) @ np.abs(self.base[:, None] + change), axis=1)
        return relative(left, terms)


def relative(size: Array, terms: Array) -> Array:
    """Residuals relative to their terms."""
    return np.asarray(size / np.maximum(terms, np.finfo(float).tiny))


class Rows:
    """The rows of one run, T steps of them."""

    def __init__(self, found: Balances, system: System, spread: csr_array, family: Indices) -> None:
        """`spread` (M, Q): the derivative of masses and stiffnesses by the parameters; `family` (S,) of each spring.
        The rows are changed.
        """
        from scipy.sparse import csc_array, csr_array

        self.found, self.spread, self.ends = found, spread, system.springs.ends
        self.base = np.concatenate([system.vertex.mass, system.springs.stiffness])
        self.family = np.concatenate([np.full(len(system.vertex.mass), -1, np.int32), family])
        self.counts = np.asarray(3 * found.valid.sum(axis=1))  # rows of each step (T,)
        weight, n, halves = 1.0 / system.vertex.mass, len(system.vertex.mass), self.ends.ravel()
        for array, at in ((found.residual, np.arange(n)), (found.mass, np.arange(n)), (found.stiffness, self.ends)):
            array[~found.valid[:, at]] = 0.0
            array *= weight[at][..., None]
        at_vertex = csr_array((np.ones(len(halves)), (halves, np.arange(len(halves)))), shape=(n, len(halves)))
        self.of = np.split(at_vertex.indices, at_vertex.indptr[1:-1])  # the halves of springs at each vertex
        rows: Indices = np.ravel(3 * self.ends[..., None] + np.arange(3, dtype=np.int32))
        begins: Indices = np.arange(0, len(rows) + 1, 6, dtype=np.int32)
        entries = found.stiffness.reshape(len(found.stiffness), -1)
        self.springs = [csc_array((each, rows, begins), shape=(3 * n, len(self.ends))) for each in entries]  # C
        for springs, of_step in zip(self.springs, entries, strict=True):
            springs.data = of_step  # SciPy copies what is a small part of a large array, and `keep` changes them

    def terms(self, t: int, change: Array, size: bool = False) -> Array:
        """C p of step t, (n, 3), for changes p (M,) of masses and stiffnesses; `size`: Σ_j |C_ij p_j|."""
        mass, springs = self.found.mass[t], self.springs[t]
        if size:
            mass, springs, change = np.abs(mass), abs(springs), np.abs(change)
        heavier, stiffer = np.split(change, [len(mass)])
        return np.asarray(mass * heavier[:, None] + (springs @ stiffer).reshape(mass.shape))

    def left(self, t: int, change: Array) -> Array:
        """The residuals (n, 3) of step t after a change (M,) of masses and stiffnesses."""
        interrupts.check()
        return np.asarray(self.found.residual[t] - self.terms(t, change))

    def sizes(self, q: Array) -> tuple[Array, Array]:
        """The root of the squares of each step's residuals r − C q at q (Q,), and of Σ_j |C_ij p_j| over all masses and
        stiffnesses p there, what residuals are small beside, (T,) each.
        """
        change, whole = self.spread @ q, self.base + self.spread @ q
        away = [float(np.linalg.norm(self.left(t, change))) for t in range(len(self.counts))]
        terms = [float(np.linalg.norm(self.terms(t, whole, size=True))) for t in range(len(self.counts))]
        return np.array(away), np.array(terms)

    def by_columns(self) -> Array:
        """C of each row, (Q, T, n, 3)."""
        columns = self.spread.T.toarray()
        return np.array([[self.terms(t, column) for t in range(len(self.counts))] for column in columns])

    def keep(self, rows: Flags) -> None:
        """Let no others than these rows (T, n) count."""
        valid: Flags = np.asarray(self.found.valid & rows)
        for array, counts in zip(self.found[:3], (valid, valid, valid[:, self.ends]), strict=True):
            array[~counts] = 0.0
        self.found, self.counts = self.found._replace(valid=valid), np.asarray(3 * valid.sum(axis=1))

    def patch(self, vertices: Indices) -> Patch:
        """The rows of some vertices, (m,)."""
        own = [self.of[i] for i in vertices]
        halves, n = np.unique(np.concatenate(own)), len(self.of)
        springs = np.unique(halves // 2)
        elements = np.concatenate([vertices, n + springs])
        steps = np.flatnonzero(self.found.valid[:, vertices].all(axis=1))[:STEPS].astype(np.int32)
        C = np.zeros((len(steps), len(vertices), 3, len(elements)))
        for v, of in enumerate(own):
            C[:, v, :, v] = self.found.mass[steps, vertices[v]]
            at = len(vertices) + np.searchsorted(springs, of // 2)
            C[:, v, :, at] = self.found.stiffness[steps[:, None], of // 2, of % 2].swapaxes(0, 1)
        spread, shape = self.spread[elements], (len(steps), 3 * len(vertices))
        moved = np.unique(spread.indices)
        r = self.found.residual[steps][:, vertices].reshape(shape)
        entries, moves = C.reshape(*shape, len(elements)), spread[:, moved].toarray()
        return Patch(steps, entries, r, self.base[elements], moves, self.family[elements])

    def patches(self, size: int, most: int) -> Iterator[Patch]:
        """Some patches of so many vertices, which springs join, round those that are seen most often."""
        from scipy.sparse import csr_array
        from scipy.sparse.csgraph import breadth_first_order

        counts = np.asarray(self.found.valid.sum(axis=0))
        links = csr_array((np.ones(len(self.ends)), self.ends.T), shape=(len(counts),) * 2)
        best = np.flatnonzero((counts == counts.max()) & (counts > 0))
        apart = -(-len(best) // most) or 1
        for centre in best[(apart - 1) // 2 :: apart]:
            near = breadth_first_order(links, centre, directed=False, return_predecessors=False)
            yield self.patch(near[counts[near] > 0][:size])

    def gram(self, kept: Flags) -> csr_array:
        """CᵀC (Q, Q) of the steps (T,) that are kept."""
        from scipy.sparse import csr_array

        steps, M, n = np.flatnonzero(kept), self.spread.shape[0], len(self.of)
        halves, made = self.found.stiffness.reshape(len(kept), -1, 3), list[tuple[Array, Array, Array]]()
        for i, of in enumerate(self.of):
            C = np.concatenate([self.found.mass[steps, i, None], halves[steps[:, None], of]], axis=1)
            C, own = C.swapaxes(1, 2).reshape(-1, 1 + len(of)), np.append(i, n + of // 2)
            made.append(((C.T @ C).ravel(), np.repeat(own, len(own)), np.tile(own, len(own))))
            interrupts.check()
        entries, row, column = (np.concatenate(each) for each in zip(*made, strict=True))
        return csr_array(self.spread.T @ csr_array((entries, (row, column)), shape=(M, M)) @ self.spread)

    def right(self, q: Array, kept: Flags) -> Array:
        """Cᵀ(r − C q) (Q,) of the steps (T,) that are kept."""
        change, out = self.spread @ q, np.zeros(self.spread.shape[0])
        for t in np.flatnonzero(kept).tolist():
            away = self.left(t, change)
            out += np.append((self.found.mass[t] * away).sum(axis=1), np.asarray(self.springs[t].T @ away.ravel()))
        return np.asarray(self.spread.T @ out)

    def squares_along(self, q: Array, d: Array, kept: Flags) -> Array:
        """|C d|² and (C d)ᵀ(r − C q) of the steps (T,) that are kept, for changes q and d (Q,)."""
        change, way, sums = self.spread @ q, self.spread @ d, np.zeros(2)
        for t in np.flatnonzero(kept).tolist():
            along = self.terms(t, way)
            sums += [np.vdot(along, along), np.vdot(along, self.left(t, change))]
        return sums


ANCHOR, HELD = 1e6, 64
"""Weight of a mass that is held, relative to the largest of CᵀC; and how many masses, at most, it is the sum of: more
would make CᵀC of a large cloth dense.
"""


def anchor(moves: Array | csr_array, largest: float) -> Array:
    """What holds the sum of masses whose derivatives (n, Q) by the parameters these are, beside CᵀC, (Q,)."""
    whole = np.asarray(moves.sum(axis=0))
    size = float(np.linalg.norm(whole))
    return whole * np.sqrt(ANCHOR * largest) / size if size > 0.0 else whole


class Equations:
    """The rows of several runs by the same Q parameters; their steps one after the other, S in all."""

    def __init__(self, parts: Sequence[Rows], anchored: bool = False) -> None:
        """`anchored`: the mass of some vertices all over the cloth is held."""
        self.parts, self.anchor = parts, np.zeros(0)
        self.counts = np.concatenate([part.counts for part in parts])
        self.Q = parts[0].spread.shape[1]
        self.agreed: Flags | None = None  # (S,), once `momentum.consensus` has looked for them
        self.own = False  # whether some steps show that they are those of the model
        self.sure = False  # whether steps that agree, or all, balance as well as exact targets do
        if anchored:
            spread = parts[0].spread
            fitted = np.flatnonzero(np.diff(spread.indptr[: 1 + len(parts[0].of)]))
            held = fitted[:: -(-len(fitted) // HELD) or 1]
            self.anchor = anchor(spread[held], self.gram(self.counts > 0).diagonal().max(initial=0.0))

    def patches(self, size: int, most: int) -> Iterator[tuple[int, Iterator[Patch]]]:
        """Those of each part, with the number of steps before it."""
        before = 0
        for part in self.parts:
            yield before, part.patches(size, most)
            before += len(part.counts)

    def of_parts(self, kept: Flags) -> list[Flags]:
        """Flags of all steps (S,), by parts."""
        return np.split(kept, np.cumsum([len(part.counts) for part in self.parts])[:-1])

    def sizes(self, q: Array) -> tuple[Array, Array]:
        """As `Rows.sizes`, (S,)."""
        found = [part.sizes(q) for part in self.parts]
        return np.concatenate([size for size, _ in found]), np.concatenate([terms for _, terms in found])

    def gram(self, kept: Flags) -> csr_array:
        """CᵀC (Q, Q) of the steps (S,) that are kept."""
        from scipy.sparse import csr_array

        first, *others = (part.gram(own) for part, own in zip(self.parts, self.of_parts(kept), strict=True))
        whole = sum(others, start=first)
        if not len(self.anchor):
            return whole
        column = csr_array(self.anchor[:, None])
        return whole + column @ column.T

    def right(self, q: Array, kept: Flags) -> Array:
        """Cᵀ(r − C q) (Q,) of the steps (S,) that are kept."""
        found = zip(self.parts, self.of_parts(kept), strict=True)
        right = np.asarray(sum((part.right(q, own) for part, own in found), start=np.zeros(self.Q)))
        return right - self.anchor * (self.anchor @ q) if len(self.anchor) else right

    def length(self, q: Array, d: Array, kept: Flags) -> float:
        """The α with which |r − C (q + α d)|² of the steps (S,) that are kept is least; 1 where d changes nothing."""
        parts = zip(self.parts, self.of_parts(kept), strict=True)
        sums = sum((part.squares_along(q, d, own) for part, own in parts), start=np.zeros(2))
        if len(self.anchor):
            sums = sums + self.anchor @ d * np.array([self.anchor @ d, -self.anchor @ q])
        return float(sums[1] / sums[0]) if sums[0] > 0.0 else 1.0
