"""The step of second order: BDF2 (the backward differentiation formula of two steps), linearised once where the motion
so far leads to.

    v⁺ = (4 v − v₋)/3 + h' M⁻¹ f(x⁺, v⁺),   x⁺ = (4 x − x₋)/3 + h' v⁺,   h' = 2h/3

with x₋, v₋ the state one step before x, v. With x̃ = (4 x − x₋)/3 and ṽ = (4 v − v₋)/3 for x and v, and h' for h, it is
the equation of the implicit step, and its solution one of Newton's iterations (`implicit`): from the extrapolated
velocity u = 2 v − v₋, at the point y = x̃ + h' u,

    r = M (w − ṽ) − h' F(w),   F(w) = f(y, u) + K s + D (w − u),   s = h' (w − u),   x⁺ = x̃ + h' w,   v⁺ = w

As u is wrong by O(h²) only, one iteration leaves the order as it is; linearised at (x, v) most of it is lost. As s is
of third order in h, K need not be exact either (a W-method): a single iteration takes that of the `clamped` system,
positive semi-definite, rounded where the clamp begins, so that the motion is differentiable. The extrapolated state
overshoots where a cloth shakes, and compresses springs that hardly are; with their push sideways in K, such motions and
their derivatives grow without bounds. All functions of the implicit step serve with the `inner` system, whose step is
h'; here stands what goes in and out.

BDF2 is stable for every oscillation, and damps those that it cannot follow: E. Hairer, G. Wanner, Solving ordinary
differential equations II, section V.1. It needs two states a step apart: the first step, one after a step that was
shortened, and those that would add energy (`guard`) are implicit Euler steps. Arrays are (n, 3).
"""

from __future__ import annotations

from clothfit.engine.forces import contact
from clothfit.engine.inputs.tables import couple
from clothfit.engine.step import guard, implicit
from clothfit.engine.system import IMPLICIT, System
from clothfit.kernels.kernel import kernel
from clothfit.kernels.lanes.operations import add as plus
from clothfit.kernels.lanes.operations import fma, load3, mul, splat, store3, sub
from clothfit.kernels.vectors import add, combine, copy

BEND = 0.1
"""Strain, about, from which on K is that of the springs. With less, derivatives grow where a cloth folds; more costs
accuracy.
"""



def forms(system: System) -> tuple[System, System]:
    """The systems of the implicit steps that a BDF2 motion takes: its Euler steps, and the inner one of the others."""
    euler = system._replace(method=IMPLICIT)
    inner = euler._replace(h=2.0 / 3.0 * system.h)
    if system.newton_iterations > 1:
        return euler, inner
    return euler, inner._replace(springs=system.springs._replace(cap=1.0, bend=BEND))


@kernel
def ahead(third, a, before, out):
    """out = a + third (a − before): exact where nothing changes."""
    for i in range(len(out)):
        for c in range(3):
            out[i, c] = a[i, c] + third * (a[i, c] - before[i, c])


@kernel
def extrapolate(h, x, v, x_before, v_before, work):
    """Write x̃, ṽ, u and y to the workspace, for h' = `h`."""
    third, reach = splat(1.0 / 3.0), splat(h)
    for i in range(len(x)):
        x_i, v_i = load3(x, i), load3(v, i)
        gain = sub(v_i, load3(v_before, i))
        base, u_i = fma(third, sub(x_i, load3(x_before, i)), x_i), plus(v_i, gain)
        store3(base, work.x_base, i)
        store3(fma(third, gain, v_i), work.v_base, i)
        store3(u_i, work.u, i)
        store3(plus(base, mul(reach, u_i)), work.y, i)


@kernel
def step(inner, x, v, x_before, v_before, first, tolerance, work, w, x_new):
    """Write w, the velocities of the iterations (N, n, 3), and the new positions, from a first guess of the velocity;
    returns what `implicit.step` and `guard.arrive` do.
    """
    extrapolate(inner.h, x, v, x_before, v_before, work)
    implicit.assemble(inner, work.y, work.u, True, work.A, work.b)
    implicit.add_momentum(inner.vertex, work.v_base, work.b)
    couple(inner.inputs, inner, work.x_base, work.y, work.s, work.A, work.b)
    used, iterations, direct = implicit.step(inner, work.x_base, work.v_base, first, tolerance, work, w)
    kinetic, weight, size = guard.arrive(inner.vertex, x, work.x_base, inner.h, w[used - 1], x_new)
    return used, iterations, direct, kinetic, weight, size


@kernel
def pullback(inner, x, v, x_before, v_before, w, used, tolerance, work, x_bar, v_bar, x_rest, v_rest, grad):
    """Turn x_bar, v_bar, the gradient by the state after the step, into that by x, v; add to `grad`.

    x_rest, v_rest hold what steps after this one add to the gradient by x, v, and receive what this one adds to that
    by x_before, v_before.
    """
    extrapolate(inner.h, x, v, x_before, v_before, work)
    combine(1.0, v_bar, inner.h, x_bar, work.w_bar)
    v_bar[:] = 0.0
    contact.hand(inner.colliders, True)
    for k in range(used - 1, -1, -1):
        u = work.u if k == 0 else w[k - 1]
        contact.turn_to(inner.colliders, k)
        implicit.pull_iteration(inner, work.x_base, work.v_base, w[k], u, True, tolerance, work, x_bar, v_bar, grad)
    u_bar = work.w_bar
    spread(1.0 / 3.0, x_bar, x_rest)
    spread(1.0 / 3.0, v_bar, v_rest)
    add(2.0, u_bar, v_bar)
    add(-1.0, u_bar, v_rest)


@kernel
def spread(third, bar, rest):
    """The gradient `bar` by a + third (a − before) as that by a, with `rest` in it, and by `before`, in `rest`."""
    for i in range(len(bar)):
        for c in range(3):
            part = third * bar[i, c]
            bar[i, c] += part + rest[i, c]
            rest[i, c] = -part


@kernel
def pushforward(inner, x, v, x_before, v_before, w, used, tolerance, work, dx, dv, dx_before, dv_before, direction):
    """Turn dx, dv, the change of x, v, into that of the state after the step, for the change `direction`; the change
    of x_before, v_before becomes that of x, v.
    """
    extrapolate(inner.h, x, v, x_before, v_before, work)
    ahead(1.0, dv, dv_before, work.gu)
    shift_by(1.0 / 3.0, dx, dx_before)
    shift_by(1.0 / 3.0, dv, dv_before)
    contact.hand(inner.colliders, False)
    for k in range(used):
        u = work.u if k == 0 else w[k - 1]
        if k > 0:
            copy(work.solution, work.gu)
        contact.turn_to(inner.colliders, k)
        implicit.push_iteration(inner, work.x_base, work.v_base, w[k], u, True, tolerance, work, dx, dv, direction)
    copy(work.solution, dv)
    add(inner.h, dv, dx)


@kernel
def shift_by(third, a, before):
    """a, before = a + third (a − before), a."""
    for i in range(len(a)):
        for c in range(3):
            old = a[i, c]
            a[i, c] = old + third * (old - before[i, c])
            before[i, c] = old
