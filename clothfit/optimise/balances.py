"""The balances of momentum along a target motion.

The step's residual r (`step.implicit`) is linear in masses and stiffnesses. Where a vertex and its neighbours are seen
in successive frames, positions give the velocities, v⁺ = (x⁺ − x)/h, and so everything else in r. With several Newton
iterations the residual of the converged step is used.

A BDF2 step (`step.bdf2`) gives v⁺ = (x⁺ − x̃)/h' from three positions, and its balance needs two velocities before it:
five positions in all. Its first step is an implicit Euler step; others that the guard made so are not in balance.

Steps may have been taken otherwise than as the scene says (`step.guard`): with the clamped matrix, or only a part of
them, v⁺ = θ w. Their balances are as linear as the others', in another `Form`; which steps these are is not known
before the parameters are (`momentum`).

The rows of the balances as linear equations C q = r in Q parameters, weighted by one over each vertex' mass.

C is never formed: the entries of a row are those of its vertex' mass and springs, the same ones in every step, and what
the parameters make of these is one sparse matrix. The normal matrix CᵀC couples masses and stiffnesses that share a
vertex, so it is as sparse as the cloth.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, NamedTuple

import numpy as np
from numpy.typing import NDArray

from clothfit.base import interrupts
from clothfit.base.arrays import Array, Flags, Indices
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
    from scipy.sparse import csr_array

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
    near = stencil(system)
    steps = len(track.x) - (2 if system.method == EXPLICIT else 1)
    n, springs = len(system.x0), len(system.springs.rest)
    wanted = np.arange(steps) if only is None else only
    r, mass, stiffness = (np.zeros((len(wanted), *shape)) for shape in ((n, 3), (n, 3), (springs, 2, 3)))
    out = Balances(r, mass, stiffness, valid_rows(system, near, track, steps)[wanted])
    x, v = np.ascontiguousarray(track.x), velocities(system, track.x)
    system = clamped(system) if form.clamped else system
    two = system.method == BDF2
    pair = bdf2.forms(system) if two else (system, system)
    memory = implicit.workspace(system), jacobian(system, near)
    meeting.clear(system.colliders)
    length = max(CHUNK // max(6 * (n + springs), 1), 1)
    for first in range(0, len(wanted), length):
        own = wanted[first : first + length]
        w = v[own + 1] / form.theta
        fill(*pair, two, x, v, w, own, *memory, out.of(slice(first, first + len(own))))
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
def fill(system, inner, two, x, v, after, steps, work, step, out):
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
            write(inner, work.x_base, work.v_base, w if late else work.u, w, True, work, step, now)
        else:
            write(system, x[t], v[t], w if late else v[t], w, late, work, step, now)


@kernel
def write(system, x, v, u, w, later, work, step, row):
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


class Pattern(NamedTuple):
    """Which masses and springs, M elements in all, the rows of each of n vertices have: its mass, and E springs."""

    start: Indices  # (n + 1,): vertex i has the springs from start[i] to start[i + 1] − 1
    spring: Indices  # (E,)
    side: Indices  # (E,), which end the vertex is
    first: Indices  # (n + 1,): the pairs of elements of vertex i in `place`
    place: Indices  # (Σ k²,), of the pairs of k elements: where they are in the entries of the normal matrix
    pointers: Indices  # (M + 1,), of the normal matrix, row by row
    columns: Indices  # (its entries,)


def pattern(system: System) -> Pattern:
    """The pattern of a cloth."""
    n, ends = len(system.x0), system.springs.ends
    vertex = ends.T.ravel()
    order = np.argsort(vertex, kind="stable")
    spring, side = np.tile(np.arange(len(ends)), 2)[order], np.repeat([0, 1], len(ends))[order]
    start = np.searchsorted(vertex[order], np.arange(n + 1))
    size = np.diff(start) + 1
    own = np.insert(n + spring, start[:-1], np.arange(n))  # the elements of each vertex, its mass first
    begin = np.append(0, np.cumsum(size))
    first = np.append(0, np.cumsum(size**2))
    count = n + len(ends)
    of = np.repeat(np.arange(n), size**2)
    at = np.arange(first[-1]) - first[of]
    keys = own[begin[of] + at // size[of]].astype(np.int64) * count + own[begin[of] + at % size[of]]
    distinct, place = np.unique(keys, return_inverse=True)
    pointers = np.searchsorted(distinct, np.arange(count + 1, dtype=np.int64) * count)
    found = (start, spring, side, first, place.reshape(-1), pointers, distinct % count)
    return Pattern(*(np.ascontiguousarray(each, dtype=np.int32) for each in found))


class Rows:
    """The rows of one run, T steps of them."""

    def __init__(
        self, found: Balances, system: System, spread: csr_array, shared: Pattern | None = None
    ) -> None:
        """`spread` (M, Q): the derivative of masses and stiffnesses by the parameters; `shared`: the cloth's pattern,
        where it is known.
        """
        self.found, self.system, self.spread = found, system, spread
        self.pattern = pattern(system) if shared is None else shared
        self.weight = 1.0 / system.vertex.mass
        self.base = np.concatenate([system.vertex.mass, system.springs.stiffness])

    @property
    def counts(self) -> Array:
        """The number of rows of each step (T,)."""
        return np.asarray(3 * self.found.valid.sum(axis=1))

    def replace(self, steps: Places, other: Balances) -> None:
        """Take the balances of some steps from others."""
        for mine, theirs in zip(self.found, other, strict=True):
            mine[steps] = theirs

    def sizes(self, q: Array) -> tuple[Array, Array]:
        """The root of the squares of each step's residuals r − C q at q (Q,), and of Σ_j |C_ij p_j| over all masses and
        stiffnesses p there, what residuals are small beside, (T,) each.
        """
        found, squares, terms = self.found, *(np.zeros(len(self.found.valid)) for _ in range(2))
        change = self.spread @ q
        measure(self.pattern, *found, self.weight, change, self.base + change, squares, terms)
        return np.sqrt(squares), np.sqrt(terms)

    def gram(self, kept: Flags) -> csr_array:
        """CᵀC (Q, Q) of the steps (T,) that are kept."""
        from scipy.sparse import csr_array

        made, M = np.zeros(len(self.pattern.columns)), self.spread.shape[0]
        for t in np.flatnonzero(kept):
            _, mass, stiffness, valid = (each[t] for each in self.found)
            add_squares(self.pattern, mass, stiffness, valid, self.weight, made)
            interrupts.check()
        whole = csr_array((made, self.pattern.columns, self.pattern.pointers), shape=(M, M))
        return csr_array(self.spread.T @ whole @ self.spread)

    def right(self, q: Array, kept: Flags) -> Array:
        """Cᵀ(r − C q) (Q,) of the steps (T,) that are kept."""
        found, out = self.found, np.zeros(self.spread.shape[0])
        add_right(self.pattern, *found[:3], found.valid & kept[:, None], self.weight, self.spread @ q, out)
        return np.asarray(self.spread.T @ out)


ANCHOR = 1e6
"""Weight of a mass that is held, relative to the largest of CᵀC."""


class Equations:
    """The rows of several runs by the same Q parameters; their steps one after the other, S in all."""

    def __init__(self, parts: Sequence[Rows], anchored: bool = False) -> None:
        """`anchored`: the mass of the whole cloth is held."""
        self.parts, self.anchor = parts, np.zeros(0)
        self.counts = np.concatenate([part.counts for part in parts])
        self.Q = parts[0].spread.shape[1]
        if anchored:
            n = len(parts[0].weight)
            whole = parts[0].spread[:n].sum(axis=0)
            largest = self.gram(self.counts > 0).diagonal().max(initial=0.0)
            self.anchor = whole * np.sqrt(ANCHOR * largest / max(whole @ whole, np.finfo(float).tiny))

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


@kernel
def entries(pattern, i, mass, stiffness, factor, out):
    """Write the entries (k, 3) of the rows of vertex i in a step, times a factor; returns k."""
    for c in range(3):
        out[0, c] = factor * mass[i, c]
    count = 1
    for j in range(pattern.start[i], pattern.start[i + 1]):
        for c in range(3):
            out[count, c] = factor * stiffness[pattern.spring[j], pattern.side[j], c]
        count += 1
    return count


@kernel
def most(pattern):
    """The most elements that a vertex has."""
    found = 0
    for i in range(len(pattern.start) - 1):
        found = max(found, pattern.start[i + 1] - pattern.start[i] + 1)
    return found


@kernel
def element(pattern, i, k):
    """The k-th element of vertex i."""
    return i if k == 0 else len(pattern.start) - 1 + pattern.spring[pattern.start[i] + k - 1]


@kernel
def left(pattern, i, own, count, c, known, q):
    """What of a known number a row of vertex i, component c of its k = `count` entries `own`, leaves for q (M,)."""
    for k in range(count):
        known -= own[k, c] * q[element(pattern, i, k)]
    return known


@kernel(nogil=True)
def add_squares(pattern, mass, stiffness, kept, weight, out):
    """Add CᵀC of a step's kept rows (n,) to the entries of the normal matrix."""
    own = np.zeros((most(pattern), 3))
    for i in range(len(kept)):
        if not kept[i]:
            continue
        count, at = entries(pattern, i, mass, stiffness, weight[i], own), pattern.first[i]
        for a in range(count):
            for b in range(count):
                out[pattern.place[at]] += own[a, 0] * own[b, 0] + own[a, 1] * own[b, 1] + own[a, 2] * own[b, 2]
                at += 1


@kernel(nogil=True)
def measure(pattern, residual, mass, stiffness, kept, weight, q, p, squares, terms):
    """Add the squares of the kept residuals r − C q (T, n) for q (M,) to those of each step, and those of Σ |C p|."""
    own = np.zeros((most(pattern), 3))
    for t in range(len(kept)):
        for i in range(len(weight)):
            if not kept[t, i]:
                continue
            count = entries(pattern, i, mass[t], stiffness[t], weight[i], own)
            for c in range(3):
                away, size = left(pattern, i, own, count, c, weight[i] * residual[t, i, c], q), 0.0
                for k in range(count):
                    size += abs(own[k, c] * p[element(pattern, i, k)])
                squares[t] += away * away
                terms[t] += size * size


@kernel(nogil=True)
def add_right(pattern, residual, mass, stiffness, kept, weight, q, out):
    """Add Cᵀ(r − C q) of the kept rows (T, n) for q (M,) to `out` (M,)."""
    own = np.zeros((most(pattern), 3))
    for t in range(len(kept)):
        for i in range(len(weight)):
            if not kept[t, i]:
                continue
            count = entries(pattern, i, mass[t], stiffness[t], weight[i], own)
            for c in range(3):
                away = left(pattern, i, own, count, c, weight[i] * residual[t, i, c], q)
                for k in range(count):
                    out[element(pattern, i, k)] += own[k, c] * away
