"""Motions that springs pull to where their target shows them: their scenes, and their objective (`nudging`)."""

from __future__ import annotations

import numpy as np

from clothfit.motion.motion import Motion
from clothfit.motion.times import frame_places
from clothfit.objective.experiment import Experiment
from clothfit.objective.objective import Objective
from clothfit.scene.forces import STRONGEST, Forces
from clothfit.scene.scene import Scene

TOLERANCE = 1e-7
"""Of the linear systems: its error is far below what is left of a nudged motion."""


def can_nudge(objective: Objective) -> bool:
    """Whether motions can be nudged: by positions, in scenes without forces of their own."""
    return list(objective.weights) == ["position"] and all(scene.forces is None for _, scene in objective.experiments)


def nudged(objective: Objective, pull: float) -> Objective:
    """The objective of motions with a pull, in radians per frame."""
    given = [Experiment(motion, pulled(scene, motion, pull)) for motion, scene in objective.experiments]
    return objective.in_scenes(given, max(TOLERANCE, objective.tolerance))


def pulled(scene: Scene, motion: Motion, pull: float) -> Scene:
    """A scene whose vertices are pulled to where a motion shows them, with springs of the masses that it has; between
    frames to places on the line from one to the next, unless all frames are at ends of steps.
    """
    step, part = frame_places(motion, scene.delta)
    at, seen, aligned = step + part, motion.seen(), not part.any()
    gap = max(float(np.median(np.diff(at))), 1.0) if len(at) > 1 else 1.0
    mass = np.concatenate([cloth.mass for cloth in scene.cloths])
    per_step = gap if aligned else 1.0  # the same impulse for each frame
    stiffness = np.minimum(per_step * mass * (pull / (gap * scene.delta)) ** 2, STRONGEST)
    count = max(int(at[-1]), 1)
    places = np.tile(np.concatenate([cloth.positions for cloth in scene.cloths]), (count, 1, 1)).astype(float)
    gain = np.zeros(places.shape[:2])
    for row in range(count):
        later = int(np.searchsorted(at, row + 1))
        if later == len(at):
            break
        if at[later] == row + 1:
            shown, place = seen[later], motion.positions[later]
        elif later and not aligned:
            share = (row + 1 - at[later - 1]) / (at[later] - at[later - 1])
            shown = seen[later] & seen[later - 1]
            place = (1.0 - share) * motion.positions[later - 1] + share * motion.positions[later]
        else:
            continue
        places[row, shown], gain[row, shown] = place[shown], stiffness[shown]
    times = scene.delta * np.arange(count, dtype=float)
    return scene.with_forces(Forces(times, np.zeros(places.shape), gain, places, pulls=True))
