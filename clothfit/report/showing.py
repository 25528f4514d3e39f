"""The two motions that a page shows, at the same times, and the distance between them.

Without a target motion both scenes are simulated, over the fitted frames and beyond. With one, the times are those of
its frames, and the fitted motion is interpolated linearly between its steps.

F frames, V vertices of all objects.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from clothfit.base.arrays import Array, Flags
from clothfit.base.memory import check_memory
from clothfit.evaluation.evaluate import (
    HORIZON,
    Evaluation,
    compared_cloths,
    deviations,
    distance,
    finite_part,
    last_place,
    place_of,
    states,
)
from clothfit.motion.motion import Motion, check_counts, checked_motion
from clothfit.motion.times import frame_places, interpolated
from clothfit.objective.experiment import check_same_sizes
from clothfit.pictures.overlay import compared_vertices, per_frame
from clothfit.pictures.polygons import FARTHEST_SHOWN
from clothfit.scene.scene import Scene

MOST_POSITIONS = 3_200_000
"""Most positions of both motions together: a page with them takes about 15 MB."""


@dataclass(frozen=True, eq=False)
class Shown:
    """The motions and errors that a page shows."""

    times: Array  # (F,), s
    fitted: Array  # (F, V, 3), m
    target: Array  # (F, V, 3), m; NaN where not observed
    error: Array  # (F, V), m; NaN where not observed
    curve_times: Array  # (C,), s, of all compared frames, of which every k-th is shown
    rmse: Array  # (C,), m, over the objects that are fitted; NaN where nothing was observed
    largest: Array  # (C,), m
    fitted_until: float  # s, the end of the fitted frames
    evaluation: Evaluation
    notes: list[str]  # warnings for the reader


def shown(
    truth: Scene, fitted: Scene, target: Motion | None = None, frames: int | None = None, most: int = MOST_POSITIONS
) -> Shown:
    """Simulate the motions of a page.

    `frames` (default: as `evaluate`, fewer for large scenes) counts the initial state. Where there are more than `most`
    positions, every k-th frame is shown. Raises InvalidInput when scenes and target do not match, Diverged when a
    motion has no second frame.
    """
    check_same_sizes(fitted, truth)
    length = default_length(truth, most) if frames is None else max(frames, truth.frames)
    notes = []
    if frames is None and length < max(truth.frames, HORIZON) and target is None:
        notes.append(f"the horizon ends after {length} frames, as more would make this page large (--steps)")
    goal, own, faults = motions(truth, fitted, target, length)
    notes += [f"{fault}; the frames before are shown" for fault in faults]
    compared = compared_cloths(truth)
    evaluation = Evaluation(
        distance(own, goal, fitted.delta, compared, place_of(truth.frames, truth, fitted)),
        distance(own, goal, fitted.delta, compared, place_of(length, truth, fitted)),
        deviations(truth, fitted),
        faults[0] if faults else None,
    )
    return pictured(truth, fitted.delta, own, goal, evaluation, notes, bool(faults), most)


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
        goal, fault = finite_part(truth, every, length, 2)
        faults.append(fault)
    else:
        check_counts(target, truth)
        goal = checked_motion(target, truth)
    end = min(place_of(length, truth, fitted), last_place(goal, fitted.delta))
    own, fault = finite_part(fitted, every, max(states(end), 2), 2)
    return goal, own, [text for text in (*faults, fault) if text]


def pictured(
    truth: Scene, delta: float, own: Motion, goal: Motion, evaluation: Evaluation, notes: list[str], diverged: bool,
    most: int,
) -> Shown:  # fmt: skip
    """Both motions at the times of the target, as far as both reach; of too many frames every k-th. The fitted one,
    `own`, has steps of `delta`, s.
    """
    step, fraction = frame_places(goal, delta)
    places = step + fraction
    count = int(np.searchsorted(places, len(own.positions) - 1, side="right"))
    fitted = interpolated(own.positions, step[:count], fraction[:count])
    wanted = np.where(seen(goal)[:count, :, None], goal.positions[:count], np.nan)
    if diverged:
        count = near_enough(fitted, wanted)
        fitted, wanted = fitted[:count], wanted[:count]
    error = np.sqrt(((fitted - wanted) ** 2).sum(axis=2))
    times = goal.times[:count]
    every = -(-2 * fitted.shape[0] * fitted.shape[1] // most)
    if every > 1:
        notes = [*notes, f"one frame in {every} is shown, as all would make this page large; the charts know all"]
    part = compared_vertices(truth)
    return Shown(
        times[::every], fitted[::every], wanted[::every], error[::every], times, *per_frame(error[:, part] ** 2),
        float(truth.delta * (truth.frames - 1)), evaluation, notes,
    )  # fmt: skip


def seen(motion: Motion) -> Flags:
    """Which positions (frames, V) of a motion were observed."""
    return np.concatenate([motion.seen(cloth) for cloth in range(len(motion.vertex_counts))], axis=1)


def near_enough(*both: Array) -> int:
    """The number of frames, at least 2, before one of the motions (F, V, 3) has left the picture."""
    start = np.concatenate([motion[0] for motion in both])
    centre = np.nanmean(start, axis=0)
    size = max(float(np.nanmax(np.abs(start - centre))), 1e-3)
    away = np.max([np.nanmax(np.abs(motion - centre), axis=(1, 2), initial=0.0) for motion in both], axis=0)
    gone = np.flatnonzero(away > FARTHEST_SHOWN * size)
    return max(int(gone[0]), 2) if len(gone) else len(away)
