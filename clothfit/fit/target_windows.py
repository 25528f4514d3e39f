"""Targets cut into windows that begin in the target's own states: multiple shooting, with the states given.

A motion from its start hides what a few frames show: what the model lacks adds up, and in wind a motion forgets where
it began. So each window of some frames is an experiment of its own, whose cloths begin where the target is then, with
the velocities of the frames around,

    x = y_s,    v = (y_{s+1} − y_{s−1}) / (t_{s+1} − t_{s−1}),

and values are those with which the next frames follow. The first window begins as the scene does. The values are exact
where the target is; noise of σ in the positions makes one of σ √2 / (t_{s+1} − t_{s−1}) in these velocities, so windows
of noisy targets must be long.
"""

from __future__ import annotations

from dataclasses import replace
from math import ceil

import numpy as np

from clothfit.base.arrays import Array, Flags
from clothfit.base.errors import InvalidInput
from clothfit.fit.result import Fit
from clothfit.motion.divergence import Diverged
from clothfit.motion.motion import Motion, at_frames
from clothfit.motion.times import TIME_SLACK, frame_places
from clothfit.objective.experiment import Experiment
from clothfit.objective.objective import Objective
from clothfit.scene.fit_vector import fitted_cloths, parameters
from clothfit.scene.scene import Scene


def in_windows(whole: Objective, frames: int) -> Objective:
    """The objective over windows of so many frames each after the one that they begin with. Raises InvalidInput where
    something of a scene depends on when it began, or a target shows no state.
    """
    found = [window for each in whole.experiments for window in windows_of(each, frames)]
    return whole.against(whole.scene, found, [each.scene.frames for each in found])


def with_whole(found: Fit, whole: Objective) -> Fit:
    """The fit with its error over whole motions from their start; infinite where one diverges."""
    try:
        return replace(found, whole=whole.position_rmse(parameters(found.scene, whole.scene)))
    except Diverged:
        return replace(found, whole=np.inf)


def windows_of(given: Experiment, frames: int) -> list[Experiment]:
    """The windows of one target."""
    motion, scene = given
    check(scene)
    step, part = frame_places(motion, scene.delta)
    last = int(np.searchsorted(step + part, scene.frames - 1, side="right")) - 1
    starts = starts_of(motion, scene, frames, last)
    if last > frames and not starts:
        raise InvalidInput(
            f"{motion.name}: windows: no three frames one after the other show all vertices, as a window needs to "
            "begin in one; leave this out"
        )
    found = [first_window(given, starts[0] if starts else last)]
    for start, end in zip(starts, [*starts[1:], last], strict=True):
        if end > start:
            found.append(window(given, start, end))
    return found


def check(scene: Scene) -> None:
    """Raise InvalidInput where a scene cannot begin in another state."""
    fitted = [scene.cloths[cloth] for cloth in fitted_cloths(scene)]
    if changes(scene) or any(cloth.pins for cloth in fitted):
        raise InvalidInput(f"{scene.name}: windows: nothing of the scene may change over time, but its inputs do")
    if any(cloth.mode("velocity") != "n" for cloth in fitted):
        raise InvalidInput(f"{scene.name}: windows: the velocities at the start are fitted, which only the first shows")
    if any(cloth.mode("rest") == "G" for cloth in fitted):
        raise InvalidInput(f"{scene.name}: windows: mode G of rest lengths is relative to those at the start; use F")


def changes(scene: Scene) -> bool:
    """Whether wind, gravity, axes or colliders of a scene change over time."""
    keyed = (scene.wind_keys, scene.gravity_keys, scene.frame)
    moved = any(each.position or each.rotation or (each.body and each.body.motion) for each in scene.colliders)
    return moved or any(each is not None for each in keyed)


def starts_of(motion: Motion, scene: Scene, frames: int, last: int) -> list[int]:
    """Frames at which windows begin after the first one: every so many, or the next that shows a state."""
    free = np.concatenate([~held for held in still(scene)])
    whole = np.asarray(motion.seen()[:, free].all(axis=1))
    shows = np.flatnonzero(whole[:-2] & whole[1:-1] & whole[2:]) + 1
    found, at = list[int](), frames
    while True:
        later = shows[(shows >= at) & (shows < last)]
        if not len(later):
            return found
        found.append(int(later[0]))
        at = found[-1] + frames


def still(scene: Scene) -> list[Flags]:
    """Which vertices (n,) of each cloth keep the state that the scene gives them: held ones, and all of a cloth that is
    not fitted.
    """
    fitted = fitted_cloths(scene)
    return [cloth.fixed | (i not in fitted) for i, cloth in enumerate(scene.cloths)]


def first_window(given: Experiment, end: int) -> Experiment:
    """The first window of a target, up to the frame `end`."""
    motion = at_frames(given.motion, slice(end + 1))
    return Experiment(motion, replace(given.scene, frames=reached(motion, given.scene), main=main_of(given.scene)))


def window(given: Experiment, start: int, end: int) -> Experiment:
    """The window of a target from one frame to another."""
    motion, scene = given
    cut = at_frames(motion, slice(start, end + 1))
    cut = replace(cut, times=cut.times - motion.times[start])
    around = (motion.positions[start + 1] - motion.positions[start - 1]) / (
        motion.times[start + 1] - motion.times[start - 1]
    )
    ends = np.cumsum(scene.vertex_counts)[:-1]
    states = zip(
        scene.cloths, still(scene), np.split(motion.positions[start], ends), np.split(around, ends), strict=True
    )
    cloths = tuple(
        replace(cloth, positions=kept(held, cloth.positions, x), velocity=kept(held, cloth.velocity, v))
        for cloth, held, x, v in states
    )
    return Experiment(cut, replace(scene, cloths=cloths, frames=reached(cut, scene), main=main_of(scene)))


def kept(held: Flags, own: Array, others: Array) -> Array:
    """Vectors (n, 3) of `others`, and of held vertices their own."""
    return np.where(held[:, None], own, others)


def main_of(scene: Scene) -> Scene:
    """The scene whose values the factors multiply."""
    return scene.main or scene


def reached(motion: Motion, scene: Scene) -> int:
    """Frames of the scene that reach the last one of a motion."""
    return ceil(float(motion.times[-1]) / scene.delta - TIME_SLACK) + 1
