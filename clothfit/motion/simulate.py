"""Simulating: a scene → the motion of its cloths."""

from __future__ import annotations

from collections.abc import Collection
from dataclasses import replace

import numpy as np

from clothfit.base.errors import InvalidInput
from clothfit.base.limits import checked_tolerance
from clothfit.base.memory import check_memory
from clothfit.base.notebook import belongs
from clothfit.engine.fallbacks import NO_FALLBACKS
from clothfit.engine.system import build
from clothfit.engine.tape import Tape
from clothfit.motion.divergence import Fault, last_states, outcome, with_bad
from clothfit.motion.motion import Motion
from clothfit.motion.world import in_scene
from clothfit.scene.scene import Scene, check_is_scene


def simulate(scene: Scene, frames: int | None = None, tolerance: float | None = None) -> Motion:
    """Simulate a scene with the steps of the editor's engine; the motion has a frame after every step.

    `frames` counts the initial state (default: the scene's); `tolerance` is that of the linear solver, relative
    (default: the scene's). Raises Diverged, whose `motion` has the good frames, when a position is no longer finite;
    InvalidInput when an argument is impossible or the motion would not fit into the free memory.
    """
    check_is_scene(scene)
    return simulate_cloths(scene, range(len(scene.cloths)), frames, tolerance)


def with_feedback(scene: Scene, steps: int, tolerance: float) -> Scene:
    """The scene with the forces of its feedback in so many steps, where it has one that acts on the state of steps."""
    if scene.forces is None or scene.forces.regulator is None:
        return scene
    from clothfit.motion.feedback import answered  # which few scenes need

    return answered(scene, steps, tolerance)


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
    scene = with_feedback(scene, count - 1, accuracy)
    motion = Motion(positions, scene.delta * np.arange(count, dtype=np.float64), counts, None, scene.name)
    remedies, good, fault = NO_FALLBACKS, count - 1, None
    for index in cloths:
        tape, last = Tape(build(scene, index, steps=count - 1), count - 1, accuracy), None
        for part in tape.forward():
            motion.of(index)[part.first : part.first + part.steps + 1] = part.x
            last = last_states(part, last)
        remedies = remedies.together(tape.fallbacks)
        if tape.fault is not None and last is not None and tape.good < good:
            good, fault = tape.good, Fault(index, with_bad(last, tape.fault, tape.fault_velocity))
    moved = np.repeat([index in cloths for index in range(len(counts))], counts)
    observed = None if moved.all() else np.broadcast_to(moved, (good + 1, len(moved))).copy()
    positions, times = positions[: good + 1], motion.times[: good + 1]
    motion = replace(motion, positions=positions, times=times, observed=observed, remedies=remedies)
    motion = in_scene(motion, scene)
    belongs(motion, scene)
    if fault is not None:
        raise outcome(scene, motion, fault)
    return motion
