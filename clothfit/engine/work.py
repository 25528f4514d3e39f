"""The work that what moves does on a cloth: pins, spheres and other colliders.

An implicit step solves M (w − v) = h F(w), with the forces F of its model at its end. Along its way they do the work

    h w·F = ½ wᵀM w − ½ vᵀM v + ½ (w − v)ᵀM (w − v).

A collider that pushes with T, and moves at V where it touches, does h T·V of that itself; the rest, h T·(w − V), is
taken from the energy of the contact, and by friction. A pin is led by a force R = m (w − v)/h − F, which does h R·w.
With E the kinetic and stored energy and W the work of all that moves, of the wind and of given forces,

    E⁺ − E = W − ½ (w − v)ᵀM (w − v) − (what friction and damping take) − Σ (½ k of all that is linear) (change)² + e,

where e is what the energy differs from that of the model: springs that turn, surfaces that are curved, which nothing
else can make positive. A BDF2 step solves M (w − ṽ) = h' F(w), so that M (w − v) = h f̄ with the mean f̄ = 2/3 F + 1/3 f̄₋
of its forces and those before: the powers T·V have the same mean.

Work is computed with the forces of the steps themselves, from what a `rollout.Rollout` has of them.
"""

from __future__ import annotations

from clothfit.engine.forces import applied, contact, spheres, springs, vertex, wind
from clothfit.engine.forces.faces import add_along
from clothfit.engine.inputs.tables import set_frame, set_inputs
from clothfit.engine.inputs.tables import work as work_done
from clothfit.engine.step import bdf2, guard, implicit
from clothfit.engine.step.states import state_before, velocities, velocity
from clothfit.kernels.kernel import kernel
from clothfit.kernels.lanes.operations import load3, mul, splat, sub
from clothfit.kernels.vectors import combine, dot


@kernel(apart=(0.0, 0.0))
def power(euler, inner, part, t, second, work):
    """What moves does at the end of step t of a part, and what friction takes, W; a `second` order step is one of BDF2.
    """
    set_inputs(euler.inputs, euler, part.first + t)
    contact.load_active(euler.colliders, part, t)
    x, v, w, last = part.x[t], velocity(part, t), velocities(part, t), part.used[t] - 1
    contact.turn_to(euler.colliders, last)
    if second:
        x_before, v_before = state_before(part, t)
        bdf2.extrapolate(inner.h, x, v, x_before, v_before, work)
        u = work.u if last == 0 else w[last - 1]
        implicit.offset(inner, work.x_base, w[last], u, True, work.y, work.s)
        return of_forces(inner, part.first + t, euler.h, work.v_base, u, w[last], work)
    u = v if last == 0 else w[last - 1]
    implicit.offset(euler, x, w[last], u, last > 0, work.y, work.s)
    return of_forces(euler, part.first + t, euler.h, v, u, w[last], work)


@kernel
def energy_before(euler, part, t):
    """The energy before step t of a part, without pairs, J."""
    set_frame(euler.inputs, euler, part.first + t)
    return guard.energy(euler, part.x[t], velocity(part, t))


@kernel
def rise(euler, inner, part, t, second, w, begun, work):
    """How much the energy rises in step t, after which the velocity is w (n, 3), from what it has `begun` with, J
    (`energy_before`), beyond the work that is done in it, without pairs, J.
    """
    x, after = part.x[t], part.x[t + 1]
    done = moved(euler.inputs, euler, inner, part, t, second, w, work)
    done += work_done(euler.inputs, part.first + t, x, after)
    done += vertex.energy(euler.vertex, x) - vertex.energy(euler.vertex, after)
    return guard.energy(euler, after, w) - begun - done


@kernel(absent=0.0, apart=0.0)
def moved(inputs, euler, inner, part, t, second, w, work):
    """The work of what moves and of the wind in step t, after which the velocity is w (n, 3), J. Its mean power is
    noted, of which that of a next step of `second` order has a third.
    """
    now = power(euler, inner, part, t, second, work)[0] + wind.powers(euler.faces, work.y, w, w)[0]
    part.guard_state[t + 1, guard.POWER] = (2.0 * now + part.guard_state[t, guard.POWER]) / 3.0 if second else now
    return euler.h * part.guard_state[t + 1, guard.POWER]


@kernel
def explicit_power(system, part, t, work):
    """The same for explicit methods, whose forces are those before the step."""
    set_inputs(system.inputs, system, part.first + t)
    contact.load_active(system.colliders, part, t)
    v = velocity(part, t)
    combine(1.0, part.x[t], 0.0, v, work.y)
    work.s[:] = 0.0
    combine(1.0 / system.h, part.x[t + 1], -1.0 / system.h, part.x[t], work.w_bar)
    f = work.gy
    total, rubbed = add_contacts(system, part.first + t, system.h, v, v, work, f)
    return total + of_pins(system, v, v, work.w_bar, work, f), rubbed


@kernel
def of_forces(system, t, h, v, u, w, work):
    """The power in step t of a motion, of length h, that goes from v to w and is linearised at (y, u), (n, 3) each."""
    total, rubbed = add_contacts(system, t, h, u, w, work, work.gy)
    return total + of_pins(system, v, u, w, work, work.gy), rubbed


@kernel
def add_contacts(system, t, h, u, w, work, f):
    """The power of spheres and colliders, and of friction; writes the forces that they and pairs have in the step to f
    (n, 3).
    """
    f[:] = 0.0
    total = of_spheres(system.spheres, system.inputs, t, h, work.y, work.s, f)
    begin = (t + system.inputs.lead - 1) * h, h
    one, rubbed = contact.power(system.colliders, work.y, u, w, work.s, system.h, begin, f)
    other, more = contact.power(system.contact, work.y, u, w, work.s, system.h, begin, f)
    return total + one + other, rubbed + more


@kernel
def of_spheres(own, inputs, t, h, y, s, f):
    """The power of the editor's spheres in step t; adds their forces to f."""
    total = 0.0
    for c in range(len(own.radius)):
        V = splat(0.0)
        if len(inputs.centre) > 0:
            late = t + inputs.lead
            V = mul(splat(1.0 / h), sub(load3(inputs.centre[late], c), load3(inputs.centre[max(late - 1, 0)], c)))
        for i in range(len(y)):
            depth, _, n = spheres.contact(own, y, i, c)
            if depth > 0.0:
                push = spheres.STIFFNESS * (depth - dot(n, load3(s, i)))
                add_along(f, i, push, n)
                total += push * dot(n, V)
    return total


@kernel
def of_pins(system, v, u, w, work, f):
    """The power of pins, with the forces of contacts on them in f (n, 3), which is overwritten."""
    inputs, y, s, h, q = system.inputs, work.y, work.s, system.h, work.gu
    if len(inputs.pins) == 0:
        return 0.0
    # F = f(y, u) + D (w − u) + K s; of springs K s = −C s/h² − D s/h, with C = −h² K − h D
    vertex.add_force(system.vertex, y, u, f)
    springs.add_force(system.springs, y, u, f)
    wind.add_force(system.faces, y, u, f)
    applied.add_force(system.applied, y, u, f)
    combine(1.0, w, -1.0, u, q)
    vertex.add_damping(system.vertex, y, u, 1.0, q, f)
    wind.add_damping(system.faces, y, u, 1.0, q, f)
    combine(1.0, q, -1.0 / h, s, q)
    springs.add_damping(system.springs, y, u, 1.0, q, f)
    for c in range(len(inputs.coupled)):
        i = inputs.coupled[c]
        for end in range(2):
            pin, other = system.springs.ends[i, end], system.springs.ends[i, 1 - end]
            if not system.vertex.free[pin]:
                way = sub(load3(s, other), load3(s, pin))
                pull = springs.pull_of(system.springs, y, i, h, way)
                add_along(f, pin, 1.0 / (h * h), pull)
    total = 0.0
    for p in range(len(inputs.pins)):
        i = inputs.pins[p]
        led = sub(load3(w, i), load3(v, i))
        total += system.vertex.mass[i] / h * dot(led, load3(w, i)) - dot(load3(f, i), load3(w, i))
    return total
