"""Step after step in compiled loops, one for each kind of method: implicit, of second order (BDF2), and explicit.

The functions take a `rollout.Rollout` to fill or to read.
"""

from __future__ import annotations

import numpy as np

from clothfit.base.limits import FARTHEST
from clothfit.engine.forces import collider_rows, contact
from clothfit.engine.inputs.tables import place_pins, power, set_frame, set_inputs
from clothfit.engine.inputs.tables import work as work_done
from clothfit.engine.solve import guess
from clothfit.engine.step import bdf2, explicit, guard, implicit
from clothfit.engine.step.states import state_before, velocity
from clothfit.engine.work import energy_before, moved, rise
from clothfit.kernels.kernel import kernel
from clothfit.kernels.lanes.operations import load3, sub
from clothfit.kernels.vectors import combine, copy, dot

HIT = 0.1
"""Share of the kinetic energy. With less, more steps change between the methods as values change, and fits stall there.
"""

DONE, REFUSED, FAILED, CONTACTS, GAINS = 0, 1, 2, 3, 4
"""How a run of steps ends: all are good; the next one is to be taken with the clamped system, its first guess is ready;
it diverged; it is there, but its contacts added energy, and it is to be taken anew (`retake`); the last one has gained
energy beyond the work of what moves, and is to be mended (`contact_steps.mend`).
"""


@kernel(nogil=True)
def run(system, tolerance, work, part, start, stop):
    """Fill a Rollout from its step `start` to below `stop` by implicit steps.

    Returns the number of good steps since its beginning, and how the run ended: DONE, REFUSED, FAILED, CONTACTS or
    GAINS.
    """
    x, w, used, solves, capped, theta = part.x, part.w, part.used, part.solves, part.clamped, part.theta
    before = part.first
    first, energy, safe = work.solution, 0.0, system.springs.cap <= 1.0
    t, checked = start, start if guard.applies(system) else stop
    watched = guard.watches(system.inputs, system)
    own = guard.own_energy(system, x[t], velocity(part, t)) if watched else 0.0
    while t < stop:
        v = velocity(part, t)
        set_inputs(system.inputs, system, before + t)
        contact.expect(system.colliders, part, t)
        now, given = implicit.prepare(system, x[t], v, work)  # the energy that step t − 1 led to
        if t > start:
            given += power(system.inputs, before + t - 1, v)
        if t > checked and guard.rises(energy, now, system.h * given):
            checked = t
            fault = shortened(system, part, t - 1, energy)
            if fault == guard.CONTACTS:
                return t - 1, CONTACTS
            if fault == guard.SPRINGS:
                continue
        if t > start:
            grant(part, t - 1, system.h * given)
        elif part.first + t == 0:
            part.guard_state[0, guard.BOUND] = now
        energy = now
        if not safe:
            copy(v, first)
            guess.next_guess(work.past, before + t, first)
            solves[t] = 0
        taken, iterations, direct = implicit.step(system, x[t], v, first, tolerance, work, w[t])
        count(part, t, taken, iterations, direct)
        contact.save_active(system.colliders, part, t)
        theta[t], capped[t], part.predicted[t] = 1.0, safe, False
        if used[t] == 0:
            return t, REFUSED
        arrive(system, x[t], w[t, used[t] - 1], x[t + 1])
        if not finite(x[t + 1]):
            return t, FAILED
        t += 1
        if watched:
            begun, w_t = own, velocity(part, t)
            own = guard.own_energy(system, x[t], w_t)
            more = own - begun - system.h * given_in(system, before + t - 1, w_t)
            suspect = more > guard.SUSPECT * begun + guard.LEAST_RISE
            if suspect and gain(system.inputs, system, part, t - 1, work) != 0.0:
                return t, GAINS
    if checked < stop and shortened(system, part, stop - 1, energy) == guard.CONTACTS:
        return stop - 1, CONTACTS
    grant(part, stop - 1, system.h * given_in(system, before + stop - 1, velocity(part, stop)))
    return stop, DONE


@kernel(nogil=True)
def run_explicit(system, part, start, stop):
    """What `run` does, for the explicit methods: no step is refused, and none is taken anew."""
    for t in range(start, stop):
        set_inputs(system.inputs, system, part.first + t)
        contact.expect(system.colliders, part, t)
        explicit.step(system, part.x[t], velocity(part, t), part.w[t, 0], part.x[t + 1])
        contact.save_active(system.colliders, part, t)
        part.used[t], part.theta[t], part.predicted[t] = 1, 1.0, False
        place_pins(system.inputs, system, part.x[t + 1])
        if not finite(part.x[t + 1]):
            return t, FAILED
    return stop, DONE


@kernel(nogil=True)
def begin(system, part, t, work):
    """Set the inputs of a step, write a first guess of the velocity to the workspace, and note an ordinary step; where
    the system is clamped, another one has made that guess.
    """
    set_inputs(system.inputs, system, part.first + t)
    part.theta[t], part.clamped[t], part.predicted[t] = 1.0, system.springs.cap <= 1.0, False
    part.hit[t], part.euler[t] = False, True
    part.guard_state[t + 1, guard.POWER] = 0.0
    contact.expect(system.colliders, part, t)
    if not part.clamped[t]:
        part.solves[t] = 0
        copy(velocity(part, t), work.solution)
        guess.next_guess(work.past, part.first + t, work.solution)


@kernel(nogil=True)
def attempt(system, work, part, t, first, tolerance, iterates):
    """Take Euler step t, whose inputs are set, from a first guess and the contacts that are noted, and write the
    `iterates` (N, n, 3) of it; whether its matrix is not seen to be indefinite.
    """
    v = velocity(part, t)
    implicit.prepare(system, part.x[t], v, work)
    used, iterations, direct = implicit.step(system, part.x[t], v, first, tolerance, work, iterates)
    contact.save_active(system.colliders, part, t)
    count(part, t, used, iterations, direct)
    if used > 0:
        arrive(system, part.x[t], iterates[used - 1], part.x[t + 1])
    return used > 0


@kernel
def given_in(system, t, v):
    """The power of the weight and of the applied forces in step t, at velocities v (n, 3), W."""
    return guard.moving(system.vertex, v)[1] + power(system.inputs, t, v)


@kernel
def grant(part, t, weight):
    """Carry the bound over step t, in which the weight did this work, J."""
    part.guard_state[t + 1, guard.BOUND] = part.guard_state[t, guard.BOUND] + weight


@kernel(apart=0)
def shortened(system, part, t, energy):
    """Shorten step t, which began with this energy, J, if springs added energy; returns what did (`guard.fault`)."""
    x, v, bound = part.x, velocity(part, t + 1), part.guard_state[t, guard.BOUND]
    fault = guard.fault(system, part.first + t, energy, bound, x[t], v, x[t + 1])
    if fault == guard.SPRINGS:
        part.theta[t] = guard.shorten(system, part.first + t, energy, bound, x[t], v, x[t + 1])
    return fault


@kernel
def finite(x):
    """Whether all coordinates are numbers, and not too far away."""
    for i in range(len(x)):
        size = abs(x[i, 0]) + abs(x[i, 1]) + abs(x[i, 2])
        if not size < FARTHEST:  # so that NaN counts as well
            return False
    return True


@kernel(nogil=True)
def retake(predictive, tolerance, work, part, t):
    """Take step t anew with a system that knows contacts early, and shorten it if it still adds energy. Returns
    DONE, FAILED or REFUSED, where the clamped system is to be tried.
    """
    x, v, bound = part.x, velocity(part, t), part.guard_state[t, guard.BOUND]
    energy = guard.energy(predictive, x[t], v)
    part.predicted[t], part.clamped[t] = True, predictive.springs.cap <= 1.0
    contact.expect(predictive.colliders, part, t)
    if not attempt(predictive, work, part, t, v, tolerance, part.w[t, :1]):
        return REFUSED
    w = part.w[t, 0]
    if not finite(x[t + 1]):
        return FAILED
    if guard.fault(predictive, part.first + t, energy, bound, x[t], w, x[t + 1]) != guard.NONE:
        part.theta[t] = guard.shorten(predictive, part.first + t, energy, bound, x[t], w, x[t + 1])
    weight = predictive.h * given_in(predictive, part.first + t, w)
    part.guard_state[t + 1, guard.BOUND] = min(bound + weight, guard.energy(predictive, x[t + 1], w))
    return DONE


@kernel(nogil=True)
def run_bdf2(euler, inner, tolerance, work, part, start, stop):
    """What `run` does, for the two `bdf2.forms`."""
    x, guarded, watched = part.x, guard.applies(euler), guard.watches(euler.inputs, euler)
    set_frame(euler.inputs, euler, part.first + start)
    energy = guard.energy(euler, x[start], velocity(part, start)) if guarded or watched else 0.0
    if part.first + start == 0:
        part.guard_state[0, guard.BOUND] = energy
    for t in range(start, stop):
        v = velocity(part, t)
        begin(euler, part, t, work)
        part.euler[t] = part.theta[t - 1] < 1.0 or part.predicted[t - 1] or part.hit[t - 1] if t > 0 else not part.ready
        if not part.euler[t]:
            energy, taken = second_order(euler, inner, tolerance, work, part, t, energy, guarded, watched)
            if part.used[t] == 0:
                return t, REFUSED
            if taken and not hits(euler.colliders, euler.vertex, x[t], v, x[t + 1]):
                continue
            part.euler[t] = True
            contact.expect(euler.colliders, part, t)
        if not attempt(euler, work, part, t, work.solution, tolerance, part.w[t]):
            return t, REFUSED
        w = velocity(part, t + 1)
        if not finite(x[t + 1]):
            return t, FAILED
        part.hit[t] = hits(euler.colliders, euler.vertex, x[t], v, x[t + 1])
        if guarded:
            if shortened(euler, part, t, energy) == guard.CONTACTS:
                return t, CONTACTS
            grant(part, t, euler.h * given_in(euler, part.first + t, w))
            energy = guard.energy(euler, x[t + 1], w)
        if watched:
            if gain(euler.inputs, euler, part, t, work) != 0.0:
                return t + 1, GAINS
            energy = guard.energy(euler, x[t + 1], w)
    return stop, DONE


@kernel(absent=0.0, apart=0.0)
def gain(inputs, system, part, t, work):
    """How much the energy rises in Euler step t beyond the work that is done in it, J; 0 where that is tolerated, and
    where colliders grow, whose work is not known.
    """
    begun = energy_before(system, part, t)
    more = rise(system, system, part, t, False, velocity(part, t + 1), begun, work)
    return more if guard.rises(begun, begun + more, 0.0) and not collider_rows.some_grow(system.colliders) else 0.0


@kernel(empty=False, apart=False)
def hits(colliders, vertex, x, v, x_new):
    """Whether a step from x to x_new, (n, 3), which began with velocities v, stops more than HIT of the kinetic energy
    at colliders: those velocities tell nothing of the next one.
    """
    stopped, whole = 0.0, 0.0
    for i in range(len(vertex.mass)):
        whole += vertex.mass[i] * dot(load3(v, i), load3(v, i))
    for c in range(len(colliders.rows)):
        for i in range(len(vertex.mass)):
            if collider_rows.bound(colliders.bodies, colliders.rows[c], i, load3(x_new, i)) < 0.0:
                continue
            depth, _, _, n, _, point = collider_rows.contact(colliders, x_new, i, c)
            if vertex.free[i] and depth > 0.0 and collider_rows.contact(colliders, x, i, c)[0] <= 0.0:
                V = collider_rows.surface_velocity(colliders, load3(x_new, i), c, point)
                towards = min(dot(n, sub(load3(v, i), V)), 0.0)
                stopped += vertex.mass[i] * towards * towards
    return stopped > HIT * whole


@kernel
def second_order(euler, inner, tolerance, work, part, t, energy, guarded, watched):
    """Take step t by BDF2; returns the energy after it, if it is taken, else that before, J, and whether it is. Where
    it is to be taken with the clamped systems, 0 iterations are used. As colliders may move what begins in a sphere, no
    bound is asked where something does.
    """
    x, v, (x_before, v_before) = part.x, velocity(part, t), state_before(part, t)
    used, iterations, direct, kinetic, weight, size = bdf2.step(
        inner, x[t], v, x_before, v_before, work.solution, tolerance, work, part.w[t], x[t + 1]
    )
    count(part, t, used, iterations, direct)
    contact.save_active(euler.colliders, part, t)  # which the work below asks for
    place_pins(euler.inputs, euler, x[t + 1])
    weight += work_done(euler.inputs, part.first + t, x[t], x[t + 1])
    near = 3.0 * size < FARTHEST * FARTHEST or finite(x[t + 1])  # 3 |a|² ≥ (|a₀| + |a₁| + |a₂|)²
    if used == 0 or not near:
        return energy, False
    if not (guarded or watched):
        return energy, True
    if watched:
        weight += moved(euler.inputs, euler, inner, part, t, True, part.w[t, used - 1], work)
    bound = np.inf if watched else part.guard_state[t, guard.BOUND]
    after, fault = guard.judged(euler, energy, bound, x[t], x[t + 1], kinetic, weight)
    if fault != guard.NONE and not collider_rows.some_grow(euler.colliders):
        return energy, False
    grant(part, t, weight)
    return after, True


@kernel(nogil=True)
def go_on(system, tolerance, work, part, t):
    """Take one more iteration of Euler step t, which is whole; whether there was one, and it ended well."""
    x, w, k = part.x[t], part.w[t], part.used[t]
    if k == len(w):
        return False
    set_inputs(system.inputs, system, part.first + t)
    contact.load_active(system.colliders, part, t)
    ended, iterations, direct = implicit.iterate_on(system, x, velocity(part, t), k, tolerance, work, w)
    contact.save_active(system.colliders, part, t)
    count(part, t, k, iterations, direct)
    if ended != implicit.SOLVED or not finite(w[k]):
        return False
    part.used[t] = k + 1
    arrive(system, x, w[k], part.x[t + 1])
    return True


@kernel(absent=None)
def press_again(colliders, system, part, t, work):
    """Note what presses vertices at the end of Euler step t, which is whole and ends with another iteration."""
    last, w = part.used[t] - 1, part.w[t]
    u = velocity(part, t) if last == 0 else w[last - 1]
    contact.load_active(colliders, part, t)
    contact.turn_to(colliders, last)
    implicit.offset(system, part.x[t], w[last], u, last > 0, work.y, work.s)
    contact.press(colliders, work.y, u, w[last], work.s, system.h)
    contact.save_load(colliders, part, t)


@kernel
def arrive(system, x, w, after):
    """Write the positions `after` an Euler step from x with the velocity w, (n, 3) each."""
    combine(1.0, x, system.h, w, after)
    place_pins(system.inputs, system, after)


@kernel
def count(part, t, used, iterations, direct):
    """Note what a solution of step t took."""
    part.used[t] = used
    part.solves[t, 0] += iterations
    part.solves[t, 1] += direct
