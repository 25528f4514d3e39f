"""All steps of a reduced motion in one compiled loop: what plays a subspace.

`samples` says what the steps are. The sums over points have single precision (`dense`), and nothing else has. An
iteration solves for what is to be added to a guess of the velocity, extrapolated from the last two: that is small, and
so is what rounding does to it. Where a matrix is not positive definite, the iteration is taken with that of the clamped
springs.

Conjugate gradients with the factor of an earlier step were tried instead of a new factor in every step: in gusts they
need three to four products with the matrix, which take as long.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from clothfit.base import interrupts
from clothfit.base.arrays import Array, Flags
from clothfit.base.limits import FARTHEST
from clothfit.engine.forces import contact
from clothfit.engine.solve.sparse import XX, XY, XZ, YY, YZ, ZZ
from clothfit.engine.step import bdf2
from clothfit.kernels.kernel import kernel
from clothfit.kernels.vectors import add, combine, copy_row
from clothfit.subspace import translation
from clothfit.subspace.physics import samples
from clothfit.subspace.physics.dense import PANEL, ROOM, add_matrix, add_vectors, factorise, products, solve
from clothfit.subspace.physics.samples import Reduced

TOGETHER = 200
"""Steps between two looks for interrupts."""

FREE, SAFE, CLAMPED = 0, 1, 2
"""How the springs of an iteration push sideways: as they do, at most as much as they pull, and the same without a
bend (`engine.forces.springs`).
"""


class Work(NamedTuple):
    """Memory that every step uses; m points, c copies, w columns in single precision, r in double."""

    left: NDArray[np.float32]  # (ROOM, w)
    right: NDArray[np.float32]  # (ROOM, w)
    C: NDArray[np.float32]  # (w, w)
    g: NDArray[np.float32]  # (1, w)
    x: NDArray[np.float32]  # (3, w): coordinates, velocities, and a guess of those after the step
    points: NDArray[np.float32]  # (3, 3 m), the same of the points
    at: Array  # (3, m, 3), y, u and w of the points
    block: Array  # (m, 6)
    p: Array  # (m, 3)
    y: Array  # (c, 3)
    u: Array  # (c, 3)
    A: samples.Blocks
    b: Array  # (c, 3)
    w: Array  # (c, 3), velocities after the step
    begin: Array  # (c, 3), places where it begins
    end: Array  # (c, 3), and where it ends
    free: Flags  # of the vertices that may touch something, all True
    columns: Array  # (PANEL, r)
    base: Array  # (2, r), q̃ and p̃ or q and p
    now: Array  # (r,), the velocity that is sought
    pins: Array  # (5, P + 1, 3): y, u, w, and x, v where the step begins
    matrix: Array  # (r, r)
    rest: Array  # (r,)


class State(NamedTuple):
    """Where a motion is."""

    q: Array  # (2, r), the coordinates, and those one step before
    p: Array  # (2, r), the velocities, 1/s
    load: Array  # (R,), N, what pressed vertices at colliders in the step before, −1 at the start (`forces.contact`)


@kernel
def march(forces, lay, fixed, work, state, t, out):
    """Take len(out) steps of a State from step t on. Writes the coordinates to out (steps, r); returns how many steps
    there were before they went too far.
    """
    for i in range(len(out)):
        take_step(forces, lay, fixed, work, state, t + i)
        for c in range(out.shape[1]):
            if not abs(state.q[0, c]) < FARTHEST:
                return i
            out[i, c] = state.q[0, c]
    return len(out)


@kernel
def take_step(forces, lay, fixed, work, state, t):
    """One step."""
    samples.begin(forces[FREE], t)
    contact.set_load(forces[FREE].colliders, state.load)
    second = fixed.second and t > 0
    h = 2.0 / 3.0 * fixed.h if second else fixed.h
    samples.place_pins(fixed, work.pins, t, second, h)
    base, w, r, q, p = work.base, work.now, len(work.now), state.q, state.p
    part = 1.0 / 3.0 if second else 0.0
    for c in range(r):
        base[0, c] = q[0, c] + part * (q[0, c] - q[1, c])
        base[1, c] = p[0, c] + part * (p[0, c] - p[1, c])
        w[c] = 2.0 * p[0, c] - p[1, c]
    for k in range(fixed.iterations):
        ahead = second or k > 0
        for c in range(r):
            u = w[c] if ahead else p[0, c]
            work.x[0, c] = base[0, c] + h * u if ahead else base[0, c]
            work.x[1, c], work.x[2, c] = u, w[c]
        move_pins(work.pins, h, ahead, k > 0)
        kind = SAFE if second and fixed.iterations == 1 else FREE
        linearise(forces[kind], lay, fixed, work, h, ahead)
        contact.turn_to(forces[kind].colliders, k)
        solved = solve_rest(fixed, work, h)
        if not solved:
            kind = CLAMPED
            linearise(forces[kind], lay, fixed, work, h, ahead)
            solved = solve_rest(fixed, work, h)
        solved = solved and solve_again(forces[kind], lay, fixed, work, h, ahead)
        if not solved:
            w[:] = np.nan
    press(forces[FREE].colliders, lay, fixed, work, h, second or fixed.iterations > 1, state.load)
    for c in range(r):
        q[1, c], p[1, c] = q[0, c], p[0, c]
        q[0, c], p[0, c] = base[0, c] + h * w[c], w[c]


@kernel
def move_pins(pins, h, ahead, again):
    """Where an iteration is linearised: with the velocity of the step where there was one before it (`again`)."""
    for p in range(pins.shape[1]):
        for c in range(3):
            if again:
                pins[1, p, c] = pins[2, p, c]
            pins[0, p, c] = pins[3, p, c] + h * pins[1, p, c] if ahead else pins[3, p, c]


@kernel
def linearise(own, lay, fixed, work, h, ahead):
    """The blocks of the points, and what the guess w of the velocity leaves of the equation, b − A w."""
    place_copies(lay, fixed, work)
    samples.assemble(own, lay, work.y, work.u, h, ahead, work.A, work.b)
    leave(own, lay, fixed, work, h)


@kernel
def leave(own, lay, fixed, work, h):
    """What the guess leaves of the equation with these blocks."""
    at_points(lay, work)
    base, w, grown, rest = work.base[1], work.now, 1.0 + h * fixed.alpha, work.rest
    rest[:] = 0.0
    for i in range(len(rest)):
        momentum = base[i] - grown * w[i]
        for j in range(len(rest)):
            rest[j] += momentum * fixed.mass[i, j]  # which is symmetric
        for c in range(3):
            moved = work.pins[4, -1, c] - grown * work.pins[2, -1, c] if len(fixed.path) else 0.0
            rest[i] += fixed.weight[i, c] * (h * own.vertex.gravity[c] + moved)
    add_vectors(fixed.rows, work.p, work.g, rest)


@kernel
def solve_again(own, lay, fixed, work, h, ahead):
    """Solve again with the contacts that a solution ends in, as `engine.step.implicit.solve_again` but for its line
    search; whether all were found.
    """
    for turn in range(contact.ACTIVE_SET_ROUNDS):
        drops = turn < contact.DROPS
        if meet(own.colliders, lay, fixed, work, h, ahead, drops) == 0:
            return True
        leave(own, lay, fixed, work, h)
        if not solve_rest(fixed, work, h):
            return False
    return True


@kernel
def place_ends(lay, fixed, work, h, ahead):
    """Where the points begin, and the velocity with which the guess moves them."""
    reach = h if ahead else 0.0
    for c in range(len(work.now)):
        work.x[2, c] = work.now[c]
    place_copies(lay, fixed, work)
    samples.spread(lay, work.at[2], work.w)
    for i in range(lay.ends[1], len(work.y)):
        for c in range(3):
            work.begin[i, c] = work.y[i, c] - reach * work.u[i, c]


@kernel(absent=None)
def press(colliders, lay, fixed, work, h, ahead, load):
    """Note what presses vertices at the end of a step."""
    place_ends(lay, fixed, work, h, ahead)
    f = lay.ends[1]
    combine(1.0, work.begin, h, work.w, work.end)
    add(-1.0, work.y, work.end)
    contact.press(colliders, work.y[f:], work.u[f:], work.w[f:], work.end[f:], h)
    copy_row(colliders.load[1], load)


@kernel(empty=0, apart=0)
def meet(colliders, lay, fixed, work, h, ahead, drops):
    """Add the contacts that the guess ends in to the blocks; returns how many there are (`contact.update_active`)."""
    place_ends(lay, fixed, work, h, ahead)
    f = lay.ends[1]
    at = work.begin[f:], work.y[f:], work.u[f:], work.w[f:]
    blocks = samples.Blocks(work.A.diagonal[f:], work.A.upper)
    return contact.update_active(colliders, work.free, at, h, work.end[f:], drops, blocks, work.b[f:])


@kernel
def solve_rest(fixed, work, h):
    """Add what is left to the guess; whether the matrix is positive definite."""
    A, grown = work.matrix, 1.0 + h * fixed.alpha
    for i in range(len(A)):
        for j in range(i + 1):
            A[i, j] = grown * fixed.mass[i, j]
    add_matrix(fixed.rows, work.block, work, A)
    if not factorise(A, work.columns):
        return False
    solve(A, work.rest)
    for i in range(len(A)):
        work.now[i] += work.rest[i]
    return True


@kernel
def place_copies(lay, fixed, work):
    """The places and velocities of the copies, and the guess of the velocities of the points after the step."""
    products(fixed.rows, work.x, work.points)
    at, points = work.at, work.points
    for j in range(len(lay.constant)):
        for c in range(3):
            at[0, j, c] = points[0, 3 * j + c] + lay.constant[j, c]
            at[1, j, c] = points[1, 3 * j + c]
            at[2, j, c] = points[2, 3 * j + c]
    for e in range(len(lay.pinned)):
        j, p = lay.pinned[e, 0], lay.pinned[e, 1]
        for c in range(3):
            at[0, j, c] += lay.sign[e] * (work.pins[0, p, c] - fixed.held[p, c])
            at[1, j, c] += lay.sign[e] * work.pins[1, p, c]
            at[2, j, c] += lay.sign[e] * work.pins[2, p, c]
    samples.spread(lay, at[0], work.y)
    samples.spread(lay, at[1], work.u)


@kernel
def at_points(lay, work):
    """Sum the weighted blocks, and b − B w, of all copies of each point."""
    block, p, b, D, w = work.block, work.p, work.b, work.A.diagonal, work.at[2]
    block[:] = 0.0
    p[:] = 0.0
    for i in range(1, len(lay.point)):
        j, weight = lay.point[i], lay.weight[i]
        for c in range(3):
            p[j, c] += weight * b[i, c]
        block[j, 0] += weight * D[i, XX]
        block[j, 1] += weight * D[i, XY]
        block[j, 2] += weight * D[i, XZ]
        block[j, 3] += weight * D[i, YY]
        block[j, 4] += weight * D[i, YZ]
        block[j, 5] += weight * D[i, ZZ]
    for j in range(len(p)):
        p[j, 0] -= block[j, 0] * w[j, 0] + block[j, 1] * w[j, 1] + block[j, 2] * w[j, 2]
        p[j, 1] -= block[j, 1] * w[j, 0] + block[j, 3] * w[j, 1] + block[j, 4] * w[j, 2]
        p[j, 2] -= block[j, 2] * w[j, 0] + block[j, 4] * w[j, 1] + block[j, 5] * w[j, 2]


class March:
    """A motion on the way: its state, and the memory of its steps."""

    def __init__(self, own: Reduced, beside: March | None = None) -> None:
        """At the start; with another motion of the same cloth in the same memory where there is one `beside`."""
        self.layout, self.fixed = own.layout, own.fixed
        self.forces = tuple(
            own.own._replace(springs=own.own.springs._replace(cap=cap, bend=bend))
            for cap, bend in ((np.inf, 0.0), (1.0, bdf2.BEND), (1.0, 0.0))
        )
        self.work: Work = workspace(own) if beside is None else beside.work
        start = translation.start_velocity(own.system, own.basis)
        self.t = 0
        count = 0 if own.own.colliders is None else len(own.own.colliders.depth)
        self.state = State(np.zeros((2, own.r)), np.stack([start] * 2), np.full(count, -1.0))

    def take(self, out: Array) -> int:
        """Take a step for each row of out (steps, r), coordinates; returns how many there were until they went too
        far.
        """
        made = int(march(self.forces, self.layout, self.fixed, self.work, self.state, self.t, out))
        self.t += made
        return made


def workspace(own: Reduced) -> Work:
    """Memory for the steps of a reduced cloth."""
    copies, m, r, width = len(own.layout.point), len(own.layout.constant), own.r, own.fixed.rows.shape[1]

    def single(*shape: int) -> Any:
        return np.zeros(shape, np.float32)

    y, u, b, w, begin, end = (np.zeros((copies, 3)) for _ in range(6))
    free = np.ones(copies - int(own.layout.ends[1]), bool)
    return Work(
        single(ROOM, width), single(ROOM, width), single(width, width), single(1, width), single(3, width),
        single(3, 3 * m), np.zeros((3, m, 3)), np.zeros((m, 6)), np.zeros((m, 3)), y, u, samples.blocks(own.layout),
        b, w, begin, end, free, np.zeros((PANEL, r)), np.zeros((2, r)), np.zeros(r),
        np.zeros((5, len(own.fixed.held), 3)), np.zeros((r, r)), np.zeros(r),
    )  # fmt: skip


def roll(own: Reduced, steps: int) -> Array:
    """The coordinates (steps + 1, r) of a motion from the start; NaN from where they went too far."""
    out = np.full((steps + 1, own.r), np.nan)
    motion = March(own)
    out[0] = motion.state.q[0]
    for first in range(1, steps + 1, TOGETHER):
        part = out[first : first + TOGETHER]
        made = motion.take(part)
        if made < len(part):
            break
        interrupts.check()
    return out
