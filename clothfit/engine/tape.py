"""A whole motion part by part, forwards and backwards, in as little memory as a plan allows.

One part is held at a time. Snapshots at the ends of some parts let the motion be computed again from there. A step
depends on nothing but its state and the first guess of its solve, and a snapshot has both, so the second time gives the
same to the last bit.

With one level of snapshots every step is computed twice, with L levels at most L + 1 times, and m^L parts need only L m
snapshots. Reference: A. Griewank, Achieving logarithmic growth of temporal and spatial complexity in reverse automatic
differentiation, Optimization Methods and Software 1, 1992.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import NamedTuple

from clothfit.base import memory
from clothfit.base.arrays import Array
from clothfit.base.errors import InvalidInput
from clothfit.base.memory import human
from clothfit.engine import prescribed
from clothfit.engine.fallbacks import NO_FALLBACKS
from clothfit.engine.inputs.tables import check_steps
from clothfit.engine.rollout import STRETCH, Rollout, empty, fill, iterations_of, state_bytes, work_of
from clothfit.engine.solve import guess
from clothfit.engine.step import guard, implicit
from clothfit.engine.system import BDF2, System
from clothfit.kernels.work import counted

SHORTEST_PART = 16
"""Steps of a part, at least, of a motion that only goes forwards."""


LIVE = 3
"""Snapshots in use while steps are computed, beside those that are kept."""


class Plan(NamedTuple):
    """Which states of a motion are kept."""

    length: int  # steps whose states are held at a time
    strides: tuple[int, ...] = ()  # steps between snapshots, from coarse to fine; the last is `length`
    snapshots: int | None = None  # the most at a time; None: every state is kept, or none is needed again


class Snapshot(NamedTuple):
    """All that the later steps depend on: whatever one step hands to the next belongs here."""

    step: int
    x: Array  # (n, 3), m
    v: Array  # (n, 3), m/s
    x_before: Array  # (n, 3), m, one step before; any, at the start
    v_before: Array  # (n, 3), m/s
    ready: bool  # whether the next step can be a BDF2 step
    guard_state: Array  # (2 + R,), of `Rollout.guard_state`
    past: guess.Past  # solutions of the last steps, for the first guesses


class Held(NamedTuple):
    """The part that is in memory."""

    begin: int
    end: int
    part: Rollout
    after: Snapshot


class Tape:
    """T steps of one cloth from its start; linear systems are solved to `tolerance`, relative."""

    def __init__(
        self, system: System, steps: int, tolerance: float, plan: Plan | None = None,
        forms: prescribed.Forms | None = None, work: implicit.Workspace | None = None,
    ) -> None:  # fmt: skip
        """Without a plan the motion only goes forwards. Tapes of one pattern may share the memory `work`, which no step
        leaves anything in for the next. Raises InvalidInput where its parts do not fit into memory.
        """
        check_steps(system.inputs, steps)
        self.system, self.steps, self.tolerance, self.forms = system, steps, tolerance, forms
        iterations = iterations_of(system)
        self.plan = plan or Plan(min(max(steps, 1), max(SHORTEST_PART, STRETCH // (len(system.x0) * iterations))))
        needed = self.plan.length * state_bytes(system)
        free = memory.missing(needed)
        if free is not None:
            raise InvalidInput(
                f"{self.plan.length} steps of {len(system.x0)} vertices, with {iterations} velocities each, take "
                f"{human(needed)} of memory, {human(free)} are free; use fewer iterations (forwardSubSteps)"
            )
        self.good = 0  # steps known to be good; after `forward` all of them, unless the motion diverged
        self.fallbacks = NO_FALLBACKS  # those of the good steps, after `forward`
        self.fault: Array | None = None  # (n, 3), m, the positions after the first step that is not good
        self.fault_velocity: Array = system.v0  # (n, 3), m/s, the velocities there
        self.work = work or implicit.workspace(system)
        self._room: Rollout | None = None
        self._held: Held | None = None
        x, v = system.x0, system.v0
        self._kept = {0: Snapshot(0, x, v, x, v, False, guard.start(system), self.work.past)}

    @property
    def shape(self) -> Array:
        """The positions (n, 3), m, after the last step of the part in memory."""
        assert self._held is not None
        return self._held.after.x

    def forward(self) -> Iterator[Rollout]:
        """All parts from the start; each is valid until the next is taken. Where the motion diverges, the last part
        ends before the step that is not good.
        """
        at = self._kept[0]
        self.fallbacks = NO_FALLBACKS
        for begin in range(0, self.steps or 1, self.plan.length):
            end = min(begin + self.plan.length, self.steps)
            part, at = self._part(at, end)
            self.fallbacks = self.fallbacks.with_those_of(part, self.system.method == BDF2)
            if self.plan.strides and end < self.steps and end % self.plan.strides[0] == 0:
                self._kept[end] = at
            yield part
            if part.steps < end - begin:
                return

    def backward(self) -> Iterator[Rollout]:
        """All parts of a good motion from the end, after `forward`."""
        yield from self._back(0, self.steps, 0)

    def _back(self, begin: int, end: int, level: int) -> Iterator[Rollout]:
        """The parts between two steps, the last first; there are snapshots at each stride of that level."""
        stride, finer = self.plan.strides[level], self.plan.strides[level + 1 :]
        for first in reversed(range(begin, end, stride)):
            last = min(first + stride, end)
            if not finer:
                yield self._part(self._kept[first], last)[0]
                continue
            marks = range(first + finer[0], last, finer[0])
            self._mark(first, marks)
            yield from self._back(first, last, level + 1)
            for mark in marks:
                del self._kept[mark]

    def _mark(self, first: int, marks: range) -> None:
        """Keep snapshots at the steps `marks`, from the one at `first` on."""
        at = self._kept[first]
        for end in range(first + self.plan.length, max(marks, default=first) + 1, self.plan.length):
            _, at = self._part(at, end)
            if end in marks:
                self._kept[end] = at

    def _part(self, at: Snapshot, end: int) -> tuple[Rollout, Snapshot]:
        """The steps from a snapshot to below `end`, and the snapshot there."""
        held = self._held
        if held is None or (held.begin, held.end) != (at.step, end):
            held = self._held = self._computed(at, end)
        return held.part, held.after

    def _computed(self, at: Snapshot, end: int) -> Held:
        if self._room is None:
            self._room = empty(self.system, self.plan.length)
        part = self._room.part(0, end - at.step)._replace(v=at.v, x_before=at.x_before, v_before=at.v_before)
        part = part._replace(ready=at.ready, first=at.step)
        part.x[0], part.guard_state[0] = at.x, at.guard_state
        self._held = None  # an interrupt may come
        work = self.work._replace(past=guess.Past(*(kept.copy() for kept in at.past)))
        if self.forms is None:
            good = fill(self.system, self.tolerance, work, part)
        else:
            good = prescribed.fill(self.system, self.forms, self.tolerance, work, part)
        counted.add(work_of(part))
        self.good = max(self.good, at.step + good)
        if good < part.steps:
            self.fault, self.fault_velocity = part.x[good + 1].copy(), part.velocity(good + 1).copy()
            part = part.part(0, good)
        last = part.part(good, good)
        x, v = last.x[0].copy(), last.v.copy()
        two = self.system.method == BDF2
        x_before, v_before = (last.x_before.copy(), last.v_before.copy()) if two else (x, v)
        after = Snapshot(end, x, v, x_before, v_before, last.ready, last.guard_state[0].copy(), work.past)
        return Held(at.step, end, part, after)


def plan_for(steps: int, state: int, snapshot: int, most: float) -> Plan | None:
    """The plan that keeps `steps` states of `state` bytes within `most` bytes and computes the fewest steps again; a
    snapshot has `snapshot` bytes. None where no plan is small enough.
    """
    if steps * state <= most:
        return Plan(max(steps, 1), (max(steps, 1),))
    return next((found for found in plans(steps) if plan_bytes(found, state, snapshot) <= most), None)


def plans(steps: int) -> Iterator[Plan]:
    """All plans with snapshots, those that compute the fewest steps again first."""
    for levels in range(1, max(steps - 1, 1).bit_length() + 1):
        for parts in range(2, steps + 1):
            length = -(-steps // parts**levels)
            yield Plan(length, tuple(length * parts**i for i in reversed(range(levels))), levels * parts)
            if length == 1:
                break


def plan_bytes(found: Plan, state: int, snapshot: int) -> int:
    """Bytes that a plan holds."""
    return found.length * state + (0 if found.snapshots is None else (LIVE + found.snapshots) * snapshot)


def least_bytes(steps: int, state: int, snapshot: int) -> int:
    """The fewest bytes with which a motion of this many steps can be swept back."""
    return min([steps * state, *(plan_bytes(found, state, snapshot) for found in plans(steps))])
