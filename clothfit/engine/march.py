"""Step after step in compiled loops: those of the methods with one state before a step, and that of BDF2 with two.

The functions take a `rollout.Rollout` to fill or to read.
"""

from __future__ import annotations

from clothfit.base.limits import FARTHEST
from clothfit.engine.solve import guess
from clothfit.engine.step import bdf2, guard, implicit, transition
from clothfit.kernels.kernel import kernel
from clothfit.kernels.vectors import combine, copy


@kernel
def velocity(part, t):
    """Velocity (n, 3) before step t of a Rollout."""
    if t == 0:
        return part.v
    return part.w[t - 1, part.used[t - 1] - 1]


@kernel
def velocities(part, t):
    """Velocities (N, n, 3) of the iterations of step t, as they were before the step was shortened."""
    w, theta = part.w[t], part.theta[t]
    if theta < 1.0:
        w = w.copy()
        w[part.used[t] - 1] /= theta  # a power of ½: nothing is lost
    return w


@kernel
def run(system, early, tolerance, work, part, start, stop):
    """Fill a Rollout from its step `start` to below `stop`; `early` are the systems that know contacts early,
    the clamped one last.

    Returns the number of good steps since its beginning, and whether the next one failed. If it did not fail, and
    `stop` is not reached, the caller must take it with the clamped system; its first guess is ready.
    """
    x, w, used, solves, capped, theta = part.x, part.w, part.used, part.solves, part.clamped, part.theta
    before = part.first
    first, energy, safe = work.solution, 0.0, system.springs.cap <= 1.0
    t, checked = start, start if guard.applies(system) else stop
    while t < stop:
        v = velocity(part, t)
        now, power = transition.prepare(system, x[t], v, work)  # the energy that step t − 1 led to
        if t > checked and guard.rises(energy, now, system.h * power):
            checked = t
            if mended(system, early, tolerance, work, part, t - 1, energy):
                continue
        if t > start:
            grant(part, t - 1, system.h * power)
        elif part.first + t == 0:
            part.budget[0] = now
        energy = now
        if not safe:
            copy(v, first)
            guess.advance(work.past, before + t, first)
            solves[t] = 0
        used[t], iterations, direct = transition.step(system, x[t], v, first, tolerance, work, w[t], x[t + 1])
        solves[t, 0] += iterations
        solves[t, 1] += direct
        theta[t], capped[t], part.early[t] = 1.0, safe, False
        if used[t] == 0:
            return t, False
        if not finite(x[t + 1]):
            return t, True
        t += 1
    if checked < stop:
        mended(system, early, tolerance, work, part, stop - 1, energy)
    grant(part, stop - 1, system.h * guard.moving(system.vertex, velocity(part, stop))[1])
    return stop, False


@kernel
def grant(part, t, weight):
    """Carry the budget over step t, in which the weight did this work, J; `mended` does where contacts are early."""
    if not part.early[t]:
        part.budget[t + 1] = part.budget[t] + weight


@kernel
def mended(system, early, tolerance, work, part, t, energy):
    """Take step t, which began with this energy, J, anew if it added energy, with early contacts where these did, and
    shorten it if it still does; returns whether anything was done.
    """
    x, v, budget = part.x, velocity(part, t + 1), part.budget[t]
    fault = guard.fault(system, energy, budget, x[t], v, x[t + 1])
    if fault == guard.NONE:
        return False
    if fault == guard.CONTACTS:
        v = retaken(early, tolerance, work, part, t)
        combine(1.0, x[t], system.h, v, x[t + 1])
        fault = guard.fault(system, energy, budget, x[t], v, x[t + 1])
    if fault != guard.NONE:
        part.theta[t] = guard.shorten(system, energy, budget, x[t], v, x[t + 1])
    if part.early[t]:
        given = system.h * guard.moving(system.vertex, v)[1]
        part.budget[t + 1] = min(budget + given, guard.energy(system, x[t + 1], v))
    return True


@kernel
def finite(x):
    """Whether all coordinates are numbers, and not too far away."""
    for i in range(len(x)):
        size = abs(x[i, 0]) + abs(x[i, 1]) + abs(x[i, 2])
        if not size < FARTHEST:  # so that NaN counts as well
            return False
    return True


@kernel
def state_before(part, t):
    """Position and velocity (n, 3) one step before step t of a Rollout begins."""
    if t == 0:
        return part.x_before, part.v_before
    return part.x[t - 1], velocity(part, t - 1)


@kernel
def retaken(early, tolerance, work, part, t):
    """Take step t anew with the first of the systems `early` that serves; returns the velocity (n, 3) after it."""
    x, v, first = part.x[t], velocity(part, t), velocity(part, t + 1).copy()
    part.early[t] = True
    for form in early:
        part.clamped[t] = form.springs.cap <= 1.0
        implicit.prepare(form, x, v, work)
        used, iterations, direct = implicit.step(form, x, v, first, tolerance, work, part.w[t, :1])
        count(part, t, used, iterations, direct)
        if used > 0:
            break
    return velocity(part, t + 1)


@kernel
def run_bdf2(euler, inner, early, tolerance, work, part, start, stop):
    """What `run` does, for the two `bdf2.forms`."""
    x, first, safe = part.x, work.solution, euler.springs.cap <= 1.0
    guarded = guard.applies(euler)
    energy = guard.energy(euler, x[start], velocity(part, start)) if guarded else 0.0
    if part.first + start == 0:
        part.budget[0] = energy
    for t in range(start, stop):
        v = velocity(part, t)
        if not safe:
            copy(v, first)
            guess.advance(work.past, part.first + t, first)
            part.solves[t] = 0
        part.theta[t], part.clamped[t], part.early[t] = 1.0, safe, False
        part.euler[t] = part.theta[t - 1] < 1.0 or part.early[t - 1] if t > 0 else not part.ready
        if not part.euler[t]:
            energy, taken = second_order(euler, inner, tolerance, work, part, t, energy, guarded)
            if part.used[t] == 0:
                return t, False
            if taken:
                continue
            part.euler[t] = True
        implicit.prepare(euler, x[t], v, work)
        used, iterations, direct = implicit.step(euler, x[t], v, first, tolerance, work, part.w[t])
        count(part, t, used, iterations, direct)
        if used == 0:
            return t, False
        w = part.w[t, used - 1]
        combine(1.0, x[t], euler.h, w, x[t + 1])
        if not finite(x[t + 1]):
            return t, True
        if guarded:
            mended(euler, early, tolerance, work, part, t, energy)
            v = velocity(part, t + 1)
            grant(part, t, euler.h * guard.moving(euler.vertex, v)[1])
            energy = guard.energy(euler, x[t + 1], v)
    return stop, False


@kernel
def second_order(euler, inner, tolerance, work, part, t, energy, guarded):
    """Take step t by BDF2; returns the energy after it, if it is taken, else that before, J, and whether it is. Where
    it is to be taken with the clamped systems, 0 iterations are used.
    """
    x, v, (x_before, v_before) = part.x, velocity(part, t), state_before(part, t)
    used, iterations, direct, kinetic, weight, size = bdf2.step(
        inner, x[t], v, x_before, v_before, work.solution, tolerance, work, part.w[t], x[t + 1]
    )
    count(part, t, used, iterations, direct)
    near = 3.0 * size < FARTHEST * FARTHEST or finite(x[t + 1])  # 3 |a|² ≥ (|a₀| + |a₁| + |a₂|)²
    if used == 0 or not near:
        return energy, False
    if not guarded:
        return energy, True
    after, fault = guard.judged(euler, energy, part.budget[t], x[t], x[t + 1], kinetic, weight)
    if fault != guard.NONE:
        return energy, False
    grant(part, t, weight)
    return after, True


@kernel
def count(part, t, used, iterations, direct):
    """Note what a solution of step t took."""
    part.used[t] = used
    part.solves[t, 0] += iterations
    part.solves[t, 1] += direct
