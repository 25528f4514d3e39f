"""No implicit step adds energy: one that would is taken anew or shortened.

The linearised step follows tangents. Where the cloth turns far in one step, or is strongly compressed, the springs at
its end are longer than its model knew, and the energy E = ½ vᵀM v + V(x) rises: by a few percent in a stiff cloth, by
orders of magnitude in a crushed one, and what follows is garbage. Then only a part of the step is taken,

    v⁺ = θ w,   x⁺ = x + h θ w,   θ = ½, ¼, … the first with  E⁺ ≤ E + h Σ m g·v⁺,

V being the energy stored in springs and contacts, the last term the work of the weight and of applied forces. Some θ
always serves: as θ → 0 the kinetic energy goes, and where there is none, w = h A⁻¹ f points downhill as A is positive
definite (`clamped`).

A contact that begins with a step is not felt in it: the vertex ends in the sphere with ½ κ d² that nothing gave. In
ordinary motions steps lose more, so such a gain is left, as long as the energy stays below a bound: that of the start
and the work of the weight since. A step that contacts bring above it is taken anew as a linearised step that knows
them, as implicit springs from the surface on (`spheres.enters`): a convex energy, of which such a step only loses. Then
the energy after that step becomes the bound, so that no later contact gives back what one took.

Some steps are taken whole although the energy rises: those just named, unless the cloth starts deep in a sphere; in
wind that stays, which brings energy, while air at rest only takes it away; and where the rise is below a thousandth.
Where inputs change over time, or a cloth is let go by what it began inside of, the work done in a step (`work`) is no
gain: of BDF2 motions each step is compared with it, of implicit ones those after which the kinetic energy and that of
the springs are higher by more than SUSPECT. An Euler step that gains is mended as where a cloth touches itself
(`contact_steps`). At `colliders` that stay where they are a step ends with the contacts that it knows
(`forces.contact`): what rises there are springs, as elsewhere.
"""

from __future__ import annotations

import numpy as np

from clothfit.base.arrays import Array
from clothfit.engine.forces import springs, total
from clothfit.engine.forces.collider_rows import lets_go
from clothfit.engine.forces.spheres import contact
from clothfit.engine.inputs.tables import draws, energetic, power
from clothfit.engine.system import IMPLICIT, System
from clothfit.kernels.kernel import kernel
from clothfit.kernels.lanes.operations import add, fma, load3, mul, splat, store3, sub, sum3
from clothfit.kernels.vectors import combine, dot, vector

SLACK = 1e-3
"""A rise that is tolerated, relative to the kinetic and stored energy before the step."""

LEAST_RISE = 1e-20
"""A rise that is tolerated, J: rounding in a cloth that does not move and is not stretched."""

CONTACT_SLACK = 0.1
"""A rise above the bound by contacts that is tolerated, relative to the bound or, if that is more, the energy before.
"""

SUSPECT = 0.05
"""A rise of the kinetic energy and that of springs in a step, relative to them, from which on it is asked where that
comes from, where something moves.
"""

BOUND, POWER = 0, 1
"""What a step hands to the next one beside its state: the energy that contacts may bring it to, J, −∞ for that of the
state; and the mean power of what moves, and of the wind, W, in a step where that may bring energy. Behind these
stands what has pressed each vertex of a collider, N (`forces.contact`).
"""


def start(system: System) -> Array:
    """What the first step is handed, (2 + R,)."""
    count = 0 if system.colliders is None else len(system.colliders.depth)
    return np.append([-np.inf, 0.0], np.full(count, -1.0))


NONE, SPRINGS, CONTACTS = 0, 1, 2
"""What added energy in a step."""

SHORTEST = 40
"""Halvings at most; v⁺ is then 1e-12 of w."""


@kernel
def applies(system):
    """Whether steps may be shortened at all."""
    faces = system.faces
    still = faces.wind[0] == 0.0 and faces.wind[1] == 0.0 and faces.wind[2] == 0.0
    calm = still or not faces.drag.any() or len(faces.corners) == 0
    return system.guarded and system.method == IMPLICIT and calm and not brings_energy(system)


@kernel(absent=False)
def watches(inputs, system):
    """Whether it is looked where the energy of steps comes from, as something moves, and they may be shortened."""
    return system.guarded and system.method >= IMPLICIT and brings_energy(system) and not draws(inputs, system.applied)


@kernel
def brings_energy(system):
    """Whether anything but the applied forces may: what moves, and what is let go that begins inside."""
    return energetic(system.inputs) or lets_go(system.colliders)


@kernel
def own_energy(system, x, v):
    """The kinetic energy of a state x, v (n, 3) and that of its springs, J."""
    return moving(system.vertex, v)[0] + springs.energy(system.springs, x)


@kernel
def moving(vertex, v):
    """½ vᵀM v, J, and the power of the weight Σ m g·v, W, for velocities v (n, 3)."""
    twice, momentum = splat(0.0), splat(0.0)
    for i in range(len(vertex.mass)):
        v_i = load3(v, i)
        p_i = mul(splat(vertex.mass[i]), v_i)
        momentum = add(momentum, p_i)
        twice = fma(p_i, v_i, twice)
    return 0.5 * sum3(twice), dot(vector(vertex.gravity), momentum)


@kernel
def rises(before, after, work):
    """Whether a step added more energy than the weight's work, all in J."""
    return not after - work <= (1.0 + SLACK) * before + LEAST_RISE


@kernel
def fault(system, t, before, bound, x, v, x_new):
    """What added energy in step t, from x to x_new with velocity v, (n, 3) each; see `judged`."""
    kinetic, given = moving(system.vertex, v)
    given += power(system.inputs, t, v)
    return judged(system, before, bound, x, x_new, kinetic, system.h * given)[1]


@kernel
def energy(system, x, v):
    """The kinetic and stored energy of a state x, v (n, 3), J."""
    return moving(system.vertex, v)[0] + total.stored_energy(system, x, x)


@kernel
def arrive(vertex, x, base, h, w, x_new):
    """Write x_new = base + h w for a step from x, (n, 3) each; returns ½ wᵀM w and the work of the weight, J, and
    Σ |x_new|², m².
    """
    twice, way, size, reach = splat(0.0), splat(0.0), splat(0.0), splat(h)
    for i in range(len(vertex.mass)):
        m, w_i = splat(vertex.mass[i]), load3(w, i)
        new = add(load3(base, i), mul(reach, w_i))
        twice = fma(mul(m, w_i), w_i, twice)
        way = fma(m, sub(new, load3(x, i)), way)
        size = fma(new, new, size)
        store3(new, x_new, i)
    return 0.5 * sum3(twice), dot(vector(vertex.gravity), way), sum3(size)


@kernel
def judged(system, before, bound, x, x_new, kinetic, work):
    """The energy, J, after a step from x to x_new that began with the energy `before`, and what added energy in it:
    NONE, SPRINGS or CONTACTS, these where they brought it above the bound.
    """
    after = kinetic + total.stored_energy(system, x_new, x_new)
    if not rises(before, after, work):
        return after, NONE
    known = after
    if not starts_deep(system.spheres, system.x0):
        known = kinetic + total.stored_energy(system, x_new, x)
    slack = CONTACT_SLACK * max(before, bound + work) + LEAST_RISE
    if not after - known <= slack and not after - work - bound <= slack:
        return after, CONTACTS
    return after, SPRINGS if rises(before, known, work) else NONE


@kernel
def starts_deep(spheres, x0):
    """Whether a motion begins with a vertex deeper in a sphere than half of its radius."""
    for c in range(len(spheres.radius)):
        for i in range(len(x0)):
            if contact(spheres, x0, i, c)[0] > 0.5 * spheres.radius[c]:
                return True
    return False


@kernel
def shorten(system, t, before, bound, x, v, x_new):
    """Halve the v of step t, which led from x to x_new, (n, 3) each, until no energy is added; returns the part θ that
    is left.
    """
    theta = 1.0
    for _ in range(SHORTEST):
        theta *= 0.5
        combine(0.5, v, 0.0, v, v)
        combine(1.0, x, system.h, v, x_new)
        if fault(system, t, before, bound, x, v, x_new) == NONE:
            break
    return theta
