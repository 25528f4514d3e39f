"""The time step of a fit: how many steps to a frame of the target, and how large the error of a step is.

The errors of the model e and of the step s add up like independent ones,

    RMSE² ≈ e² + s²

so a step is fine enough where s is small beside the RMSE, and a simulation with half of it says how large s is.
`step_choice` chooses by that.
"""

from __future__ import annotations

from dataclasses import dataclass
from math import ceil

import numpy as np

from clothfit.base.arrays import Array
from clothfit.motion.divergence import Diverged
from clothfit.motion.simulate import simulate_cloths
from clothfit.motion.times import frame_places
from clothfit.objective.experiment import Experiment
from clothfit.objective.objective import Objective
from clothfit.scene.fit_vector import fitted_cloths, with_parameters
from clothfit.scene.scene import Scene
from clothfit.strategy.ladder import STAGE_TOLERANCE

ROUNDING = 1e-6
"""Steps by which a whole number of them may be off by rounding."""


@dataclass(frozen=True)
class Step:
    """A time step that was tried."""

    substeps: int  # K, steps to a frame of the target
    integrator: str  # its name
    rmse: float  # m, of the coarsest model, as far as it was fitted with that step
    seconds: float  # of computing


def frame_interval(given: Experiment) -> float:
    """Time between two frames of a target, s, in the median: steps of its scene, without the rounding of a whole number
    of them.
    """
    times, delta = given.motion.times, given.scene.delta
    steps = float(np.median(np.diff(times))) / delta if len(times) > 1 else 1.0
    whole = max(round(steps), 1)
    return delta * (whole if abs(steps - whole) < ROUNDING else steps)


def substeps_of(given: Experiment) -> float:
    """How many steps of its scene a frame of a target has."""
    return frame_interval(given) / given.scene.delta


def with_substeps(objective: Objective, count: int, method: int | None) -> Objective:
    """The objective with so many steps to a frame, each of its own target; `method` None: as they are. The scene's own
    step is that for the first target. The same frames are compared.
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
    return objective.against(main, pairs, [pair.scene.frames for pair in pairs])


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


def step_error(scene: Scene, p: Array) -> float:
    """How far, m, RMS over all vertices, the motion of p (P,) is from that with steps half as long; infinite where one
    diverges. By a step of second order that is 3/4 of what the step adds to the error.
    """
    at = with_parameters(scene, p)
    try:
        coarse = simulate_cloths(at, fitted_cloths(at), tolerance=STAGE_TOLERANCE)
        half = with_interval(at, at.delta / 2.0, None)
        fine = simulate_cloths(half, fitted_cloths(at), tolerance=STAGE_TOLERANCE)
    except Diverged:
        return np.inf
    squares = (coarse.positions - fine.positions[::2]) ** 2
    return float(np.sqrt(np.nanmean(squares.sum(axis=-1))))
