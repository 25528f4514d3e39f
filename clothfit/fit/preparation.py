"""What a fit settles before it begins: its model, and the time step that its scene is to be played with.

Targets cut into windows that begin in the target's own states: multiple shooting, with the states given.

A motion from its start hides what a few frames show: what the model lacks adds up, and in wind a motion forgets where
it began. So each window of some frames is an experiment of its own, whose cloths begin where the target is then, with
the velocities of the frames around,

    x = y_s,    v = (y_{s+1} − y_{s−1}) / (t_{s+1} − t_{s−1}),

and values are those with which the next frames follow. The first window begins as the scene does. The values are exact
where the target is; noise of σ in the positions makes one of σ √2 / (t_{s+1} − t_{s−1}) in these velocities, so windows
of noisy targets must be long.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from math import ceil
from typing import TypeVar

import numpy as np

from clothfit.base import interrupts, threads
from clothfit.base.arrays import Flags
from clothfit.base.errors import InvalidInput
from clothfit.engine.system import BDF2
from clothfit.fit import holdout
from clothfit.fit.options import AUTO, FitOptions
from clothfit.fit.result import Fit
from clothfit.motion.motion import Motion, at_frames
from clothfit.motion.times import TIME_SLACK, frame_places
from clothfit.objective.experiment import Experiment
from clothfit.objective.objective import Objective
from clothfit.scene.cloth import Cloth
from clothfit.scene.fit_vector import fitted_cloths, parameters
from clothfit.scene.scene import Scene
from clothfit.strategy import ladder, step_choice

CHOICE = 0.7
"""Share of the time of a fit that the choice of its model may take, with that of the step."""

MOMENT = 0.5
"""Seconds for the costs of the values that were found, where the time is up."""

T = TypeVar("T")


def flagged(scene: Scene, model: str | None) -> Scene:
    """The scene with a model in place of its own flags, where one is asked for; "auto" has all values free."""
    return scene if model is None else ladder.as_model(scene, "L" if model == AUTO else model, exactly=True)


def in_time(look: Callable[[], T], otherwise: T, seconds: float | None = None, known: bool = False) -> T:
    """What `look` finds within some seconds; `otherwise` where the time ends it, or a request does where a result is
    `known` already.
    """
    try:
        with threads.single(), interrupts.heard(), interrupts.limited(seconds):
            return look()
    except KeyboardInterrupt:
        if not known:
            raise
        interrupts.request()
        interrupts.answer()
    except interrupts.OutOfTime:
        pass
    return otherwise


def counts_of(options: FitOptions, scene: Scene) -> Sequence[int]:
    """The numbers of BDF2 steps to a frame that are to be tried. A scene with the editor's step keeps it where nobody
    asks for another.
    """
    if isinstance(options.substeps, int):
        return [options.substeps]
    asked = options.substeps == AUTO or (scene.method == BDF2 and options.method == AUTO)
    return step_choice.COUNTS if asked and not options.keep_step else []


def in_windows(whole: Objective, frames: int) -> Objective:
    """The objective over windows of so many frames each after the one that they begin with. Raises InvalidInput where
    something of a scene depends on when it began, or a target shows no state.
    """
    found = [window for each in whole.experiments for window in windows_of(each, frames)]
    return whole.against(whole.scene, found, [each.scene.frames for each in found])


def with_whole(found: Fit, whole: Objective) -> Fit:
    """The fit with its error over whole motions from their start; infinite where one diverges."""
    return replace(found, whole=holdout.error_of(whole, parameters(found.scene, whole.scene)))


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
    keyed = any(each is not None for each in (scene.wind_keys, scene.gravity_keys, scene.frame))
    moved = any(each.position or each.rotation or (each.body and each.body.motion) for each in scene.colliders)
    if keyed or moved or any(cloth.pins for cloth in fitted):
        raise InvalidInput(f"{scene.name}: windows: nothing of the scene may change over time, but its inputs do")
    if any(cloth.mode("velocity") != "n" for cloth in fitted):
        raise InvalidInput(f"{scene.name}: windows: the velocities at the start are fitted, which only the first shows")
    if any(cloth.mode("rest") == "G" for cloth in fitted):
        raise InvalidInput(f"{scene.name}: windows: mode G of rest lengths is relative to those at the start; use F")


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
    return whole_of(at_frames(given.motion, slice(end + 1)), given.scene)


def window(given: Experiment, start: int, end: int) -> Experiment:
    """The window of a target from one frame to another."""
    motion, scene = given
    cut = at_frames(motion, slice(start, end + 1))
    cut = replace(cut, times=cut.times - motion.times[start])
    before, after = start - 1, start + 1
    around = (motion.positions[after] - motion.positions[before]) / (motion.times[after] - motion.times[before])
    ends, cloths = np.cumsum(scene.vertex_counts)[:-1], list[Cloth]()
    states = zip(still(scene), np.split(motion.positions[start], ends), np.split(around, ends), strict=True)
    for cloth, (held, x, v) in zip(scene.cloths, states, strict=True):
        x, v = (np.where(held[:, None], *each) for each in ((cloth.positions, x), (cloth.velocity, v)))
        cloths.append(replace(cloth, positions=x, velocity=v))
    return whole_of(cut, replace(scene, cloths=tuple(cloths), main=scene.main or scene))


def whole_of(motion: Motion, scene: Scene) -> Experiment:
    """A motion, and as many frames of the scene as reach its last one; factors multiply the values of its main one."""
    frames = ceil(float(motion.times[-1]) / scene.delta - TIME_SLACK) + 1
    return Experiment(motion, replace(scene, frames=frames, main=scene.main or scene))
