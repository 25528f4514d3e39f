"""Derivatives of a whole motion: the reverse sweep (gradient) and the forward sweep (tangent).

Both walk through a motion step by step and know no physics: a step's transpose and tangent do the work. For a cost
G(x₁ … x_T) the reverse sweep gives its gradient by every mass and stiffness, and by the other kinds of `Elements` that
are asked for, in about the time of one more simulation; the forward sweep gives the change of all positions along one
direction in them. Each is the transpose of the other.
"""

from __future__ import annotations

from collections.abc import Callable, Collection
from typing import TypeAlias

import numpy as np

from clothfit.base import interrupts
from clothfit.base.arrays import NO_NUMBERS, Array, Elements
from clothfit.engine.forces import contact
from clothfit.engine.inputs import tables
from clothfit.engine.inputs.tables import set_direction, set_inputs, share_gradient, with_constant
from clothfit.engine.rollout import Rollout, Taken, forms, work_of
from clothfit.engine.solve import guess, linear
from clothfit.engine.step import bdf2, explicit, implicit
from clothfit.engine.step.states import state_before, velocities, velocity
from clothfit.engine.system import BDF2, IMPLICIT, System, zeros
from clothfit.engine.tape import Tape
from clothfit.kernels.kernel import kernel
from clothfit.kernels.vectors import add, copy, hold_fixed
from clothfit.kernels.work import counted

TrajectoryMemory: TypeAlias = Rollout | Tape
"""A finished motion: all of it in memory, or a tape that computes it again chunk by chunk."""

Observer: TypeAlias = Callable[[Rollout], object]
"""What takes a motion chunk by chunk while it is computed."""

CostDerivative: TypeAlias = Callable[[Rollout], Array]
"""∂G/∂x (T + 1, n, 3) of a chunk of T steps, asked for from the last chunk to the first; its entry for the state before
the chunk does not count, as it belongs to the chunk before."""

Sweeping: TypeAlias = Callable[..., None]


def gradient(
    system: System,
    memory: TrajectoryMemory,
    by_position: Array | CostDerivative,
    tolerance: float,
    kinds: Collection[str] = (),
    sweep: Sweeping | None = None,
) -> Elements:
    """The gradient of G from by_position = ∂G/∂x (T + 1, n, 3), whole or chunk by chunk, along a finished motion.

    By masses (n,), stiffnesses (S,) and the `kinds`, names of fields of Elements; the other fields stay empty. `sweep`
    takes the place of the exact one back through some steps (`benchmarks/approximate.py`).
    """
    derivative_of = by_position if callable(by_position) else whole(by_position)
    wanted = {*kinds, "wind"} if "gusts" in kinds else kinds  # the one by the keys is that by the wind, step by step
    grad, taken = zeros(system, wanted), Taken(system)
    work = memory.work if isinstance(memory, Tape) else implicit.workspace(system)
    work = work._replace(solution=np.zeros_like(system.x0))  # λ, from part to part; a tape has solutions of its own
    if system.inputs is not None:
        system.inputs.counted[:] = 0.0
    tables.forget(system.inputs)
    contact.forget(system.colliders)
    state, at_start = states(system), np.zeros_like(system.x0)
    sweep = sweep or by_method(system, sweep_explicit_back, sweep_back, sweep_bdf2_back)
    for segment in memory.backward():
        for chunk in reversed(segment.parts()):
            after, by_position = memory.steps - chunk.first, derivative_of(chunk)
            at_start = by_position[0]
            if chunk.active_pairs is not None:
                from clothfit.derivative import contact as touching  # which few scenes need

                touching.back(sweep, taken, chunk, by_position, tolerance, work, after, state, grad)
            else:
                with linear.served(work.A, work.solver):
                    for begin, end in reversed(alike(chunk)):
                        own = forms(taken.at(chunk, begin))
                        sweep(*own, chunk, by_position, begin, end, tolerance, work, after - end, *state, grad)
            counted.add(work_of(chunk))
            interrupts.check()
    tables.pull_start(system.inputs, system.h, state[0] + at_start, state[1], grad)
    if "velocity" in kinds:
        hold_fixed(system.vertex.free, state[1])
        grad = grad._replace(velocity=state[1])
    return grad if "wind" in kinds else grad._replace(wind=NO_NUMBERS)


def by_method(system: System, explicit: Sweeping, implicit: Sweeping, bdf2: Sweeping) -> Sweeping:
    """The one of three sweeps that the method of a system has."""
    return bdf2 if system.method == BDF2 else implicit if system.method == IMPLICIT else explicit


def states(system: System) -> tuple[Array, ...]:
    """What a sweep carries, 0 at its start, by or of the position and the velocity (n, 3) of a state: for BDF2 of two.
    """
    return tuple(np.zeros_like(system.x0) for _ in range(4 if system.method == BDF2 else 2))


def whole(by_position: Array) -> CostDerivative:
    """A derivative that is in memory as a whole, given chunk by chunk."""
    array = np.ascontiguousarray(by_position)
    return lambda chunk: array[chunk.first : chunk.first + chunk.steps + 1]


def tangent(
    system: System, memory: TrajectoryMemory, direction: Elements, tolerance: float,
    through: Sweeping | None = None,
) -> Array:  # fmt: skip
    """Change of all positions (T + 1, n, 3) for the change `direction`; its empty fields do not change. `through` takes
    the place of the exact sweep through some steps (`benchmarks/approximate.py`).
    """
    change = np.zeros((memory.steps + 1, *system.x0.shape))
    sweep = Sweep(system, direction, tolerance)
    sweep.sweep = through or sweep.sweep
    change[0] = sweep.state[0]
    for segment in memory.forward():
        for chunk in segment.parts():
            change[chunk.first + 1 : chunk.first + 1 + chunk.steps] = sweep.through(chunk)
    return change


class Sweep:
    """A forward sweep along one direction, and how far it has come."""

    def __init__(self, system: System, direction: Elements, tolerance: float) -> None:
        self.system, self.direction, self.tolerance = system, with_constant(direction), tolerance
        self.work, self.taken = implicit.workspace(system), Taken(system)
        self.state, self.begins = states(system), first_step(system, direction)
        self.of_load = 0.0 if system.colliders is None else np.zeros_like(system.colliders.of_load)
        self.sweep = by_method(system, sweep_explicit_forward, sweep_forward, sweep_bdf2_forward)
        if len(direction.velocity) > 0:
            copy(direction.velocity, self.state[1])
            hold_fixed(system.vertex.free, self.state[1])
        tables.push_start(system.inputs, system.h, direction, self.state[0], self.state[1])

    def through(self, chunk: Rollout) -> Array:
        """Change of the positions (T, n, 3) after each step of the next chunk of the motion."""
        change = np.zeros_like(chunk.x[1:])
        skipped = self.begins - chunk.first
        if skipped >= chunk.steps:
            return change
        given, colliders = (self.direction, self.tolerance, self.work), self.system.colliders
        if colliders is not None:  # several sweeps may go through the same chunk
            colliders.of_load[:] = self.of_load
        if chunk.active_pairs is not None:
            from clothfit.derivative import contact as touching  # which few scenes need

            touching.forward(self.sweep, self.taken, chunk, *given, self.state, change)
        else:
            with linear.served(self.work.A, self.work.solver):
                for begin, end in alike(chunk):
                    if end > skipped:
                        own, steps = forms(self.taken.at(chunk, begin)), (max(begin, skipped), end)
                        self.sweep(*own, chunk, *steps, *given, *self.state, change)
        if colliders is not None:
            self.of_load = colliders.of_load.copy()
        counted.add(work_of(chunk))
        interrupts.check()
        return change


def first_step(system: System, direction: Elements) -> int:
    """The first step that a direction changes: a later one where it is of keys of the wind that are not reached before.
    """
    inputs, keys = system.inputs, direction.gusts
    if inputs is None or not len(keys) or any(np.any(field) for field in direction._replace(gusts=NO_NUMBERS)):
        return 0
    acting = np.flatnonzero(inputs.share @ np.abs(keys).sum(axis=1))
    return max(int(acting[0]) - inputs.lead, 0) if len(acting) else len(inputs.share)


def alike(chunk: Rollout) -> list[tuple[int, int]]:
    """Split the steps of a chunk, from first to below last, where the system that they were taken with changes."""
    changes = (np.flatnonzero(np.diff(chunk.clamped) | np.diff(chunk.predicted)) + 1).tolist()
    return list(zip([0, *changes], [*changes, chunk.steps], strict=True)) if chunk.steps else []


@kernel
def sweep_back(system, chunk, by_position, begin, end, tolerance, work, before, x_bar, v_bar, grad):
    """Carry x_bar, v_bar (n, 3), the gradient by the state after the steps `begin` to below `end` of a chunk, to before
    them; `before` steps have been swept.
    """
    x, used, theta = chunk.x, chunk.used, chunk.theta
    for t in range(end - 1, begin - 1, -1):
        add(1.0, by_position[t + 1], x_bar)
        v, w = velocity(chunk, t), velocities(chunk, t)
        guess.next_guess(work.past, before + end - 1 - t, work.solution)
        set_inputs(system.inputs, system, chunk.first + t)
        contact.load_active(system.colliders, chunk, t)
        implicit.pullback(system, x[t], v, w, used[t], theta[t], tolerance, work, x_bar, v_bar, grad)
        share_gradient(system.inputs, system, t + chunk.first, grad)


@kernel
def sweep_forward(system, chunk, begin, end, direction, tolerance, work, dx, dv, change):
    """Carry dx, dv (n, 3), the change of the state before steps `begin` to below `end` of a chunk, to after them; keep
    all dx in change (T, n, 3).
    """
    x, used, theta = chunk.x, chunk.used, chunk.theta
    for t in range(begin, end):
        v, w = velocity(chunk, t), velocities(chunk, t)
        guess.next_guess(work.past, chunk.first + t, work.solution)
        set_inputs(system.inputs, system, chunk.first + t)
        contact.load_active(system.colliders, chunk, t)
        set_direction(system.inputs, system, chunk.first + t, direction)
        implicit.pushforward(system, x[t], v, w, used[t], theta[t], tolerance, work, dx, dv, direction)
        copy(dx, change[t])


@kernel
def sweep_explicit_back(system, chunk, by_position, begin, end, tolerance, work, before, x_bar, v_bar, grad):
    """What `sweep_back` does, for the explicit methods."""
    for t in range(end - 1, begin - 1, -1):
        add(1.0, by_position[t + 1], x_bar)
        set_inputs(system.inputs, system, chunk.first + t)
        contact.load_active(system.colliders, chunk, t)
        explicit.pullback(system, chunk.x[t], velocity(chunk, t), chunk.w[t, 0], work, x_bar, v_bar, grad)
        share_gradient(system.inputs, system, t + chunk.first, grad)


@kernel
def sweep_explicit_forward(system, chunk, begin, end, direction, tolerance, work, dx, dv, change):
    """What `sweep_forward` does, for the explicit methods."""
    for t in range(begin, end):
        set_inputs(system.inputs, system, chunk.first + t)
        contact.load_active(system.colliders, chunk, t)
        set_direction(system.inputs, system, chunk.first + t, direction)
        explicit.pushforward(system, chunk.x[t], velocity(chunk, t), chunk.w[t, 0], work, dx, dv, direction)
        copy(dx, change[t])


@kernel
def sweep_bdf2_back(
    euler, inner, chunk, by_position, begin, end, tolerance, work, before, x_bar, v_bar, x_rest, v_rest, grad
):
    """What `sweep_back` does, for the two `bdf2.forms`; x_rest, v_rest is what the steps that have been swept add to
    the gradient by the state before them.
    """
    x, used, theta = chunk.x, chunk.used, chunk.theta
    for t in range(end - 1, begin - 1, -1):
        add(1.0, by_position[t + 1], x_bar)
        v, w, (x_before, v_before) = velocity(chunk, t), velocities(chunk, t), state_before(chunk, t)
        guess.next_guess(work.past, before + end - 1 - t, work.solution)
        set_inputs(euler.inputs, euler, chunk.first + t)
        contact.load_active(euler.colliders, chunk, t)
        if chunk.euler[t]:
            implicit.pullback(euler, x[t], v, w, used[t], theta[t], tolerance, work, x_bar, v_bar, grad)
            for bar, rest in ((x_bar, x_rest), (v_bar, v_rest)):
                add(1.0, rest, bar)
                rest[:] = 0.0
        else:
            state = x_bar, v_bar, x_rest, v_rest
            bdf2.pullback(inner, x[t], v, x_before, v_before, w, used[t], tolerance, work, *state, grad)
        share_gradient(euler.inputs, euler, t + chunk.first, grad)


@kernel
def sweep_bdf2_forward(
    euler, inner, chunk, begin, end, direction, tolerance, work, dx, dv, dx_before, dv_before, change
):
    """What `sweep_forward` does, for the two `bdf2.forms`; dx_before, dv_before is the change one step earlier."""
    x, used, theta = chunk.x, chunk.used, chunk.theta
    for t in range(begin, end):
        v, w, (x_before, v_before) = velocity(chunk, t), velocities(chunk, t), state_before(chunk, t)
        guess.next_guess(work.past, chunk.first + t, work.solution)
        set_inputs(euler.inputs, euler, chunk.first + t)
        contact.load_active(euler.colliders, chunk, t)
        set_direction(euler.inputs, euler, chunk.first + t, direction)
        if chunk.euler[t]:
            copy(dx, dx_before)
            copy(dv, dv_before)
            implicit.pushforward(euler, x[t], v, w, used[t], theta[t], tolerance, work, dx, dv, direction)
        else:
            state = dx, dv, dx_before, dv_before
            bdf2.pushforward(inner, x[t], v, x_before, v_before, w, used[t], tolerance, work, *state, direction)
        copy(dx, change[t])
