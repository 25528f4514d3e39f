"""The motions that a page shows, at the same times, and the distances between them.

Without a target motion both scenes are simulated, over the fitted frames and beyond. With one, the times are those of
its frames, and the fitted motion is interpolated linearly between its steps. The motions of other scenes, that with the
values before the fit and those of other fits, may stand beside the fitted one.

F frames, V vertices of all objects.
"""

from __future__ import annotations

import warnings
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from clothfit.base.arrays import Array, Flags
from clothfit.base.memory import check_memory
from clothfit.evaluation import evaluate
from clothfit.evaluation.evaluate import HORIZON, Distance, Evaluation
from clothfit.evaluation.touches import Touching, touches
from clothfit.motion import energy
from clothfit.motion.divergence import Diverged
from clothfit.motion.motion import Motion, check_counts, checked_motion
from clothfit.motion.times import TIME_SLACK
from clothfit.objective.experiment import check_same_sizes
from clothfit.pictures.stage import LARGEST_GROWTH
from clothfit.scene.scene import Scene

MOST_POSITIONS = 3_200_000
"""Most positions of all motions together: a page with them takes about 15 MB."""

BEFORE = "before the fit"
"""The name of the motion of the values with which a fit began."""

MOST_TOUCHING = 5
"""Lines on what touches what."""


@dataclass(frozen=True, eq=False)
class Companion:
    """The motion of another scene, at the times of the fitted one."""

    name: str
    scene: Scene
    positions: Array  # (F, V, 3), m; NaN after it has diverged
    error: Array  # (F, V), m; NaN where not observed or diverged
    rmse: Array  # (C,), m, as of the fitted one; NaN where it has diverged
    largest: Array  # (C,), m
    near: Distance | None  # over the fitted frames; None where it diverges within them


@dataclass(frozen=True, eq=False)
class View:
    """The motions and errors that a page shows."""

    times: Array  # (F,), s
    fitted: Array  # (F, V, 3), m
    target: Array  # (F, V, 3), m; NaN where not observed
    error: Array  # (F, V), m; NaN where not observed
    curve_times: Array  # (C,), s, of all compared frames, of which every k-th is shown
    rmse: Array  # (C,), m, over the objects that are fitted; NaN where nothing was observed
    largest: Array  # (C,), m
    fitted_until: float  # s, the end of the fitted frames
    every: int  # one frame in so many is shown
    evaluation: Evaluation
    residuals: Residuals
    notes: list[str]  # warnings for the reader
    companions: Sequence[Companion] = ()
    vertex_counts: tuple[int, ...] = ()
    weights: Array | None = None  # (F, V), how often positions count; None: all once
    touching: Sequence[Touching] = ()  # what touches what in the fitted motion, the most often first


def view(
    truth: Scene,
    fitted: Scene,
    target: Motion | None = None,
    frames: int | None = None,
    most: int = MOST_POSITIONS,
    others: Sequence[tuple[str, Scene]] = (),
) -> View:
    """Simulate the motions of a page; `others` are names and scenes of those beside the fitted one.

    `frames` (default: as `evaluate`, fewer for large scenes) counts the initial state. Where there are more than `most`
    positions, every k-th frame is shown. Raises InvalidInput when scenes and target do not match, Diverged when the
    fitted motion or its target has no second frame.
    """
    for scene in (fitted, *(scene for _, scene in others)):
        check_same_sizes(scene, truth)
    length = default_length(truth, most) if frames is None else max(frames, truth.frames)
    notes: list[str] = []
    if frames is None and length < max(truth.frames, HORIZON) and target is None:
        notes.append(f"the horizon ends after {length} frames, as more would make this page large (--steps)")
    goal, own, faults = motions(truth, fitted, target, length)
    notes += [f"{fault}; the frames before are shown" for fault in faults]
    notes += energy.faults(fitted, own)
    evaluation = evaluate.judged(truth, fitted, own, goal, (truth.frames, length), faults[0] if faults else None)
    show = pictured(truth, fitted.delta, own, goal, evaluation, notes, bool(faults), most // (2 + len(others)))
    others_shown = [companion(name, scene, truth, goal, show, length) for name, scene in others]
    return replace(show, companions=others_shown, touching=touches(fitted, own)[:MOST_TOUCHING])


def companion(name: str, scene: Scene, truth: Scene, goal: Motion, show: View, length: int) -> Companion:
    """The motion of another scene at the times of what is shown; adds a note where it diverges. `length` is as of the
    fitted one.
    """
    compared, count = evaluate.compared_cloths(truth), len(show.curve_times)
    end = min(evaluate.place_of(length, truth, scene), evaluate.last_place(goal, scene.delta))
    positions = np.full((count, sum(scene.vertex_counts), 3), np.nan)
    near: Distance | None = None
    try:
        own, fault = evaluate.finite_part(scene, range(len(scene.cloths)), max(evaluate.states(end), 2), 2)
    except Diverged as ended:
        fault = str(ended)
    else:
        reached = evaluate.at_frames(own, goal, scene.delta)[:count]
        positions[: len(reached)] = reached
        positions[frames_in_view(reached) :] = np.nan
        fitted_end = evaluate.place_of(truth.frames, truth, scene)
        if evaluate.states(min(fitted_end, end)) <= len(own.positions):
            near = evaluate.distance(own, goal, scene.delta, compared, fitted_end)
    if fault:
        show.notes.append(f"{name}: {fault}; the frames before are shown")
    wanted = evaluate.seen(goal)[:count]
    gaps = np.sqrt(((positions - wanted) ** 2).sum(axis=2))
    rmse, largest = evaluate.per_frame(gaps[:, evaluate.compared_vertices(truth)] ** 2)
    return Companion(name, scene, positions[:: show.every], gaps[:: show.every], rmse, largest, near)


def default_length(scene: Scene, most: int) -> int:
    """Frames to simulate: as `evaluate`, but beyond the fitted ones no more than fit into a page."""
    room = most // (2 * sum(scene.vertex_counts))
    return max(scene.frames, min(HORIZON, room))


def motions(truth: Scene, fitted: Scene, target: Motion | None, length: int) -> tuple[Motion, Motion, list[str]]:
    """The target, the fitted motion after each step, and the faults of motions that diverged."""
    every = range(len(truth.cloths))
    faults: list[str | None] = []
    if target is None:
        check_memory(length, sum(truth.vertex_counts), 1)
        goal, fault = evaluate.finite_part(truth, every, length, 2)
        faults.append(fault)
    else:
        check_counts(target, truth)
        goal = checked_motion(target, truth)
    end = min(evaluate.place_of(length, truth, fitted), evaluate.last_place(goal, fitted.delta))
    own, fault = evaluate.finite_part(fitted, every, max(evaluate.states(end), 2), 2)
    return goal, own, [text for text in (*faults, fault) if text]


def pictured(
    truth: Scene, delta: float, own: Motion, goal: Motion, evaluation: Evaluation, notes: list[str], diverged: bool,
    most: int,
) -> View:  # fmt: skip
    """Both motions at the times of the target, as far as both reach; of more than `most` positions of each every k-th
    frame. The fitted one, `own`, has steps of `delta`, s.
    """
    fitted = evaluate.at_frames(own, goal, delta)
    wanted = evaluate.seen(goal)[: len(fitted)]
    count = frames_in_view(fitted, wanted) if diverged else len(fitted)
    fitted, wanted = fitted[:count], wanted[:count]
    error = np.sqrt(((fitted - wanted) ** 2).sum(axis=2))
    times = goal.times[:count]
    every = max(-(-fitted.shape[0] * fitted.shape[1] // max(most, 1)), 1)
    if every > 1:
        notes.append(f"one frame in {every} is shown, as all would make this page large; the charts know all")
    part, until = evaluate.compared_vertices(truth), float(truth.delta * (truth.frames - 1))
    start = np.concatenate([cloth.positions for cloth in truth.cloths])
    left = residuals(fitted, wanted, start, part, times <= until + TIME_SLACK * delta)
    curves = evaluate.per_frame(error[:, part] ** 2)
    return View(
        times[::every], fitted[::every], wanted[::every], error[::every], times, *curves, until, every,
        evaluation, left, notes, vertex_counts=goal.vertex_counts,
        weights=None if goal.weights is None else goal.weights[:count:every],
    )  # fmt: skip


def frames_in_view(*both: Array) -> int:
    """The number of frames, at least 2, before one of the motions (F, V, 3) has left the picture."""
    start = np.concatenate([motion[0] for motion in both])
    centre = np.nanmean(start, axis=0)
    size = max(float(np.nanmax(np.abs(start - centre))), 1e-3)
    away = np.max([np.nanmax(np.abs(motion - centre), axis=(1, 2), initial=0.0) for motion in both], axis=0)
    gone = np.flatnonzero(away > LARGEST_GROWTH * size)
    return max(int(gone[0]), 2) if len(gone) else len(away)


@dataclass(frozen=True, eq=False)
class Residuals:
    """The residuals of a fitted motion, over the vertices that are compared."""

    mean: Array  # (C, 3), m, over the vertices, by component: a drift of the whole cloth
    of_vertices: Array  # (V,), m, root mean square over the fitted frames; NaN where not observed
    travel: float  # m, root mean square distance of the target from where the cloth starts, over the fitted frames


def residuals(x: Array, wanted: Array, start: Array, part: Flags, near: Flags) -> Residuals:
    """The residuals of positions x (C, V, 3) to `wanted` (C, V, 3), NaN where not observed; m.

    The cloths start at `start` (V, 3). `part` (V,) flags the vertices that are compared, `near` (C,) the frames that
    are fitted.
    """
    left = x - wanted
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", RuntimeWarning)  # means of nothing are NaN, as they should be
        mean = np.nanmean(left[:, part], axis=1)
        of_vertices = np.sqrt(np.nanmean((left[near] ** 2).sum(axis=2), axis=0))
        travel = float(np.sqrt(np.nanmean(((wanted[near][:, part] - start[part]) ** 2).sum(axis=2))))
    of_vertices[~part] = np.nan
    return Residuals(mean, of_vertices, travel if np.isfinite(travel) else 0.0)
