"""Simulating: a scene → the motion of its cloths; and the forces of a feedback in a reduced basis (`scene.forces`).

Before each step the feedback looks at the state and adds its answer to the planned forces, explicitly. What it does is
found by one simulation, and is then an ordinary table of forces: a second one with that table takes the same steps to
the last bit, and what is computed from a motion under forces needs to know nothing of feedbacks.
"""

from __future__ import annotations

from collections.abc import Collection
from dataclasses import replace

import numpy as np

from clothfit.base import interrupts
from clothfit.base.arrays import Array
from clothfit.base.errors import InvalidInput
from clothfit.base.limits import checked_tolerance
from clothfit.base.memory import check_memory
from clothfit.base.notebook import belongs
from clothfit.engine import rollout
from clothfit.engine.fallbacks import NO_FALLBACKS
from clothfit.engine.step import bdf2, implicit
from clothfit.engine.system import BDF2, IMPLICIT, System, build
from clothfit.engine.tape import Tape
from clothfit.engine.work import explicit_power, power
from clothfit.motion.divergence import Fault, last_states, of_object, outcome, with_bad
from clothfit.motion.motion import Motion, Steps, in_groups, in_scene
from clothfit.scene.forces import Forces, Regulator
from clothfit.scene.scene import Scene, check_is_scene


def simulate(scene: Scene, frames: int | None = None, tolerance: float | None = None) -> Motion:
    """Simulate a scene with the steps of the editor's engine; the motion has a frame after every step.

    `frames` counts the initial state (default: the scene's); `tolerance` is that of the linear solver, relative
    (default: the scene's). Raises Diverged, whose `motion` has the good frames, when a position is no longer finite;
    InvalidInput when an argument is impossible or the motion would not fit into the free memory.
    """
    check_is_scene(scene)
    return simulate_cloths(scene, range(len(scene.cloths)), frames, tolerance)


def simulate_cloths(
    scene: Scene, cloths: Collection[int], frames: int | None = None, tolerance: float | None = None
) -> Motion:
    """Simulate some of the cloths of a scene, as `simulate` does; the others count as not observed."""
    accuracy = checked_tolerance(tolerance, scene.tolerance)
    count = scene.frames if frames is None else frames
    if count < 1:
        raise InvalidInput(f"frames must be at least 1 (the initial state); {count} was given")
    counts = scene.vertex_counts
    check_memory(count, sum(counts), 0)
    if not scene.delta * (count - 1) < np.inf:
        raise InvalidInput(f"{scene.name}: delta: {count - 1} steps of {scene.delta:g} s do not end at a finite time")
    positions = np.full((count, sum(counts), 3), np.nan)
    scene = answered(scene, count - 1, accuracy)
    motion = Motion(positions, scene.delta * np.arange(count, dtype=np.float64), counts, None, scene.name)
    remedies, good, fault = NO_FALLBACKS, count - 1, None
    work, euler = np.zeros((count, 2)), np.zeros((len(scene.groups), count), bool)
    groups = in_groups(motion, scene)
    for index in sorted({scene.together(cloth)[0] for cloth in cloths}):
        system = build(scene, index, steps=count - 1)
        tape, last, work_done = Tape(system, count - 1, accuracy), None, WorkDone(system)
        for part in tape.forward():
            groups.of(index)[part.first : part.first + part.steps + 1] = part.x
            after = slice(part.first + 1, part.first + part.steps + 1)
            euler[scene.groups.index(scene.together(index)), after] = part.euler & (system.method == BDF2)
            work[after] += work_done.of(part)
            last = last_states(part, last)
        remedies = remedies.together(tape.fallbacks)
        if tape.fault is not None and last is not None and tape.good < good:
            good, fault = tape.good, of_object(scene, Fault(index, with_bad(last, tape.fault, tape.fault_velocity)))
    moved = np.repeat([index in cloths for index in range(len(counts))], counts)
    observed = None if moved.all() else np.broadcast_to(moved, (good + 1, len(moved))).copy()
    positions, times = positions[: good + 1], motion.times[: good + 1]
    motion = replace(motion, positions=positions, times=times, observed=observed, remedies=remedies)
    motion = in_scene(motion, scene)
    given, rubbed = work[: good + 1].T
    motion = replace(motion, steps=Steps(motion.positions, given, rubbed, euler[:, : good + 1]))
    belongs(motion, scene)
    if fault is not None:
        raise outcome(scene, motion, fault)
    return motion


class WorkDone:
    """The work of what moves, and what friction takes, in the steps of one cloth, which come part by part."""

    def __init__(self, system: System) -> None:
        self.system, self.taken, self.work = system, rollout.Taken(system), implicit.workspace(system)
        self.power = np.zeros(2)

    @property
    def needed(self) -> bool:
        """Whether anything moves, or rubs."""
        own, touched, surface = self.system.inputs, self.system.colliders, self.system.surface
        return own is not None and bool(
            len(own.path) or len(own.centre) or len(own.poses.first) or (surface is not None and surface.friction)
            or (touched is not None and (len(touched.begin) or touched.friction.any()))
        )  # fmt: skip

    def of(self, part: rollout.Rollout) -> Array:
        """The work of both (T, 2), J, in each step of the next part."""
        work = np.zeros((part.steps, 2))
        for t in range(part.steps if self.needed else 0):
            own, room, one, k, merged = self.taken.at(part, t), self.work, part.bare(), t, None
            if part.active_pairs is not None:
                from clothfit.engine import contact_steps  # which few scenes need
                from clothfit.engine.forces.selfcontact import zones

                own, room, one, merged = contact_steps.taken(own, room, part, t, solves=False)
                k = 0
            if own.method < IMPLICIT:
                work[t] = own.h * np.array(explicit_power(own, one, k, room))
                continue
            euler, inner = bdf2.forms(own) if own.method == BDF2 else (own, own)
            now = np.array(power(euler, inner, one, k, own.method == BDF2 and not part.euler[t], room))
            if own.method == BDF2 and not part.euler[t]:
                now = (2.0 * now + self.power) / 3.0
            work[t], self.power = own.h * now, now
            if merged is not None:
                work[t, 0] += zones.work(merged, own.vertex, part.w[t, part.used[t] - 1])
        return work


def answered(scene: Scene, steps: int, tolerance: float) -> Scene:
    """The scene with the forces that its feedback makes of the planned ones in so many steps; the same scene where it
    has no such feedback. Springs of a feedback stay. Raises InvalidInput where it does not fit the scene.
    """
    plan = scene.forces
    if plan is None or not plan.pulls or plan.regulator is None:
        return scene
    if len(plan.regulator.gains) != len(scene.cloths):
        have = len(plan.regulator.gains)
        raise InvalidInput(f"{plan.name}: gains are for {have} objects; the scene has {len(scene.cloths)}")
    if scene.frame:
        raise InvalidInput(f"{scene.name}: frame: a feedback needs axes that do not move")
    times = scene.delta * np.arange(steps, dtype=float)
    values, gain, places = plan.at(times)
    springs = replace(plan, times=times, values=values, gain=gain, places=places, regulator=None)
    found = values.copy()
    for index in range(len(scene.cloths)):
        if np.any(plan.regulator.gains[index]):
            found[:, scene.vertices(index)] = acting(scene, index, plan, plan.regulator, springs, tolerance)
    return scene.with_forces(replace(springs, values=found))


def acting(scene: Scene, index: int, plan: Forces, feedback: Regulator, springs: Forces, tolerance: float) -> Array:
    """The forces (T, n, 3), N, on one cloth; planned ones from where its motion diverges."""
    part, steps = scene.vertices(index), len(springs.times)
    system = build(scene.with_forces(springs), index, steps=steps)
    assert system.inputs is not None
    table, (rows, acts) = system.inputs.force, plan.rows(springs.times)
    where = places(plan, feedback.reference[index], springs.times)
    whole, work = rollout.empty(system, steps), implicit.workspace(system)
    for t in range(steps):
        one = whole.part(t, t + 1)
        if acts[t]:
            more = feedback.answer(index, part, rows[t], where[t], one.x[0], one.v)
            table[t] = limited(table[t] + more, feedback.bound)
        if rollout.fill(system, tolerance, work, one) < 1:
            break
        interrupts.check()
    return table[:steps].copy()


def places(plan: Forces, reference: Array, times: Array) -> Array:
    """Where the coordinates should be at times (T,), s, between those at the beginning of rows, (T, 6 k)."""
    row, _ = plan.rows(times)
    after = np.minimum(row + 1, len(reference) - 1)
    length = np.maximum(plan.times[after] - plan.times[row], 1e-300)
    share = np.clip((times - plan.times[row]) / length, 0.0, 1.0)
    share[share < 1e-6] = 0.0  # a step that begins with a row, but for rounding
    return np.asarray(reference[row] + share[:, None] * (reference[after] - reference[row]))


def limited(u: Array, most: float) -> Array:
    """Forces (n, 3), none above `most`, N."""
    size = np.sqrt((u * u).sum(axis=1, keepdims=True))
    return np.asarray(np.where(size > most, u * (most / np.maximum(size, 1e-300)), u)) if np.isfinite(most) else u
