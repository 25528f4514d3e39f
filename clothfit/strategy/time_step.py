"""The time step of a fit: how many steps to a frame of its targets, and by which integrator."""

from __future__ import annotations

from math import ceil

import numpy as np

from clothfit.motion.times import frame_places
from clothfit.objective.experiment import Experiment
from clothfit.objective.objective import Objective
from clothfit.scene.scene import Scene

ROUNDING = 1e-6
"""Steps by which a whole number of them may be off by rounding."""


def frame_interval(given: Experiment) -> float:
    """Time between two frames of a target, s, in the median: steps of its scene, without the rounding of a whole number
    of them.
    """
    times, delta = given.motion.times, given.scene.delta
    steps = float(np.median(np.diff(times))) / delta if len(times) > 1 else 1.0
    whole = max(round(steps), 1)
    return delta * (whole if abs(steps - whole) < ROUNDING else steps)


def with_substeps(objective: Objective, count: int, method: int | None, tolerance: float | None = None) -> Objective:
    """The objective with so many steps to a frame, each of its own target; `method` None: as they are. The scene's own
    step is that for the first target. The same frames are compared. `tolerance` None: as it is.
    """
    scene, given = objective.scene, objective.experiments
    last = max((last_time(each) for each in given if each.scene is scene), default=0.0)
    main = with_interval(scene, frame_interval(given[0]) / count, method, last)
    pairs = [
        Experiment(
            each.motion,
            main if each.scene is scene
            else with_interval(each.scene, frame_interval(each) / count, method, last_time(each)),
        )
        for each in given
    ]  # fmt: skip
    return objective.against(main, pairs, [pair.scene.frames for pair in pairs], tolerance)


def last_time(given: Experiment) -> float:
    """When the last frame of a target is that its scene reaches, s."""
    step, part = frame_places(given.motion, given.scene.delta)
    places = step + part
    return float(places[places <= given.scene.frames - 1].max(initial=0.0)) * given.scene.delta


def with_interval(scene: Scene, delta: float, method: int | None, last: float = 0.0) -> Scene:
    """The scene with steps of `delta`, s, as many as its time has, and no fewer than reach the time `last`, s."""
    within = int((scene.frames - 1) * scene.delta / delta + ROUNDING)
    needed = ceil(last / delta - ROUNDING)
    return scene.with_step(delta, max(within, needed, 1) + 1, method)
