"""Two motions of one scene's cloths, frame by frame: the fitted one and its target."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from clothfit.base.arrays import Array, Flags
from clothfit.evaluation.evaluate import compared_cloths, finite_part, place_of, states
from clothfit.motion.motion import Motion
from clothfit.motion.times import frame_places, interpolated
from clothfit.scene.scene import Scene


@dataclass(frozen=True)
class Overlay:
    """Both motions at the frames of the target."""

    scene: Scene  # the fitted one
    times: Array  # (F,), s
    own: Array  # (F, n, 3), m
    goal: Array  # (F, n, 3), m; NaN where not observed
    rmse: Array  # (F,), m, over the observed vertices of the fitted objects; NaN where none is observed
    largest: Array  # (F,), m, the largest distance of such a vertex


def overlaid(truth: Scene, fitted: Scene, target: Motion | None, frames: int) -> Overlay:
    """The motion of a fitted scene, and its target: by default the motion of the true scene.

    Both have `frames` frames of the true scene's simulation, or as many as the target reaches, and end before they
    diverge. The fitted scene is simulated with its own step.
    """
    goal = target if target is not None else finite_part(truth, range(len(truth.cloths)), frames, 0)[0]
    own, _ = finite_part(fitted, range(len(fitted.cloths)), states(place_of(frames, truth, fitted)), 0)
    step, fraction = frame_places(goal, fitted.delta)
    kept = step + (fraction > 0) < len(own.positions)
    x = interpolated(own.positions, step[kept], fraction[kept])
    y = np.where(np.isfinite(goal.positions[kept]), goal.positions[kept], np.nan)
    if goal.observed is not None:
        y[~goal.observed[kept]] = np.nan
    rmse, largest = distances(truth, x, y)
    return Overlay(fitted, goal.times[kept], x, y, rmse, largest)


def distances(scene: Scene, x: Array, y: Array) -> tuple[Array, Array]:
    """Root mean square and largest distance (F,), m, of two motions (F, n, 3) over the compared objects."""
    own = compared_vertices(scene)
    return per_frame(((x[:, own] - y[:, own]) ** 2).sum(axis=2))


def compared_vertices(scene: Scene) -> Flags:
    """Which vertices (V,) belong to objects that are fitted; all, where none is."""
    compared = compared_cloths(scene)
    return np.repeat([index in compared for index in range(len(scene.cloths))], scene.vertex_counts)


def per_frame(squares: Array) -> tuple[Array, Array]:
    """Root mean square and largest distance (F,), m, from squared distances (F, n); NaN where none is finite."""
    known = np.isfinite(squares)
    count, finite = known.sum(axis=1), np.where(known, squares, 0.0)
    mean = np.where(count > 0, finite.sum(axis=1) / np.maximum(count, 1), np.nan)
    largest = np.where(count > 0, finite.max(axis=1, initial=0.0), np.nan)
    return np.sqrt(mean), np.sqrt(largest)
