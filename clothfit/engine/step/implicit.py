"""The implicit (backward Euler) step: one linearised solve, or several Newton iterations.

Each iteration linearises the forces at a point (y, u) and solves r = 0 for the new velocity w of the free vertices:

    r = M (w − v) − h F(w),   F(w) = f(y, u) + K s + D (w − u),   s = x + h w − y,   x⁺ = x + h w
      ⇔  A w = M v + h [f(y, u) + K (x − y) − D u],   A = M − h D − h² K at (y, u)

Strongly compressed springs make A indefinite. Where a solve shows that, the whole step is taken with a matrix that is
positive definite, that of the `clamped` system: functions here are given the system that the step was taken with.

The first iteration linearises at (x, v): the linearised step. The others linearise at (x + h u, u) with u the velocity
of the iteration before: Newton's method on M (v⁺ − v) = h f(x + h v⁺, v⁺). The derivatives go through every
iteration that was taken, so they are exact for two iterations as for twenty, converged or not.

Transpose, with w̄ = v̄⁺ + h x̄⁺: solve A λ = w̄; then x̄, v̄ and the parameters receive the derivative of −λᵀ r.
The term λᵀ (∂A/∂y) w that this contains never forms a tensor: per force element it is the derivative of a scalar.
Arrays are (n, 3); fixed vertices have λ 0, and velocity 0 unless they are pins (`inputs.tables`).
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from clothfit.base.arrays import Array
from clothfit.engine.forces import collider_rows, contact, total
from clothfit.engine.forces.selfcontact import rows
from clothfit.engine.inputs.tables import couple, move_pins, pull_pins, pull_through, push_pins, set_pins
from clothfit.engine.solve import guess, linear, sparse
from clothfit.engine.step import guard
from clothfit.engine.system import System
from clothfit.kernels.kernel import kernel, record
from clothfit.kernels.lanes.operations import add as add_lanes
from clothfit.kernels.lanes.operations import fma, load3, mul, splat, store3, sum3
from clothfit.kernels.vectors import add, add_mass, add_rows_dot, combine, copy, dot, hold_fixed, vector

ROUGH = 3e-4
"""Tolerance of the first solutions of a step that touches something, which only find its contacts."""


CAREFUL = 3
"""Rounds after which solutions are looked at before they are taken: mostly there are no more."""

SOLVED, ENOUGH, INDEFINITE = 0, 1, 2
"""How an iteration ended."""


@record
class Workspace(NamedTuple):
    """Memory that a run of steps uses again and again; (n, 3) where nothing else is said."""

    A: sparse.BlockMatrix
    solver: linear.Workspace
    past: guess.Past  # solutions of the last steps
    nothing: Array  # (0, 3)
    b: Array  # right-hand side
    w_bar: Array  # gradient by the velocity of an iteration
    y: Array  # point of linearisation
    s: Array  # x + h w − y
    solution: Array  # of the derivative's system (λ or dw), holding its first guess before
    gy: Array  # derivative by y
    gu: Array  # derivative by u
    x_base: Array  # of BDF2, as all below: x̃
    v_base: Array  # ṽ
    u: Array  # the extrapolated velocity


def workspace(system: System) -> Workspace:
    """Memory for the steps of `system` and their derivatives."""
    n = len(system.x0)
    vectors = [np.zeros((n, 3)) for _ in range(10)]
    A = sparse.zeros(system.pattern, n)
    return Workspace(A, linear.workspace(A), guess.past(n), np.zeros((0, 3)), *vectors)


@kernel
def assemble(system, y, u, ahead, A, b):
    """A at (y, u), and b = h (f − D u) there, empty where it is not needed; returns the stored energy unless it is.

    With `ahead` the step begins h u before y: b = h (f − D u − h K u).
    """
    sparse.reset(A, system.vertex.mass)
    b[:] = 0.0
    return total.add_step(system, y, u, system.h, ahead, A, b)


@kernel
def assemble_newton(system, x, v, u, y, A, f, b):
    """Write y = x + h u, A at (y, u) and b = M (v − u) + h f(y, u) + A u, so that b − A u is Newton's residual."""
    h = system.h
    combine(1.0, x, h, u, y)
    collider_rows.begin(system.colliders, 0.0)
    assemble(system, y, u, True, A, b)
    sparse.multiply(A, u, b)
    add_mass(system.vertex.mass, 1.0, v, b)
    add_mass(system.vertex.mass, -1.0, u, b)
    f[:] = 0.0
    total.add_force(system, y, u, f)
    add(h, f, b)


@kernel
def prepare(system, x, v, work):
    """The system of the first iteration, in the workspace; returns the kinetic and stored energy of the state, J, and
    the power of the weight, W (see `guard`): they come with it, almost free, where no collider moves.
    """
    collider_rows.begin(system.colliders, system.h)
    keep_point(system.colliders, x, v, work.y, work.u)
    stored = assemble(system, x, v, False, work.A, work.b)
    kinetic, power = add_momentum(system.vertex, v, work.b)
    couple(system.inputs, system, x, x, work.s, work.A, work.b)
    return kinetic + stored, power


@kernel(absent=None)
def keep_point(colliders, x, v, y, u):
    """y, u = x, v, which are asked for again where contacts may be met."""
    copy(x, y)
    copy(v, u)


@kernel
def add_momentum(vertex, v, b):
    """b += M v, and 0 at fixed vertices; returns what `guard.moving` does."""
    twice, momentum = splat(0.0), splat(0.0)
    for i in range(len(vertex.mass)):
        v_i = load3(v, i)
        p_i = mul(splat(vertex.mass[i]), v_i)
        momentum = add_lanes(momentum, p_i)
        twice = fma(p_i, v_i, twice)
        store3(add_lanes(load3(b, i), p_i) if vertex.free[i] else splat(0.0), b, i)
    return 0.5 * sum3(twice), dot(vector(vertex.gravity), momentum)


@kernel
def step(system, x, v, first, tolerance, work, iterates):
    """Fill iterates (N, n, 3) with the velocities of the iterations, from a first guess; the last one used is the new
    velocity. The first system is prepared.

    Returns the number used, the CG iterations and the direct solves. Stops early when the residual of the next
    iteration is already within `tolerance` of its right-hand side, and with 0 used where A is seen not to be positive
    definite: then the step is to be taken with the clamped system.
    """
    iterations, direct = 0, 0
    for k in range(len(iterates)):
        ended, more, more_direct = iterate(system, x, v, k, first, tolerance, work, iterates)
        iterations += more
        direct += more_direct
        if ended != SOLVED:
            return k if ended == ENOUGH else 0, iterations, direct
        left, at = system.newton_iterations - k - 1, (x, work.y, work.u if k == 0 else iterates[k - 1], iterates[k])
        if k + 1 == len(iterates) or left < 0:
            break
        if left == 0 and not ends_badly(system.colliders, system, at, work.gy):
            break
        carry(system.colliders, system, at, work.gy)
    return k + 1, iterations, direct


@kernel
def iterate(system, x, v, k, first, tolerance, work, iterates):
    """Write iteration k of a step; returns how it ended: SOLVED, ENOUGH, where the last one is within the tolerance, or
    INDEFINITE; and the CG iterations and the direct solves.
    """
    free = system.vertex.free
    A, b = work.A, work.b
    anyhow = system.springs.cap <= 1.0 or not system.guarded  # the first: positive definite but for rounding
    contact.turn_to(system.colliders, k)
    if k == 0:
        copy(first, iterates[0])
    else:
        assemble_newton(system, x, v, iterates[k - 1], work.y, A, work.gy, b)
        hold_fixed(free, b)
        copy(iterates[k - 1], iterates[k])
    in_contact = contact.is_deep(system.contact) or contact.is_deep(system.colliders)
    rough = max(tolerance, ROUGH) if in_contact else tolerance
    iterations, direct, solved = linear.solve(A, b, rough, work.solver, iterates[k], anyhow)
    if k > 0 and iterations == 0 and direct == 0 and rough > tolerance:
        rough = tolerance
        iterations, direct, solved = linear.solve(A, b, rough, work.solver, iterates[k], anyhow)
    set_pins(system.inputs, system, x, iterates[k])
    if not solved:
        return INDEFINITE, iterations, direct
    if k > 0 and iterations == 0 and direct == 0:
        return ENOUGH, iterations, direct
    at = x, work.y, work.u if k == 0 else iterates[k - 1], iterates[k]
    more, more_direct, solved = solve_again(system.colliders, system, at, rough, tolerance, work, anyhow)
    press(system.colliders, system, at, work.s)
    return SOLVED if solved else INDEFINITE, iterations + more, direct + more_direct


@kernel(absent=None)
def press(colliders, system, at, s):
    """Note what presses vertices at the end of an iteration; `at` is as for `contact.update_active`."""
    x, y, u, w = at
    combine(1.0, x, system.h, w, s)
    add(-1.0, y, s)
    contact.press(colliders, y, u, w, s, system.h)


@kernel
def iterate_on(system, x, v, k, tolerance, work, iterates):
    """Write iteration k, after one that was thought to be the last; returns what `iterate` does."""
    contact.turn_to(system.colliders, k - 1)
    u = v if k == 1 else iterates[k - 2]
    offset(system, x, iterates[k - 1], u, k > 1, work.y, work.s)
    carry(system.colliders, system, (x, work.y, u, iterates[k - 1]), work.gy)
    return iterate(system, x, v, k, v, tolerance, work, iterates)


@kernel(absent=None)
def carry(colliders, system, at, end):
    """Let the next iteration begin with the contacts that press in this one; see `contact.carry`."""
    contact.carry(colliders, system.vertex.free, at, system.h, end)
    contact.carry(system.contact, system.vertex.free, at, system.h, end)


@kernel(absent=False)
def ends_badly(colliders, system, at, end):
    """Whether an iteration ends with a vertex too deep in a collider, pairs that pass through each other, or contacts
    that store more than its model knows, in a scene where surfaces may turn away; writes `end` (n, 3).
    """
    if not contact.turns_inward(colliders):
        return False
    combine(1.0, at[0], system.h, at[3], end)
    if rows.passing(system.contact, at[0], end):
        return True
    more = contact.surplus(system.colliders, system.vertex.free, at, system.h, end)
    more += contact.surplus(system.contact, system.vertex.free, at, system.h, end)
    return more > contact.SURPLUS * guard.moving(system.vertex, at[3])[0]


@kernel(absent=(0, 0, True))
def solve_again(colliders, system, at, solved_to, tolerance, work, anyhow):
    """Solve an iteration again until it meets no other contacts, of colliders or of pairs, first as roughly as it is
    `solved_to`; `at` is as for `contact.update_active`, of which the velocity changes. Returns what `linear.solve`
    does.

    A pair that is taken out takes its friction along, so what is minimised is not quite convex, and rounds may go in a
    circle: where a rise at the end of a solution is not half of the least one before, no more contacts are taken out.
    """
    iterations, direct, turn, rise, least = 0, 0, 0, 0.0, np.inf
    while turn < contact.ACTIVE_SET_ROUNDS:
        if meet(system, at, turn < contact.DROPS, work) == 0 and rise == 0.0:
            if solved_to <= tolerance:
                break
            turn, solved_to, least = -1, tolerance, np.inf
        elif turn == contact.ACTIVE_SET_ROUNDS - 1 and solved_to > tolerance:
            turn, solved_to, least = -1, tolerance, np.inf
        turn += 1
        copy(at[3], work.s)
        more, more_direct, solved = linear.solve(work.A, work.b, solved_to, work.solver, at[3], anyhow)
        iterations += more
        direct += more_direct
        set_pins(system.inputs, system, at[0], at[3])
        if not solved:
            return iterations, direct, False
        rise = back_off(system, at, work) if CAREFUL <= turn < contact.DROPS else 0.0
        if rise > 0.0:
            turn, least = contact.DROPS if 2.0 * rise > least else turn, min(rise, least)
    return iterations, direct, True


@kernel
def back_off(system, at, work):
    """Go back towards work.s, the velocities before a solution, where the energy that an iteration minimises rises at
    last on the way from there, to about where it is least; returns the slope there, J, or 0 where it did not. That
    energy is convex, so with this the rounds end (a line search of Newton's method).
    """
    free, h, w = system.vertex.free, system.h, at[3]
    rise = contact.slope_error(system.colliders, free, at, work.s, h, work.gy)
    rise += contact.slope_error(system.contact, free, at, work.s, h, work.gy)
    if rise <= 0.0:
        return 0.0
    combine(1.0, w, -1.0, work.s, work.gu)
    hold_fixed(free, work.gu)
    sparse.multiply(work.A, work.gu, work.gy)
    fall = 0.0
    for i in range(len(w)):
        fall += dot(load3(work.gu, i), load3(work.gy, i))
    if fall <= 0.0:  # a matrix that is not definite
        return 0.0
    share = fall / (fall + rise)
    combine(share, w, 1.0 - share, work.s, w)
    return rise


@kernel
def meet(system, at, drops, work):
    """Add the contacts that an iteration ends in to its system, and take others out; see `contact.update_active`."""
    free, h = system.vertex.free, system.h
    changed = contact.update_active(system.colliders, free, at, h, work.gy, drops, work.A, work.b)
    return changed + contact.update_active(system.contact, free, at, h, work.gy, drops, work.A, work.b)


@kernel
def pullback(system, x, v, iterates, used, theta, tolerance, work, x_bar, v_bar, grad):
    """Turn x_bar, v_bar (n, 3), the gradient by the state after the step, into that before it; add to `grad`.

    `theta` is the part of the step that was taken (`guard`), here and in `pushforward`.

    work.solution holds a first guess of λ and receives λ of the first iteration.
    """
    combine(theta, v_bar, theta * system.h, x_bar, work.w_bar)
    v_bar[:] = 0.0
    contact.hand(system.colliders, True)
    for k in range(used - 1, -1, -1):
        u = v if k == 0 else iterates[k - 1]
        contact.turn_to(system.colliders, k)
        pull_iteration(system, x, v, iterates[k], u, k > 0, tolerance, work, x_bar, v_bar, grad)
        if k == 0:
            add(1.0, work.gu, v_bar)


@kernel
def pull_iteration(system, x, v, w, u, later, tolerance, work, x_bar, v_bar, grad):
    """Carry work.w_bar, the gradient by w, back through the iteration from u to w: add to x_bar, v_bar and `grad`.

    The first iteration leaves the gradient by u in work.gu, a `later` one all of it, by y = x + h u too, in work.w_bar.
    """
    h, mass, free = system.h, system.vertex.mass, system.vertex.free
    A, b, y, s, lam, gy, gu = work.A, work.b, work.y, work.s, work.solution, work.gy, work.gu
    w_bar = work.w_bar
    linearise(system, x, w, u, later, A, work.nothing, y, s)
    contact.add_press(system.colliders, y, u, w, s, h, 1.0, w_bar)
    copy(w_bar, b)
    hold_fixed(free, b)
    linear.solve(A, b, tolerance, work.solver, lam, True)
    gy[:] = 0.0
    gu[:] = 0.0
    total.add_pullback(system, y, u, w, s, lam, h, grad, gy, gu)
    add_rows_dot(-1.0, lam, w, grad.mass)
    add_rows_dot(1.0, lam, v, grad.mass)
    add_mass(mass, 1.0, lam, v_bar)
    add(1.0, gy, x_bar)
    pull_pins(system.inputs, system, y, lam, A, w_bar, x_bar, b)
    if later:
        # y = x + h u and s = h (w − u): ū = h (gy − h K λ) + gu, and −h² K λ = A λ − M λ + h D λ
        sparse.multiply(A, lam, w_bar)
        add_mass(mass, -1.0, lam, w_bar)
        total.add_damping(system, y, u, h, lam, w_bar)
        add(h, gy, w_bar)
        add(1.0, gu, w_bar)
        contact.add_press(system.colliders, y, u, w, s, h, -1.0, w_bar)
        pull_through(system.inputs, b, w_bar)
    contact.end_press(system.colliders)


@kernel
def linearise(system, x, w, u, later, A, b, y, s):
    """The point y, A and b (see `assemble`), and the offset s of an iteration from u to w, the first or a `later` one.
    """
    offset(system, x, w, u, later, y, s)
    assemble(system, y, u, later, A, b)


@kernel
def offset(system, x, w, u, later, y, s):
    """The point y alone, and s."""
    h = system.h
    collider_rows.begin(system.colliders, 0.0 if later else h)
    if later:
        combine(1.0, x, h, u, y)
        combine(h, w, -h, u, s)
    else:
        copy(x, y)
        combine(h, w, 0.0, w, s)


@kernel
def pushforward(system, x, v, iterates, used, theta, tolerance, work, dx, dv, direction):
    """Turn dx, dv (n, 3), the change of the state before the step, into that after it, for the change `direction`.

    work.solution holds a first guess of dw and receives dw of the last iteration.
    """
    contact.hand(system.colliders, False)
    for k in range(used):
        u = v if k == 0 else iterates[k - 1]
        copy(dv if k == 0 else work.solution, work.gu)
        contact.turn_to(system.colliders, k)
        push_iteration(system, x, v, iterates[k], u, k > 0, tolerance, work, dx, dv, direction)
    combine(theta, work.solution, 0.0, work.solution, dv)
    add(system.h, dv, dx)


@kernel
def push_iteration(system, x, v, w, u, later, tolerance, work, dx, dv, direction):
    """Write dw, the change of w in the iteration from u to w, to work.solution, a first guess of it before. The change
    of u is in work.gu.
    """
    h, mass, free = system.h, system.vertex.mass, system.vertex.free
    A, b, y, s, dw, dy, du = work.A, work.b, work.y, work.s, work.solution, work.gy, work.gu
    linearise(system, x, w, u, later, A, work.nothing, y, s)
    if later:
        # ds = −h du, and −h² K du = A du − M du + h D du
        combine(1.0, dx, h, du, dy)
        sparse.multiply(A, du, b)
        add_mass(mass, -1.0, du, b)
        total.add_damping(system, y, u, h, du, b)
    else:
        b[:] = 0.0
        copy(dx, dy)
    total.add_pushforward(system, y, u, w, s, dy, du, direction, h, b)
    add_mass(mass, 1.0, dv, b)
    add_mass(direction.mass, 1.0, v, b)
    add_mass(direction.mass, -1.0, w, b)
    push_pins(system.inputs, system, y, dx, du, later, s, A, b)
    hold_fixed(free, b)
    linear.solve(A, b, tolerance, work.solver, dw, True)
    move_pins(system.inputs, system, dx, dw)
    push_press(system.colliders, system, (x, w, u), later, y, s, dy, du, dw, direction, b)


@kernel(absent=None)
def push_press(colliders, system, at, later, y, s, dy, du, dw, direction, dq):
    """Set the changes of what presses vertices at the end of an iteration; s and dq (n, 3) are scratch."""
    x, w, u = at
    offset(system, x, w, u, later, y, s)  # pins have written to s
    combine(1.0, dw, -1.0 if later else 0.0, du, dq)
    contact.push_press(colliders, y, u, w, s, dy, dq, direction, system.h)
