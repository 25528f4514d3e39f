"""How good a fitted scene is: how far its motion, over the fitted frames and beyond, and its parameters are from the
truth.
"""

from __future__ import annotations

from collections.abc import Collection
from dataclasses import dataclass

import numpy as np

from clothfit.base.arrays import Array
from clothfit.base.errors import InvalidInput
from clothfit.base.memory import check_memory
from clothfit.fit.options import FIT_TOLERANCE
from clothfit.motion.divergence import Diverged
from clothfit.motion.motion import Motion, checked_motion
from clothfit.motion.simulate import simulate_cloths
from clothfit.motion.times import frame_places
from clothfit.objective.experiment import check_same_sizes
from clothfit.objective.identifiability import identifiable
from clothfit.objective.target import sample
from clothfit.objective.target import target as target_of
from clothfit.scene.fit_vector import fitted_cloths, parameters
from clothfit.scene.scene import Scene

HORIZON = 500  # frames


@dataclass(frozen=True)
class Distance:
    """Distance between two motions over the vertices of the fitted objects (of all, where none is flagged)."""

    frames: int  # compared, the initial one included
    rmse: float  # m
    max_error: float  # largest distance of a vertex, m


@dataclass(frozen=True)
class Deviation:
    """Relative deviation |fitted / true − 1| of one kind of value of one object, over the identifiable ones."""

    object: int | None  # None: of the scene as a whole
    name: str  # of the kind: "mass", "stiffness", …
    mode: str  # "G" one value for the object, or "L" one per element
    count: int  # of values, those that are not identifiable included
    median_relative_deviation: float | None  # None where no value is identifiable
    max_relative_deviation: float | None  # the same


@dataclass(frozen=True)
class Evaluation:
    """How far a fitted scene is from the true one, or from a target."""

    fitted: Distance  # over the frames that are fitted
    horizon: Distance  # over a longer run, the fitted frames included
    parameters: list[Deviation]  # against the true values, kind by kind
    diverged: str | None = None  # what happened, where the longer run diverged; it then ends before that


def evaluate(
    truth: Scene, fitted: Scene, frames: int | None = None, horizon: int = HORIZON, target: Motion | None = None
) -> Evaluation:
    """Compare a fitted scene with the true one, or with a target motion where one is given.

    `frames` (default: the scene's) and `horizon` count the initial state. A target is compared at the times of its
    frames, as far as it reaches; each position counts once, unless its weight is 0. Raises InvalidInput when the scenes
    or the target have other objects, Diverged when a simulation diverges within the fitted frames.
    """
    check_same_objects(truth, fitted)
    near = truth.frames if frames is None else frames
    if near < 2 or horizon < 2:
        raise InvalidInput(f"frames must be at least 2 to compare; {min(near, horizon)} was given")
    compared = compared_cloths(truth)
    length = max(near, horizon)
    if target is None:
        check_memory(length, sum(truth.vertex_counts), 1)  # two motions; else the second would be refused late
        goal, fault = finite_part(truth, compared, length, near)
    else:
        goal, fault = checked_motion(target, truth), None
    step, fraction = frame_places(goal, truth.delta)
    length = min(length, int(step[-1]) + (fraction[-1] > 0) + 1)
    own, own_fault = finite_part(fitted, compared, length, min(near, length))
    return Evaluation(
        distance(own, goal, truth.delta, compared, near),
        distance(own, goal, truth.delta, compared, horizon),
        deviations(truth, fitted),
        fault or own_fault,
    )


def compared_cloths(scene: Scene) -> Collection[int]:
    """The objects that are fitted; all, where none is."""
    return fitted_cloths(scene) or range(len(scene.cloths))


def finite_part(scene: Scene, compared: Collection[int], frames: int, needed: int) -> tuple[Motion, str | None]:
    """Simulate the compared objects as far as the motion stays finite; with the fault that ended it, or None.

    Raises Diverged when fewer than `needed` frames are finite.
    """
    try:
        return simulate_cloths(scene, compared, frames, FIT_TOLERANCE), None
    except Diverged as error:
        if error.motion is None or len(error.motion.times) < needed:
            raise
        return error.motion, str(error)


def check_same_objects(truth: Scene, fitted: Scene) -> None:
    """Raise InvalidInput unless both scenes have the same numbers of vertices and springs and the same time step."""
    check_same_sizes(fitted, truth)
    if truth.delta != fitted.delta:
        raise InvalidInput(f"{fitted.name}: its delta is {fitted.delta:g} s, that of {truth.name} {truth.delta:g} s")


def distance(own: Motion, goal: Motion, delta: float, compared: Collection[int], frames: int) -> Distance:
    """Distance of a simulated motion `own` from the frames of `goal` up to step `frames` − 1; `delta` in s."""
    gaps: list[Array] = []
    count = 0
    for cloth in compared:
        wanted = target_of(goal, cloth, delta, min(frames, len(own.positions)) - 1)
        gaps.append((sample(wanted, own.of(cloth)) - wanted.positions)[wanted.observed])
        count = len(wanted.step)
    squares = (np.concatenate(gaps) ** 2).sum(axis=1)
    if not squares.size:
        raise InvalidInput(f"{goal.name}: shows no observed vertex in the first {frames} frames")
    return Distance(count, float(np.sqrt(squares.mean())), float(np.sqrt(squares.max())))


def deviations(truth: Scene, fitted: Scene) -> list[Deviation]:
    """Relative deviations of the parameters flagged in the true scene."""
    listed, each = [], relative_deviations(truth, fitted)
    for block in truth.blocks:
        known = each[block.part][~np.isnan(each[block.part])]
        middle, largest = (float(np.median(known)), float(known.max())) if known.size else (None, None)
        listed.append(Deviation(block.cloth, block.name, block.mode, block.count, middle, largest))
    return listed


def relative_deviations(truth: Scene, fitted: Scene) -> Array:
    """|fitted / true − 1| (P,) of the parameters flagged in the true scene; NaN where one is 0 or not identifiable."""
    true, found = parameters(truth), parameters(fitted, flags=truth)
    usable = identifiable(truth) & (true != 0)
    return np.asarray(np.abs(found / np.where(usable, true, np.nan) - 1.0))
