"""The sensitivity of a motion: how all positions change with each of Q parameters at once.

This is the forward sweep of `adjoint` with Q right-hand sides per step: the matrices of the step (`step_jacobian`) are
formed once, A is factorised once, and all columns go through dense linear algebra together. With f vertices that
parameters can move

    A dW = Y dX + U dV + M dV + C,     dX⁺ = dX + h dW,     dX, dV, dW (3 f, Q)

for those that are free; pins whose paths are fitted go along with these (`inputs.tables`).
A is factorised within its envelope (`envelope_cholesky`); one that is not positive definite, by sparse LU. What a
cloth that touches itself adds is in `contact`.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from clothfit.base import interrupts
from clothfit.base.arrays import Array, Elements, Indices
from clothfit.derivative import adjoint
from clothfit.derivative.adjoint import Observer, TrajectoryMemory
from clothfit.derivative.envelope_cholesky import Envelope, envelope, factorise, solve
from clothfit.derivative.step_jacobian import (
    add_loads,
    change_loads,
    change_loads_globally,
    differentiate,
    differentiate_globally,
    jacobian,
    stencil,
)
from clothfit.engine.forces import contact as contacts
from clothfit.engine.forces import springs
from clothfit.engine.inputs.tables import led, moves_of, set_direction, set_inputs, with_constant
from clothfit.engine.rollout import Rollout, Taken
from clothfit.engine.solve import sparse
from clothfit.engine.step import bdf2, implicit
from clothfit.engine.step.states import state_before, velocities, velocity
from clothfit.engine.system import BDF2, EXPLICIT, IMPLICIT, System, meets_itself, mobile, zeros
from clothfit.kernels.kernel import kernel
from clothfit.kernels.lanes.operations import add, fma, load, load3, mul, splat, store, store3
from clothfit.scene.block import Block

if TYPE_CHECKING:
    from scipy.sparse import csc_array

    from clothfit.derivative import contact


CALLS, FACTOR = 1000.0, 1.0 / 3000.0
"""A step of all columns together takes, besides their own time, as long as CALLS/N + FACTOR N sweeps of one column of N
unknowns: what is called from Python counts on small cloths, the factor on large ones. Measured with 9 to 10,000
vertices.
"""


LOCAL = ("mass", "stiffness", "rest")
"""Kinds that act on one vertex or spring each; `velocity` acts at the start only, every other kind everywhere."""

LEADING = ("path", "shift")
"""Kinds that move pins, and other vertices through them alone."""


class Columns(NamedTuple):
    """Q columns: the share ∂element/∂parameter of each in every mass, stiffness and rest length; and directions of the
    kinds that act everywhere.
    """

    width: int  # Q
    mass: Share
    stiffness: Share
    rest: Share  # empty where no rest length is asked for
    everywhere: tuple[tuple[int, Elements], ...]  # column, direction
    led: tuple[tuple[int, Elements], ...]  # the same of pins' paths
    velocity: tuple[tuple[int, Array], ...]  # column, change (n, 3) of the velocity at the start, m/s


class Share(NamedTuple):
    """The columns of each of E elements and the factors of its derivatives, row by row as in a sparse matrix: most
    kinds have one column for an element, smooth maps several.
    """

    start: Indices  # (E + 1,): the entries of element i are those from start[i] to start[i + 1] − 1
    column: Indices  # (N,), −1 for none
    factor: Array  # (N,)

    def along(self, q: int) -> Array:
        """The change of the elements (E,) along column q."""
        entries = np.where(self.column == q, self.factor, 0.0)
        if len(self.column) + 1 == len(self.start):
            return entries
        rows = np.repeat(np.arange(len(self.start) - 1), np.diff(self.start))
        return np.asarray(np.bincount(rows, weights=entries, minlength=len(self.start) - 1), float)


def columns(
    system: System, blocks: Sequence[tuple[Block, slice]], p: Array, column: Indices, factor: Array, count: int
) -> Columns:
    """The columns of one cloth's sensitivity by the parameters of `blocks` at p (P,), each with the places of its
    values among those of the system.

    `column` (P,) gives the column of each parameter, −1 where it is held, `factor` (P,) a factor of its derivative,
    `count` the number of columns.
    """
    local = {"mass": none(len(system.x0)), "stiffness": none(len(system.springs.rest)), "rest": none(0)}
    everywhere: list[tuple[int, Elements]] = []
    velocity: list[tuple[int, Array]] = []
    led: list[tuple[int, Elements]] = []
    for block, part in blocks:
        own = np.flatnonzero(column[block.part] >= 0) + block.start
        if block.name in LOCAL and len(own):
            before = none(len(system.springs.rest)) if block.name == "rest" else local[block.name]
            local[block.name] = within(before, share(block, p, column, factor), part)
            continue
        for i in own:
            unit = np.zeros(len(column))
            unit[i] = factor[i]
            whole = zeros(system, [block.name])
            change = getattr(whole, block.name)
            change[part] = block.spread(unit)
            if block.name == "velocity":
                velocity.append((int(column[i]), change))
            else:
                kept = led if block.name in LEADING else everywhere
                kept.append((int(column[i]), whole))
    shares = local["mass"], local["stiffness"], local["rest"]
    return Columns(count, *shares, tuple(everywhere), tuple(led), tuple(velocity))


def none(count: int) -> Share:
    """`count` elements without a column."""
    return one_each(np.full(count, -1, np.int32), np.zeros(count))


def within(whole: Share, own: Share, part: slice) -> Share:
    """A share in which the elements of a part are those of another one."""
    if len(own.start) == len(whole.start):
        return own
    counts = np.diff(whole.start)
    counts[part] = np.diff(own.start)
    begin, end = whole.start[part.start], whole.start[part.stop]
    column, factor = (
        np.concatenate([a[:begin], b, a[end:]])
        for a, b in ((whole.column, own.column), (whole.factor, own.factor))
    )
    return Share(np.append(0, np.cumsum(counts)).astype(np.int32), column, factor)


def one_each(column: Indices, factor: Array) -> Share:
    """One column for each element."""
    return Share(np.arange(len(column) + 1, dtype=np.int32), column, factor)


def share(block: Block, p: Array, column: Indices, factor: Array) -> Share:
    """The columns and factors of all elements of a block at p (P,)."""
    own, factors = column[block.part].reshape(-1), block.factors
    if factors is not None:
        entries = factors.entries(p[block.part]) * factor[block.part][factors.column]
        starts = np.searchsorted(factors.row, np.arange(len(factors.base) + 1)).astype(np.int32)
        return Share(starts, own[factors.column].astype(np.int32), entries)
    places = own if block.mode == "L" else np.full(block.shape[0], own[0])
    return one_each(places.astype(np.int32), np.array(block.spread(factor), float))


def sweep(
    system: System, memory: TrajectoryMemory, columns: Columns, observe: Observer | None = None
) -> Iterator[Array]:
    """Yield dX (3 f, Q) after every step, the coordinates of the movable vertices in order; always the same array.

    `observe` gets each chunk of the motion before dX after its steps is yielded.
    """
    state = TangentSweep(system, columns)
    for chunk in (chunk for segment in memory.forward() for chunk in segment.parts()):
        if observe:
            observe(chunk)
        for t in range(chunk.steps):
            state.through(chunk, t)
            interrupts.check()
            yield state.dx


class Point(NamedTuple):
    """What a step is linearised with, of n vertices: the arguments of `step_jacobian.differentiate`."""

    system: System
    x: Array  # (n, 3), m; x̃ of a BDF2 step
    v: Array  # (n, 3), m/s; ṽ of a BDF2 step
    u: Array  # (n, 3), m/s, velocity that the iteration starts from
    later: bool  # whether it is one of Newton's, linearised at x + h u
    work: implicit.Workspace


def point(system: System, chunk: Rollout, t: int, work: implicit.Workspace) -> Point:
    """Where the first iteration of step t of a chunk starts, for a system and its workspace."""
    x, v = chunk.x[t], velocity(chunk, t)
    if system.method != BDF2:
        return Point(system, x, v, v, False, work)
    euler, inner = bdf2.forms(system)
    if chunk.euler[t]:
        return Point(euler, x, v, v, False, work)
    x_before, v_before = state_before(chunk, t)
    bdf2.extrapolate(inner.h, x, v, x_before, v_before, work)
    return Point(inner, work.x_base, work.v_base, work.u, True, work)


class Pins:
    """Pins whose paths are fitted: how they move along all columns, and the free vertices with them; their rows among
    those of the f movable vertices, in arrays (3 f, Q).
    """

    def __init__(self, system: System, columns: Sequence[tuple[int, Elements]], place: Indices) -> None:
        """`columns` are those that move the pins, `place` (n,) the place of each vertex among the movable ones, or −1.
        """
        self.system, self.place, self.given = system, place, [direction for _, direction in columns]
        self.columns = np.array([column for column, _ in columns], int)
        self.any = bool(led(system.inputs, len(place)).any())

    def changes(self, row: int, width: int) -> Array:
        """Change of their places at a row of the tables, (3 L, Q) for L pins in the order of the vertices."""
        inputs = self.system.inputs
        assert inputs is not None
        pinned = inputs.pins[inputs.fitted.pin >= 0]
        found = np.zeros((len(pinned), 3, width))
        if self.given:
            found[:, :, self.columns] = moves_of(inputs, row, self.given)[inputs.fitted.pin >= 0]
        return found[np.argsort(pinned)].reshape(-1, width)

    def start(self, dx: Array, dv: Array) -> None:
        """Write the change of the state at the start."""
        if self.any:
            first, second = (self.changes(row, dx.shape[1]) for row in (0, 1))
            rows = self.rows
            dx[rows], dv[rows] = first, (second - first) / self.system.h

    @property
    def rows(self) -> Indices:
        """Places (3 L,) of their coordinates among the rows."""
        own = np.sort(self.place[led(self.system.inputs, len(self.place))])
        return np.asarray((3 * own[:, None] + np.arange(3)).reshape(-1), np.int32)

    def velocity(self, step: int, system: System, dx: Array) -> Array:
        """Change of their velocity in a step of this system, for that of where it begins, dx (3 L, Q)."""
        return (self.changes(step + 1, dx.shape[1]) - dx) / system.h

    def sent(self, step: int, system: System, width: int) -> Array:
        """Change of their velocity after an explicit Euler step."""
        return (self.changes(step + 2, width) - self.changes(step + 1, width)) / system.h

    def couple(self, system: System, y: Array, dw: Array, right: Array) -> None:
        """right −= A_fp dw_p at y (n, 3)."""
        assert system.inputs is not None
        add_coupling(system.springs, system.inputs.coupled, system.vertex.free, self.place, system.h, y, dw, right)


class TangentSweep:
    """The change of a state along all columns, (3 f, Q), and what the steps make of it."""

    def __init__(self, system: System, columns: Columns) -> None:
        """At the start of the motion."""
        self.system, self.taken, self.columns, free = system, Taken(system), columns, mobile(system)
        self.place = np.where(free, np.cumsum(free) - 1, -1).astype(np.int32)
        self.vertices = np.arange(len(free), dtype=np.int32)[:, None]
        self.pins, self.free = Pins(system, columns.led, self.place), np.repeat(system.vertex.free[free], 3)
        self.solve = Solver()
        self.everywhere = [(column, with_constant(direction)) for column, direction in columns.everywhere]
        self.near, self.work = stencil(system), implicit.workspace(system)
        self.by = jacobian(system, self.near, rest=len(columns.rest.column) > 0)
        self.scratch = tuple(np.zeros_like(system.x0) for _ in range(4))
        self.mass = np.repeat(system.vertex.mass[free], 3)[:, None]
        size = (3 * int(free.sum()), columns.width)
        self.dx, self.dv, self.dx_before, self.dv_before, self.dy = (np.zeros(size) for _ in range(5))
        for column, start in columns.velocity:
            self.dv[:, column] = np.where(system.vertex.free[:, None], start, 0.0)[free].reshape(-1)
        self.loads, self.new_loads = (np.zeros((len(self.by.by_load), columns.width)) for _ in range(2))
        self.pins.start(self.dx, self.dv)
        self.contact_columns: contact.Columns | None = None
        if meets_itself(system):
            from clothfit.derivative import contact  # which few scenes need

            self.contact_columns = contact.Columns(system, self.place, self.by.row)

    def through(self, chunk: Rollout, t: int) -> None:
        """Step t of a chunk of the motion."""
        set_inputs(self.system.inputs, self.system, chunk.first + t)
        contacts.load_active(self.system.colliders, chunk.bare(), t)
        for _, direction in self.everywhere:
            set_direction(self.system.inputs, self.system, chunk.first + t, direction)
        if self.contact_columns is not None:
            self.contact_step(chunk, t)
            return
        self.advance(point(self.taken.at(chunk, t), chunk, t, self.work), chunk, t)

    def contact_step(self, chunk: Rollout, t: int) -> None:
        """Step t of a cloth that touches itself."""
        from clothfit.engine import contact_steps
        from clothfit.engine.forces.selfcontact import zones

        own = contact_steps.taken(self.taken.at(chunk, t), self.work, chunk, t)
        self.advance(point(own.system, chunk.bare(), t, own.work), own.part, 0)
        if own.zones is not None:
            vertex, h = own.system.vertex, own.system.h
            zones.push_columns(own.zones, vertex, self.place, h, tuple(self.columns.mass), self.dx, self.dv)

    def advance(self, at: Point, chunk: Rollout, t: int) -> None:
        """Step t of a chunk, from its point on."""
        iterates, theta = velocities(chunk, t), chunk.theta[t]
        dw = self.start(at)
        for k in range(chunk.used[t]):
            at = at if k == 0 else at._replace(u=iterates[k - 1], later=True)
            contacts.turn_to(self.system.colliders, k)
            dw = self.solved(at, iterates[k], dw, chunk.first + t)
        self.dx += at.system.h * (self.dv if self.system.method == EXPLICIT else theta * dw)
        np.multiply(theta, dw, out=self.dv)
        self.loads, self.new_loads = self.new_loads, self.loads

    def solved(self, at: Point, w: Array, du: Array, step: int) -> Array:
        """The change of the velocity w of an iteration, for that of the one before, du (3 f, Q)."""
        right, before = self.right(at, w, du), du if at.later else np.zeros_like(du)
        dw = self.step_of(at, right, before, step)
        if len(self.loads):
            change_loads(self.by, self.place, self.dy if at.later else self.dx, dw, self.new_loads)
            for column, direction in self.everywhere:
                given = at.system, at.x, at.v, w, at.u, at.later, self.scratch, direction, column
                change_loads_globally(at.system.colliders, *given, self.new_loads)
        return dw + before

    def step_of(self, at: Point, right: Array, before: Array, step: int) -> Array:
        """The solution of an iteration: the change of its velocity less that of the one `before`."""
        if self.free.all():
            return self.solve(at.work.A, right)
        dw = -before
        dw[~self.free] += self.pins.velocity(step, at.system, self.dx[~self.free])
        if at.system.method == IMPLICIT:
            self.pins.couple(at.system, at.work.y, dw, right)
        dw[self.free] = self.solve(at.work.A, right[self.free])
        if at.system.method == EXPLICIT:
            dw[~self.free] = self.pins.sent(step, at.system, before.shape[1])
        return dw

    def start(self, at: Point) -> Array:
        """Make dx and dv those of the point, and return that of the velocity which the first iteration starts from."""
        if not at.later:
            if self.system.method == BDF2:
                self.dx_before[:], self.dv_before[:] = self.dx, self.dv
            return self.dv
        du = 2.0 * self.dv - self.dv_before
        for d, before in (self.dx, self.dx_before), (self.dv, self.dv_before):
            old = d.copy()
            d += (d - before) / 3.0
            before[:] = old
        return du

    def right(self, at: Point, w: Array, du: Array) -> Array:
        """The right-hand side of an iteration to w, in a later one for dw − du; its matrix is left in the workspace."""
        system, near, place, by = at.system, self.near, self.place, self.by
        bare = self.contact_columns.bare(system) if self.contact_columns else system
        differentiate(bare, at.x, at.v, w, at.u, at.later, at.work, by)
        dy = np.add(self.dx, system.h * du, out=self.dy) if at.later else self.dx
        right = self.mass * (self.dv - du if at.later else self.dv)
        add_product(near, place, by.by_y, dy, right)
        if np.any(by.by_u):
            add_product(near, place, by.by_u, du, right)
        if self.contact_columns:
            to = w if system.method == IMPLICIT else at.v
            self.contact_columns.add(system, at.work, (at.u, to, at.later), dy, du, right)
        if len(self.loads):
            add_loads(by, place, self.loads, right)
        add_columns(place, self.vertices, by.by_mass[:, None], self.columns.mass, right)
        add_columns(place, system.springs.ends, by.by_stiffness, self.columns.stiffness, right)
        add_columns(place, system.springs.ends, by.by_rest, self.columns.rest, right)
        for column, direction in self.everywhere:
            given = self.scratch, direction, place, column, right
            differentiate_globally(system, at.x, at.v, w, at.u, at.later, *given)
        return right


def is_dense(system: System) -> bool:
    """Whether a step's columns can go together: not where pins whose paths are fitted touch a cloth that meets itself.
    """
    return not meets_itself(system) or np.array_equal(mobile(system), system.vertex.free)


def at_start(system: System, columns: Columns) -> Array:
    """dX (3 f, Q) before the first step: 0 but for pins."""
    moved = mobile(system)
    dx = np.zeros((3 * int(moved.sum()), columns.width))
    place = np.where(moved, np.cumsum(moved) - 1, -1).astype(np.int32)
    Pins(system, columns.led, place).start(dx, np.zeros_like(dx))
    return dx


def tangents(
    system: System, memory: TrajectoryMemory, columns: Columns, tolerance: float, observe: Observer | None = None
) -> Iterator[Array]:
    """The same as `sweep` by one forward sweep per column, which is faster for a few columns."""
    free = mobile(system)
    sweeps = [adjoint.Sweep(system, along(system, columns, q), tolerance) for q in range(columns.width)]
    for chunk in (chunk for segment in memory.forward() for chunk in segment.parts()):
        if observe:
            observe(chunk)
        changes = [each.through(chunk) for each in sweeps]
        for t in range(chunk.steps):
            each = [change[t][free].reshape(-1) for change in changes]
            yield np.stack(each, axis=1) if each else np.zeros((3 * int(free.sum()), 0))


def sensitivities(
    system: System, memory: TrajectoryMemory, columns: Columns, tolerance: float, observe: Observer | None = None
) -> Iterator[Array]:
    """The same by the faster one of both, or the only way."""
    unknowns = max(3.0 * float(system.vertex.free.sum()), 1.0)
    if columns.width <= CALLS / unknowns + FACTOR * unknowns or not is_dense(system):
        return tangents(system, memory, columns, tolerance, observe)
    return sweep(system, memory, columns, observe)


def along(system: System, columns: Columns, q: int) -> Elements:
    """The change of all elements along column q."""
    change = Elements(columns.mass.along(q), columns.stiffness.along(q), rest=columns.rest.along(q))
    for column, direction in (*columns.everywhere, *columns.led):
        if column == q:
            change = direction
    for column, start in columns.velocity:
        if column == q:
            change = change._replace(velocity=start)
    return change


class Solver:
    """Solves A dW = B on the free vertices, best for A of one pattern again and again."""

    def __init__(self) -> None:
        self.envelope: Envelope | None = None
        self.column: Indices | None = None  # of that pattern

    def __call__(self, A: sparse.BlockMatrix, right: Array) -> Array:
        """dW for B = `right` (3 f, Q), which stays as it is."""
        if not len(right):  # nothing is free
            return right.copy()
        numbers = np.concatenate([A.diagonal, A.upper]).reshape(-1)
        if self.envelope is None or self.column is not A.column:
            matrix = sparse.places(A)
            self.envelope, self.column = envelope(matrix, matrix.data), A.column
        L = factorise(self.envelope, numbers)
        return solve_whole(sparse.to_scipy(*A), right) if L is None else solve(self.envelope, L, right)


def solve_whole(matrix: csc_array, right: Array) -> Array:
    """The solution for B = `right` (3 f, Q) and any matrix. Raises LinAlgError."""
    from scipy.sparse.linalg import splu

    try:
        return np.asarray(splu(matrix).solve(right))
    except RuntimeError as error:
        raise np.linalg.LinAlgError(str(error)) from None


@kernel(nogil=True)
def add_product(near, place, blocks, x, out):
    """out += B x for the block matrix B on the stencil, x and out (3 f, Q) with row 3 place[i] + c for vertex i."""
    for i in range(len(place)):
        r, whole = 3 * place[i], out.shape[1] - out.shape[1] % 4
        if r < 0:
            continue
        for q in range(0, whole, 4):
            s0, s1, s2 = load(out, r, q), load(out, r + 1, q), load(out, r + 2, q)
            for e in range(near.start[i], near.start[i + 1]):
                a, j = blocks[e], 3 * place[near.neighbour[e]]
                if j >= 0:
                    x0, x1, x2 = load(x, j, q), load(x, j + 1, q), load(x, j + 2, q)
                    s0 = add(s0, fma(splat(a[0, 0]), x0, fma(splat(a[0, 1]), x1, mul(splat(a[0, 2]), x2))))
                    s1 = add(s1, fma(splat(a[1, 0]), x0, fma(splat(a[1, 1]), x1, mul(splat(a[1, 2]), x2))))
                    s2 = add(s2, fma(splat(a[2, 0]), x0, fma(splat(a[2, 1]), x1, mul(splat(a[2, 2]), x2))))
            for c, total in enumerate((s0, s1, s2)):
                store(total, out, r + c, q)
        for e in range(near.start[i], near.start[i + 1]):
            a, j = blocks[e], 3 * place[near.neighbour[e]]
            for q in range(whole if j >= 0 else out.shape[1], out.shape[1]):
                for c in range(3):
                    out[r + c, q] += a[c, 0] * x[j, q] + a[c, 1] * x[j + 1, q] + a[c, 2] * x[j + 2, q]


@kernel(nogil=True)
def add_columns(place, vertices, by_element, share, out):
    """out += C for a kind that acts on the k `vertices` (N, k) of each of its elements, `by_element` (N, k, 3)."""
    for i in range(len(share.start) - 1):
        for e in range(share.start[i], share.start[i + 1]):
            q = share.column[e]
            for k in range(vertices.shape[1] if q >= 0 else 0):
                r = 3 * place[vertices[i, k]]
                for c in range(3 if r >= 0 else 0):
                    out[r + c, q] += share.factor[e] * by_element[i, k, c]


@kernel
def add_coupling(links, coupled, free, place, h, y, dw, right):
    """right −= A_fp dw_p for all springs of which one end is free and the other a pin that moves."""
    one, pull = np.zeros((1, 3)), np.zeros((3, 3))
    for c in range(len(coupled)):
        i = coupled[c]
        for end in range(2):
            pin, other = links.ends[i, end], links.ends[i, 1 - end]
            if free[pin] or place[pin] < 0:
                continue
            for b in range(3):
                one[:] = 0.0
                one[0, b] = 1.0
                store3(springs.pull_of(links, y, i, h, load3(one, 0)), pull, b)
            for a in range(3):
                for b in range(3):
                    for q in range(right.shape[1]):
                        right[3 * place[other] + a, q] += pull[b, a] * dw[3 * place[pin] + b, q]
