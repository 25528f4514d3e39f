"""Two motions of one scene's cloths, frame by frame: a fitted one, and the target that it should be."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from clothfit.base.arrays import Array
from clothfit.fit.options import FIT_TOLERANCE
from clothfit.motion.divergence import Diverged
from clothfit.motion.motion import Motion
from clothfit.motion.simulate import simulate
from clothfit.motion.times import frame_places, interpolated
from clothfit.scene.fit_vector import fitted_cloths
from clothfit.scene.scene import Scene


@dataclass(frozen=True)
class Overlay:
    """Both motions at the frames of the target."""

    scene: Scene  # the fitted one
    times: Array  # (F,), s
    own: Array  # (F, n, 3), m
    goal: Array  # (F, n, 3), m; NaN where not observed
    rmse: Array  # (F,), m, over the vertices of the fitted objects that are observed; NaN where none is
    largest: Array  # (F,), m, the largest distance of such a vertex


def overlaid(truth: Scene, fitted: Scene, target: Motion | None, frames: int) -> Overlay:
    """The motion of a fitted scene over a target, by default over that of the true scene, for `frames` frames of a
    simulation or as far as the target reaches. Both end before they diverge.
    """
    goal = target if target is not None else moved(truth, frames)
    own = moved(fitted, frames)
    step, fraction = frame_places(goal, truth.delta)
    kept = step + (fraction > 0) < len(own.positions)
    x = interpolated(own.positions, step[kept], fraction[kept])
    y = np.where(np.isfinite(goal.positions[kept]), goal.positions[kept], np.nan)
    if goal.observed is not None:
        y[~goal.observed[kept]] = np.nan
    rmse, largest = distances(truth, x, y)
    return Overlay(fitted, goal.times[kept], x, y, rmse, largest)


def distances(scene: Scene, x: Array, y: Array) -> tuple[Array, Array]:
    """Root mean square and largest distance (F,), m, of two motions (F, n, 3) over the objects that are fitted (all,
    where none is flagged); NaN where nothing is known.
    """
    compared = fitted_cloths(scene) or range(len(scene.cloths))
    own = np.repeat([i in compared for i in range(len(scene.cloths))], scene.vertex_counts)
    squares = ((x[:, own] - y[:, own]) ** 2).sum(axis=2)
    known = np.isfinite(squares)
    count, total = known.sum(axis=1), np.where(known, squares, 0.0).sum(axis=1)
    mean = np.where(count > 0, total / np.maximum(count, 1), np.nan)
    largest = np.where(count > 0, np.where(known, squares, 0.0).max(axis=1, initial=0.0), np.nan)
    return np.sqrt(mean), np.sqrt(largest)


def moved(scene: Scene, frames: int) -> Motion:
    """The motion of a scene, as far as it stays finite."""
    try:
        return simulate(scene, frames, FIT_TOLERANCE)
    except Diverged as error:
        if error.motion is None:
            raise
        return error.motion
