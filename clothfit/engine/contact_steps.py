"""Step after step of a cloth that touches itself: which pairs press in a step, and what it does where that fails.

The pairs that may touch in a step are looked for about where its vertices are thought to go, and again where one goes
farther. A step begins with those of them that are nearer than their thickness, and is solved again with those that it
ends in, as with colliders (`forces.contact`). What still would pass through becomes zones that move as one
(`forces.selfcontact.zones`). So a cloth that does not cross itself at the start never does, however fast, but for pins
that draw it through itself and for explicit methods, of whose steps only the forces of near pairs are part.

A step of which the energy rises is not left so: one of BDF2 is taken anew by the implicit method, and one of that goes
on with more of Newton's iterations, each with the pairs that it ends in, while they converge: its springs turned, and
its contacts were met, elsewhere than its model knew. Where neither these nor fewer help it is taken anew with the
clamped matrix, in which cloths that only touch each other keep their momentum. If that gains, too, it is shortened, as
`step.guard` does; where something moves, which may press into a shorter step, to a sixteenth at the least. Of its ends
the one that gains least is kept.

Each step notes its pairs and zones; the derivatives take them from there.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, NamedTuple, TypeAlias

import numpy as np

from clothfit.base import interrupts
from clothfit.base.arrays import Array, Flags, Indices
from clothfit.engine import march
from clothfit.engine.forces import collider_rows, contact
from clothfit.engine.forces.selfcontact import pairs, rows, zones
from clothfit.engine.inputs.tables import draws, place_pins
from clothfit.engine.solve import linear, sparse
from clothfit.engine.step import bdf2, guard, implicit, states
from clothfit.engine.system import BDF2, IMPLICIT, System
from clothfit.kernels.kernel import kernel
from clothfit.kernels.vectors import copy

Rollout: TypeAlias = Any
"""A `rollout.Rollout`; that module imports this one."""

SEARCH_MARGIN = 0.15
"""How far, relative to the thickness, a vertex may end from where it went when pairs were looked for."""

SHORTEST = 4
"""Halvings of a step, at most, where something moves."""

ROUNDS = 8
"""Times, at most, that pairs are looked for in a step."""

NOBODY: Any = np.zeros(0, np.int64)
"""Numbers of no pairs."""


class ActivePairs(NamedTuple):
    """What a step had of self-contact."""

    numbers: Indices  # (P,), the pairs that pressed, ascending (`forces.selfcontact.pairs`)
    on: Flags | None  # (N, P), in which iterations; None: in all
    zones: zones.Zones | None  # what moved together


NO_PAIRS = ActivePairs(NOBODY, None, None)
"""What a step had that touched nothing."""


def surface_of(system: System, t: int, x: Array) -> pairs.Surface:
    """What of the cloth can touch itself, here there is something, in step t of its motion, from x (n, 3)."""
    assert system.surface is not None
    return pairs.at_time(system.surface, (t + 1) * system.h, x)


def with_pairs(
    system: System, work: implicit.Workspace, surface: pairs.Surface, x: Array, numbers: Indices,
    on: Flags | None = None, solves: bool = True,
) -> tuple[System, implicit.Workspace]:  # fmt: skip
    """A system and its workspace for a step from x (n, 3) with these pairs (P,), which press all, or in its iterations
    where `on` (N, P) says; where nothing `solves`, its matrix stays without them.
    """
    own = pairs.of_numbers(surface, x, numbers)
    if on is not None and system.colliders is not None:
        own = own._replace(on=on, turn=system.colliders.turn)
    if not (solves and len(numbers)) or system.method < IMPLICIT:
        return system._replace(contact=own), work
    A, moved, slot = sparse.joined(work.A, own.vertices, own.free > 0.0)
    springs = system.springs._replace(slot=moved[system.springs.slot])
    system = system._replace(contact=own._replace(slot=slot), springs=springs)
    return system, work._replace(A=A, solver=linear.workspace(A))


def fill(
    forms: Any, tolerance: float, work: implicit.Workspace, part: Rollout, check: Callable[[], None] = interrupts.check
) -> int:
    """Compute the steps of a part whose x[0], v and first are set; returns how many are good. `check` is called after
    each.
    """
    bare = part.bare()
    for t in range(part.steps):
        active, ended = step(forms, tolerance, work, bare, t)
        if ended != march.DONE:
            return t
        part.active_pairs[t] = active
        check()
    return int(part.steps)


def step(forms: Any, tolerance: float, work: implicit.Workspace, part: Rollout, t: int) -> tuple[ActivePairs, int]:
    """Take step t of a part; returns also how it ended."""
    system = forms.form(False, False)
    x, surface = part.x[t], surface_of(system, part.first + t, part.x[t])
    numbers = NOBODY if system.method == IMPLICIT else pairs.near(surface, x)
    if system.method < IMPLICIT:
        own, room = with_pairs(system, work, surface, x, numbers)
        return ActivePairs(numbers, None, None), march.run_explicit(own, part, t, t + 1)[1]
    if system.method == BDF2 and not len(numbers):
        ended = march.REFUSED
        for safe in (False, True):
            if ended == march.REFUSED:
                own, room = with_pairs(forms.form(False, safe), work, surface, x, numbers)
                with linear.served(room.A, room.solver):
                    ended = march.run_bdf2(*bdf2.forms(own), tolerance, room, part, t, t + 1)[1]
        if ended != march.GAINS and (ended != march.DONE or not len(pairs.colliding(surface, x, part.x[t + 1]))):
            return NO_PAIRS, ended
    two = system.method == BDF2
    if two and (part.smooth(t - 1) if t else part.ready):
        active, ended = pressed(forms, tolerance, work, part, t, surface, True)
        if ended == march.DONE and not hits(system, part, t, surface, numbers, active):
            return active, ended
    active, ended = pressed(forms, tolerance, work, part, t, surface, False)
    part.hit[t] = two and hits(system, part, t, surface, numbers, active)
    return active, ended


def pressed(
    forms: Any, tolerance: float, work: implicit.Workspace, part: Rollout, t: int, surface: pairs.Surface, second: bool,
    safe: bool = False,
) -> tuple[ActivePairs, int]:  # fmt: skip
    """Take step t of a part by the implicit method or, as a step of `second` order, by BDF2; that ends with CONTACTS
    where pairs would pass through each other, or the energy rises. `safe`: with the clamped system.
    """
    whole = forms.form(False, False)
    x, after, h = part.x[t], part.x[t + 1], whole.h
    march.begin(whole, part, t, work)
    part.euler[t], part.clamped[t] = not second, part.clamped[t] or safe
    system, attempt = bdf2.forms(forms.form(False, safe))[second], attempt_second if second else march.attempt
    first, pushing, rough = work.solution.copy(), NOBODY, tolerance < implicit.ROUGH
    middle, margin = x + h * first, 0.0  # a first guess is seldom so near that looking farther serves
    view, turn = pairs.around(surface, x, middle, margin), 0
    numbers = np.union1d(pairs.near(surface, x, view), pairs.colliding(surface, x, middle, view))
    changed = True
    while True:
        interrupts.check()
        if changed:
            on = np.zeros((part.w.shape[1], len(numbers)), bool)
            own, room = with_pairs(system, work, surface, x, numbers, on)
        changed, on[:] = False, False
        deep, left = contact.depths_along(own.contact, x, x + h * first)
        on[0] = (deep > 0.0) & (left > 0.0) | np.isin(numbers, pushing)
        with linear.served(room.A, room.solver):
            good = attempt(own, room, part, t, first, implicit.ROUGH if rough else tolerance, part.w[t])
        if not good:
            if part.clamped[t] or second:
                return NO_PAIRS, march.REFUSED
            system, part.clamped[t] = bdf2.forms(forms.form(False, True))[0], True
            contact.expect(whole.colliders, part, t)
            changed = True
            continue
        if not march.finite(after):
            return NO_PAIRS, march.FAILED
        turn += 1
        contact.load_active(whole.colliders, part, t)  # with which it may begin anew
        copy(part.w[t, part.used[t] - 1], first)
        pushing = numbers[on[part.used[t] - 1]]
        if np.linalg.norm(after - middle, axis=1).max() > margin:
            middle, margin = after.copy(), SEARCH_MARGIN * surface.thickness
            view = pairs.around(surface, x, middle, margin)
        new = np.setdiff1d(pairs.colliding(surface, x, after, view), numbers)
        if turn >= ROUNDS or not (rough or len(new)):
            break
        rough = rough and len(new) > 0 and turn < ROUNDS - 1
        numbers, changed = np.union1d(numbers, new), len(new) > 0
    whole, view = forms.at(part, t), np.union1d(view, numbers)
    joined = whole._replace(contact=own.contact, springs=whole.springs._replace(slot=own.springs.slot))
    end, left = Ending(joined, room, part, t, surface, view, second), 0.0
    end.known, end.bare = numbers, (whole, work)
    if second and (end.made is not None or end.gain()):
        return NO_PAIRS, march.CONTACTS
    if not second and whole.guarded and not (draws(whole.inputs, whole.applied) or surface.left > 0.0):
        left = end.end_well(tolerance)
        if left and not part.clamped[t]:
            return pressed(forms, tolerance, work, part, t, surface, False, safe=True)
    some = end.on.any(axis=0)
    # as compiled code is for arrays of one order: what NumPy picks out of columns has another
    return ActivePairs(end.known[some], np.ascontiguousarray(end.on[:, some]), end.made), march.DONE


class Ending:
    """How a step ends that is there: where pairs would pass through each other, they go on as one; if its energy rises,
    a step of implicit Euler may end otherwise.
    """

    def __init__(
        self, system: System, work: implicit.Workspace, part: Rollout, t: int, surface: pairs.Surface | None = None,
        numbers: Indices = NOBODY, second: bool = False,
    ) -> None:  # fmt: skip
        """Step t of a part, of `second` order or not, for the system that it was taken with and, for a cloth that
        touches itself, its pairs: all that are near before it, on its way or where it ends are among them.
        """
        self.system, self.forms, self.work, self.part, self.t = system, bdf2.forms(system), work, part, t
        self.surface, self.numbers, self.second = surface, numbers, second
        self.before: float | None = None  # the energy before the step, J, once it is asked for
        self.made: zones.Zones | None = None  # what moves as one
        self.known = NOBODY  # the numbers of the system's pairs
        self.bare = system, work  # without these
        self.separate()

    @property
    def w(self) -> Array:
        """The velocity after the step."""
        w: Array = self.part.velocity(self.t + 1)
        return w

    @property
    def on(self) -> Flags:
        """Which of the system's pairs press in each iteration (N, P)."""
        assert self.system.contact is not None
        return self.system.contact.on

    def separate(self) -> None:
        """Join what would pass through each other, at first of its pairs: writes the velocity and the positions after
        the step.
        """
        if self.surface is None:
            return
        x, after, w, known = self.part.x[self.t], self.part.x[self.t + 1], self.w, NOBODY
        found, hit = w.copy(), pairs.crossing(self.surface, x, after, self.numbers)
        while len(hit):
            interrupts.check()
            known = np.concatenate([known, hit])
            self.made = zones.of_pairs(pairs.of_numbers(self.surface, x, known).vertices, len(x), found)
            w[:] = found
            zones.join(self.made, self.system.vertex, w)
            march.arrive(self.system, x, w, after)
            hit = np.setdiff1d(pairs.colliding(self.surface, x, after), known)
            hit = pairs.crossing(self.surface, x, after, hit)

    def gain(self) -> float:
        """How much the energy rises, J, 0 where that is tolerated."""
        from clothfit.engine.work import energy_before, rise  # which few scenes need

        part, t, joined, given = self.part, self.t, self.w.copy(), 0.0
        if self.before is None:
            self.before = float(energy_before(self.forms[0], part, t)) + self.stored(part.x[t])
        if self.made is not None:
            given = zones.work(self.made, self.system.vertex, joined)
            self.w[self.made.member] = self.made.found
        more = rise(*self.forms, part, t, self.second, joined, self.before, self.work) - given
        self.w[:] = joined
        more += self.stored(part.x[t + 1])
        unknown = self.surface is None and collider_rows.some_grow(self.system.colliders)
        return more if guard.rises(self.before, self.before + more, 0.0) and not unknown else 0.0

    def stored(self, y: Array) -> float:
        """What pairs store at y (n, 3), J: those that are near there, on whichever side, as none has passed through."""
        if self.surface is None:
            return 0.0
        numbers = self.numbers
        if self.made is not None:  # others may be near
            numbers = np.union1d(numbers, pairs.near(self.surface, y))
        return float(contact.energy(pairs.of_numbers(self.surface, y, numbers), y))

    def end_well(self, tolerance: float) -> float:
        """Take more of Newton's iterations, or fewer, until the energy rises no more; where that does not help, halve a
        step that is clamped. What moves may press into a shorter step: the energy is about convex along it, so that of
        halves that gain more the next gains still more. Of all ends the one is kept that gains the least, which is
        returned, J.
        """
        best, fewer = self.tried(), int(self.part.used[self.t]) - 1
        while best[0] and self.go_on(tolerance):
            best = min(best, self.tried())
        while best[0] and fewer:
            self.end_with(fewer)
            best, fewer = min(best, self.tried()), fewer - 1
        if best[0] and not self.part.clamped[self.t]:
            return best[0]
        if self.part.used[self.t] != best[2]:
            self.end_with(best[2])
        last, still = best, guard.applies(self.system)
        for _ in range(guard.SHORTEST if still else SHORTEST):
            if not best[0] or (last[0] > best[0] and not still):
                break
            self.shorten(0.5)
            last = self.tried()
            best = min(best, last)
        if last[1] != best[1]:
            self.shorten(2.0 ** (last[1] - best[1]))
        self.part.guard_state[self.t + 1, guard.POWER] = best[3]
        return best[0]

    def tried(self) -> tuple[float, int, int, float]:
        """The gain of an end, J, how often it is halved, its iterations, and the power in it."""
        part, t = self.part, self.t
        return self.gain(), int(-np.log2(part.theta[t])), int(part.used[t]), float(part.guard_state[t + 1, guard.POWER])

    def go_on(self, tolerance: float) -> bool:
        """Take one more iteration, if there is room for one and Newton's method converges: its last iteration changed
        less than the one before (P. Deuflhard, Newton methods for nonlinear problems, 2004); whether that ended well.
        """
        self.split()
        last = np.diff(self.part.w[self.t, max(self.part.used[self.t] - 3, 0) : self.part.used[self.t]], axis=0)
        change = np.einsum("i,kij,kij->k", self.system.vertex.mass, last, last)
        good = (len(change) < 2 or change[1] < change[0]) and self.iterate(tolerance)
        self.end_with(int(self.part.used[self.t]))
        return good

    def iterate(self, tolerance: float) -> bool:
        """Take one more iteration, and again with the pairs that it ends in and did not know; whether it ended well."""
        part, t, used, surface = self.part, self.t, self.part.used[self.t], self.surface
        for left in range(ROUNDS, 0, -1):
            interrupts.check()
            part.used[t] = used
            if not march.go_on(self.forms[0], tolerance, self.work, part.bare(), t):
                return False
            if surface is None:
                return True
            view = pairs.around(surface, part.x[t], part.x[t + 1], 0.0)
            self.numbers = np.union1d(self.numbers, view)
            known = np.union1d(self.known, pairs.colliding(surface, part.x[t], part.x[t + 1], view))
            if left == 1 or len(known) == len(self.known):
                break
            on = np.zeros((part.w.shape[1], len(known)), bool)
            on[:, np.isin(known, self.known)] = self.on
            self.known = known
            self.system, self.work = with_pairs(*self.bare, surface, part.x[t], known, on)
            self.forms = bdf2.forms(self.system)
        return True

    def end_with(self, used: int) -> None:
        """End after so many iterations."""
        self.split()
        march.end_after(self.forms[0], self.part.bare(), self.t, used, self.work)
        self.separate()

    def split(self) -> None:
        """Give what moves as one its own velocities back."""
        if self.made is not None:
            self.w[self.made.member], self.made = self.made.found, None

    def shorten(self, theta: float) -> None:
        """Take a part of the step."""
        self.part.theta[self.t] *= theta
        self.w[:] *= theta
        if self.made is not None:
            self.made.found[:] *= theta
        march.arrive(self.system, self.part.x[self.t], self.w, self.part.x[self.t + 1])


def mend(forms: Any, tolerance: float, work: implicit.Workspace, part: Rollout, t: int) -> None:
    """Take more iterations of Euler step t of a part, after which the energy is higher than what moves has given it, or
    take it with the clamped system, and shorten that; for a cloth that does not touch itself.
    """
    if Ending(forms.at(part, t), work, part, t).end_well(tolerance) and not part.clamped[t]:
        part.clamped[t] = True
        own = bdf2.forms(forms.at(part, t))[0]
        contact.expect(own.colliders, part, t)
        march.attempt(own, work, part, t, part.velocity(t).copy(), tolerance, part.w[t])  # which succeeds
        Ending(forms.at(part, t), work, part, t).end_well(tolerance)


def hits(system: System, part: Rollout, t: int, surface: pairs.Surface, near: Indices, active: ActivePairs) -> bool:
    """Whether step t of a part stops much of the kinetic energy at colliders or between pairs that were not near."""
    x, v = part.x[t], part.velocity(t)
    new = pairs.of_numbers(surface, x, np.setdiff1d(active.numbers, near))
    stopped = rows.stopped(new, system.vertex.mass, x, v) > march.HIT * guard.moving(system.vertex, v)[0]
    return bool(stopped or march.hits(system.colliders, system.vertex, x, v, part.x[t + 1]))


class Taken(NamedTuple):
    """A step that was taken, as its derivatives need it."""

    system: System  # with its pairs
    work: implicit.Workspace  # for them
    part: Rollout  # this step alone, bare, with its velocities as they were before zones joined them
    zones: zones.Zones | None


def taken(system: System, work: implicit.Workspace, part: Rollout, t: int, solves: bool = True) -> Taken:
    """Step t of a part, for the system that it was taken with but for its pairs; `solves` as for `with_pairs`."""
    active, one = part.active_pairs[t], part.part(t, t + 1).bare()
    surface = surface_of(system, part.first + t, part.x[t])
    own, room = with_pairs(system, work, surface, part.x[t], active.numbers, active.on, solves)
    if active.zones is not None:
        w = one.w.copy()
        w[0, one.used[0] - 1, active.zones.member] = active.zones.found
        one = one._replace(w=w)
    return Taken(own, room, one, active.zones)


@kernel(nogil=True)
def attempt_second(system, work, part, t, first, tolerance, iterates):
    """What `march.attempt` does for a BDF2 step, of which `system` is the inner one."""
    x_before, v_before = states.state_before(part, t)
    used, iterations, direct, _, _, _ = bdf2.step(
        system, part.x[t], states.velocity(part, t), x_before, v_before, first, tolerance, work, iterates, part.x[t + 1]
    )
    contact.save_active(system.colliders, part, t)
    march.count(part, t, used, iterations, direct)
    place_pins(system.inputs, system, part.x[t + 1])
    return used > 0
