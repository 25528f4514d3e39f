"""Step after step of a cloth that touches itself: which pairs press in a step, and what it does where that fails.

A step begins with the pairs that are nearer than their thickness. It is taken with them; those that would then pull are
left out, those that come as near or would pass through each other are added, and it is taken again, until neither is
left: the step
solves a complementarity problem, min ½ (w − w₀)ᵀA (w − w₀) + Σ ½ κ s max(0, d − h n·W)² for the pairs in view. What
still would pass through becomes zones that move as one (`forces.selfcontact.zones`). So a cloth that does not cross
itself at the start never does, however fast, but for pins that draw it through itself and for explicit methods, of
whose steps only the forces of near pairs are part.

Each step notes its pairs and zones; the derivatives take them from there.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, NamedTuple, TypeAlias

import numpy as np

from clothfit.base import interrupts
from clothfit.base.arrays import Array, Indices
from clothfit.engine import march
from clothfit.engine.forces import meeting
from clothfit.engine.forces.selfcontact import force, pairs, zones
from clothfit.engine.inputs.tables import place_pins, set_inputs
from clothfit.engine.solve import guess, joined, linear
from clothfit.engine.step import bdf2, implicit
from clothfit.engine.system import BDF2, IMPLICIT, System
from clothfit.kernels.kernel import kernel
from clothfit.kernels.vectors import combine, copy

Rollout: TypeAlias = Any
"""A `rollout.Rollout`; that module imports this one."""

ROUNDS = 6
"""Times that a step is taken, at most, until its pairs stay: roughly, and then again to the tolerance."""

DROPS = 3
"""How often, of these, pairs that pull are left out; later they stay, so that the rounds end."""

FLAT = 3e-3
"""Depth relative to the thickness that decides nothing where a solution is rough, or the rounds do not end: pairs may
then push or pull by so little, or be left out.
"""

ROUGH = 1e-2
"""Tolerance of the first solutions, which only find pairs."""


NOBODY: Any = np.zeros(0, np.int64)
"""Numbers of no pairs."""


class Touch(NamedTuple):
    """What a step had of self-contact."""

    numbers: Indices  # (P,), the pairs that pressed, ascending (`forces.selfcontact.pairs`)
    zones: zones.Zones | None  # what moved together


def surface_of(system: System, t: int = 0) -> pairs.Surface:
    """What of the cloth can touch itself, here there is something, in step t of its motion."""
    assert system.surface is not None
    return pairs.at_time(system.surface, (t + 1) * system.h)


def with_pairs(
    system: System, work: implicit.Workspace, surface: pairs.Surface, x: Array, numbers: Indices
) -> tuple[System, implicit.Workspace]:
    """A system and its workspace for a step from x (n, 3) in which these pairs press."""
    return with_contact(system, work, pairs.of_numbers(surface, x, numbers))


def with_contact(
    system: System, work: implicit.Workspace, contact: force.Contact
) -> tuple[System, implicit.Workspace]:
    """A system and its workspace for a step with a contact."""
    A = work.A._replace(joined=joined.joined(contact.vertices, contact.free))
    return system._replace(contact=contact), work._replace(A=A)


def fill(
    forms: Any, tolerance: float, work: implicit.Workspace, part: Rollout, look: Callable[[], None] = interrupts.check
) -> int:
    """Compute the steps of a part whose x[0], v and first are set; returns how many are good. `look` is called after
    each.
    """
    bare = part.bare()
    with linear.served(work.A, work.solver):
        for t in range(part.steps):
            touch, ended = step(forms.form(False, False), tolerance, work, bare, t)
            if ended == march.REFUSED:
                touch, ended = step(forms.form(False, True), tolerance, work, bare, t)
            if ended != march.DONE:
                return t
            part.touches[t] = touch
            look()
    return int(part.steps)


def step(system: System, tolerance: float, work: implicit.Workspace, part: Rollout, t: int) -> tuple[Touch, int]:
    """Take step t of a part; returns also how it ended."""
    x, surface = part.x[t], surface_of(system, part.first + t)
    numbers = pairs.near(surface, x)
    if system.method < IMPLICIT:
        own, room = with_pairs(system, work, surface, x, numbers)
        return Touch(numbers, None), march.run_explicit(own, part, t, t + 1)[1]
    if system.method == BDF2 and not len(numbers):
        own, room = with_pairs(system, work, surface, x, numbers)
        ended = march.run_bdf2(*bdf2.forms(own), tolerance, room, part, t, t + 1)[1]
        if ended != march.DONE or not len(pairs.meeting(surface, x, part.x[t + 1])):
            return Touch(numbers, None), ended
    touch, ended = pressed(bdf2.forms(system)[0], tolerance, work, part, t, surface, numbers)
    part.hit[t] = system.method == BDF2 and len(touch.numbers) > 0
    return touch, ended


def pressed(
    system: System, tolerance: float, work: implicit.Workspace, part: Rollout, t: int, surface: pairs.Surface,
    numbers: Indices,
) -> tuple[Touch, int]:
    """Take step t of a part by the implicit method, from the pairs that are near."""
    x, v, after = part.x[t], part.velocity(t), part.x[t + 1]
    begin(system, part, t, work)
    first, contact, hit = work.solution.copy(), pairs.of_numbers(surface, x, numbers), NOBODY
    active, rough = force.depths(contact, x, system.h * first) > 0.0, tolerance < ROUGH
    turn = 0
    while True:
        interrupts.check()
        used = active
        own, room = with_contact(system, work, pairs.some(contact, used))
        if not attempt(own, room, part, t, v, first, ROUGH if rough else tolerance):
            return Touch(numbers[used], None), march.REFUSED
        if not march.finite(after):
            return Touch(numbers[used], None), march.FAILED
        copy(part.w[t, part.used[t] - 1], first)
        turn += 1
        deep = force.depths(contact, *model(system, part, t))
        flat = FLAT * surface.thickness if rough or turn > DROPS else 0.0
        active = np.where(used, (deep > -flat) | (turn > DROPS), deep > flat)
        if (active != used).any() and turn < ROUNDS:
            continue
        hit = pairs.meeting(surface, x, after)
        new = np.setdiff1d(hit, numbers)
        shallow = force.depths(pairs.of_numbers(surface, x, new), after, 0.0 * after) <= flat
        new = np.union1d(new[~shallow], pairs.crossing(surface, x, after, new[shallow]))
        if turn >= ROUNDS or not len(new):
            if not rough:
                break
            rough, turn = False, 0
            continue
        order = np.argsort(together := np.concatenate([numbers, new]))
        numbers, active = together[order], np.concatenate([active, np.ones(len(new), bool)])[order]
        contact = pairs.of_numbers(surface, x, numbers)
    return Touch(numbers[used], separated(system, surface, part, t, hit)), march.DONE


def model(system: System, part: Rollout, t: int) -> tuple[Array, Array]:
    """Where step t was linearised at last, and how far from there it ends, (n, 3) each, m."""
    x, used, h = part.x[t], part.used[t], system.h
    w = part.w[t, used - 1]
    if used == 1:
        return x, h * w
    return x + h * part.w[t, used - 2], h * (w - part.w[t, used - 2])


def separated(
    system: System, surface: pairs.Surface, part: Rollout, t: int, hit: Indices
) -> zones.Zones | None:
    """Join what would pass through each other in step t, at first the pairs `hit`: writes its velocity and the
    positions after it.
    """
    x, after, w = part.x[t], part.x[t + 1], part.w[t, part.used[t] - 1]
    made, found, known = None, w.copy(), NOBODY
    hit = pairs.crossing(surface, x, after, hit)
    while len(hit):
        interrupts.check()
        known = np.concatenate([known, hit])
        made = zones.of_pairs(pairs.of_numbers(surface, x, known).vertices, len(x), found)
        w[:] = found
        zones.join(made, system.vertex, w)
        arrive(system, x, w, after)
        hit = np.setdiff1d(pairs.meeting(surface, x, after), known)
        hit = pairs.crossing(surface, x, after, hit)
    return made


class Taken(NamedTuple):
    """A step that was taken, as its derivatives need it."""

    system: System  # with its pairs
    work: implicit.Workspace  # for them
    part: Rollout  # this step alone, bare, with its velocities as they were before zones joined them
    zones: zones.Zones | None


def taken(system: System, work: implicit.Workspace, part: Rollout, t: int) -> Taken:
    """Step t of a part, for the system that it was taken with but for its pairs."""
    touch, one = part.touches[t], part.part(t, t + 1).bare()
    surface = surface_of(system, part.first + t)
    own, room = with_pairs(system, work, surface, part.x[t], touch.numbers)
    if touch.zones is not None:
        w = one.w.copy()
        w[0, one.used[0] - 1, touch.zones.member] = touch.zones.found
        one = one._replace(w=w)
    return Taken(own, room, one, touch.zones)


@kernel(nogil=True)
def begin(system, part, t, work):
    """Write a first guess of the velocity to the workspace, and note an ordinary step."""
    part.theta[t], part.clamped[t], part.early[t] = 1.0, system.springs.cap <= 1.0, False
    part.hit[t] = False
    part.euler[t] = True
    part.solves[t] = 0
    copy(march.velocity(part, t), work.solution)
    guess.advance(work.past, part.first + t, work.solution)


@kernel(nogil=True)
def attempt(system, work, part, t, v, first, tolerance):
    """Take step t from a first guess; whether its matrix is not seen to be indefinite."""
    set_inputs(system.inputs, system, part.first + t)
    meeting.clear(system.colliders)
    implicit.prepare(system, part.x[t], v, work)
    used, iterations, direct = implicit.step(system, part.x[t], v, first, tolerance, work, part.w[t])
    meeting.note(system.colliders, part.met, t)
    march.count(part, t, used, iterations, direct)
    if used == 0:
        return False
    arrive(system, part.x[t], part.w[t, used - 1], part.x[t + 1])
    return True


@kernel
def arrive(system, x, w, after):
    """The positions after a step."""
    combine(1.0, x, system.h, w, after)
    place_pins(system.inputs, system, after)
