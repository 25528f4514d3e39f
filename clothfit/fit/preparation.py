"""What a fit settles before it begins: its model, and the time step that its scene is to be played with.

Targets cut into windows that begin in the target's own states: multiple shooting, with the states given.

A motion from its start hides what a few frames show: what the model lacks adds up, and in wind a motion forgets where
it began. So each window of some frames is an experiment of its own, whose cloths begin where the target is then, with
the velocities of the frames around,

    x = y_s,    v = (y_{s+1} − y_{s−1}) / (t_{s+1} − t_{s−1}),

and values are those with which the next frames follow. The first window begins as the scene does. The values are exact
where the target is; noise of σ in the positions makes one of σ √2 / (t_{s+1} − t_{s−1}) in these velocities, so windows
of noisy targets must be long.

Held vertices that move in a target follow it: they become pins on the target's path, each target's in its own scene.

A held vertex moves where, over the frames that show it, its places scatter by more than noise. With the variance V of
its N places and their mean squared successive difference D, D/2 estimates the variance of noise that is new in each
frame, so V − D/2 that of the motion, and the ratio of J. von Neumann (1941), r = 1 − D / 2V, is 0 ± 1/√(3N) for noise
in three coordinates. It moves where r is `SIGNIFICANT` of these deviations or more, and √(V − D/2) is more than `LEAST`
of the cloth's size and `ROUNDINGS` times the rounding of the target's numbers.

Pins name the target's file where its points, as read from there, are the target's; else they have the keys themselves:
of arrays, of pipes, where vertices have gaps, and where markers, the clock or the place were put right.
"""

from __future__ import annotations

import os
from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace
from math import ceil
from typing import Any, NamedTuple, TypeVar

import numpy as np

from clothfit.base import interrupts, threads
from clothfit.base.arrays import Array, Flags, Indices
from clothfit.base.eigen import connected_components
from clothfit.base.errors import InvalidInput
from clothfit.engine.inputs.sampling import moved
from clothfit.engine.system import BDF2
from clothfit.fit import hierarchy, holdout, step_choice
from clothfit.fit.options import AUTO, Request
from clothfit.fit.result import Fit
from clothfit.motion.degrade import rounding
from clothfit.motion.motion import Motion, at_frames, rms
from clothfit.motion.times import TIME_SLACK, frame_places
from clothfit.objective.experiment import Experiment, Targets, experiments
from clothfit.objective.objective import Objective
from clothfit.scene.cloth import Cloth
from clothfit.scene.fit_vector import fitted_cloths, parameters
from clothfit.scene.keys import Keys
from clothfit.scene.scene import Scene, vectors, with_pins

T = TypeVar("T")


def flagged(scene: Scene, model: str | None) -> Scene:
    """The scene with a model in place of its own flags, where one is asked for; "auto" has all values free."""
    return scene if model is None else hierarchy.as_model(scene, "L" if model == AUTO else model, exactly=True)


def in_time(search: Callable[[], T], otherwise: T, seconds: float | None = None, known: bool = False) -> T:
    """What `search` finds within some seconds; `otherwise` where the time ends it, or a request does where a result is
    `known` already.
    """
    try:
        with threads.single(), interrupts.heard(), interrupts.limited(seconds):
            return search()
    except KeyboardInterrupt:
        if not known:
            raise
        interrupts.request()
        interrupts.answer()
    except interrupts.OutOfTime:
        pass
    return otherwise


def counts_of(options: Request, scene: Scene) -> Sequence[int]:
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


def with_whole(fit: Fit, whole: Objective) -> Fit:
    """The fit with its error over whole motions from their start; infinite where one diverges."""
    return replace(fit, whole=holdout.error_of(whole, parameters(fit.scene, whole.scene)))


def windows_of(given: Experiment, frames: int) -> list[Experiment]:
    """The windows of one target."""
    motion, scene = given
    check_start(scene)
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


def check_start(scene: Scene) -> None:
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
    free = np.concatenate([~held for held in immobile(scene)])
    whole = np.asarray(motion.seen()[:, free].all(axis=1))
    shows = np.flatnonzero(whole[:-2] & whole[1:-1] & whole[2:]) + 1
    found, at = list[int](), frames
    while True:
        later = shows[(shows >= at) & (shows < last)]
        if not len(later):
            return found
        found.append(int(later[0]))
        at = found[-1] + frames


def immobile(scene: Scene) -> list[Flags]:
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
    states = zip(immobile(scene), np.split(motion.positions[start], ends), np.split(around, ends), strict=True)
    for cloth, (held, x, v) in zip(scene.cloths, states, strict=True):
        x, v = (np.where(held[:, None], *each) for each in ((cloth.positions, x), (cloth.velocity, v)))
        cloths.append(replace(cloth, positions=x, velocity=v))
    return whole_of(cut, replace(scene, cloths=tuple(cloths), main=scene.main or scene))


def whole_of(motion: Motion, scene: Scene) -> Experiment:
    """A motion, and as many frames of the scene as reach its last one; factors multiply the values of its main one."""
    frames = ceil(float(motion.times[-1]) / scene.delta - TIME_SLACK) + 1
    return Experiment(motion, replace(scene, frames=frames, main=scene.main or scene))


SIGNIFICANT, CLEAR = 4.0, 0.7
"""Standard deviations of r above that of noise, once in 30,000; and an r that is enough for a few frames."""

FEWEST = 5
"""Frames that show a vertex, below which r says nothing."""

LEAST = 1e-3
"""Motion relative to the size of the cloth: 1 mm in 1 m."""

ROUNDINGS = 3.0

NARROW = 0.1
"""Extent relative to the widest up to which a direction is one in which held vertices hardly extend."""

SLOW = 0.05
"""Speed at the start relative to that of all frames up to which a cloth begins at rest."""

EVEN = 1e-6
"""Seconds by which times between frames may differ."""

SAME = 1e-6
"""Distance relative to the cloth's size up to which the points of a file are those of the target: float32 has it."""


class Followed(NamedTuple):
    """A scene and its targets, whose held vertices follow them."""

    scene: Scene
    target: Targets
    vertices: int  # that follow, of all targets


def followed(scene: Scene, target: Targets) -> Followed:
    """The scene and the targets with pins for what is held and moves. The main scene gets those of its first target;
    further targets of it get copies of it.
    """
    main, found, count, taken = scene, list[Any](), 0, False
    given = experiments(scene, target)
    for motion, own in given:
        items = dict(pins_of(motion, own))
        count += sum(len(item["vertices"]) for each in items.values() for item in each)
        pinned = with_pins(own, items) if items else own
        if own is scene and not taken:
            main, taken = pinned, True
            found.append(motion)
        else:
            found.append((motion, pinned))
    if not count:
        return Followed(scene, [motion if own is scene else (motion, own) for motion, own in given], 0)
    return Followed(main, found, count)


def with_start_velocity(scene: Scene, target: Targets) -> tuple[Scene, float]:
    """The scene whose vertices begin as fast as those of its one target, and how fast that is, m/s (RMS).

    It is 0 where they begin at rest, as far as noise lets one see, or velocities are given or fitted. By the first
    three frames, v = (−3 y₀ + 4 y₁ − y₂) / 2h, against the third difference of the first four, which is noise or less
    smooth, and what one step of a fall adds.
    """
    (motion, own), *others = experiments(scene, target)
    gaps = np.diff(motion.times[:4])
    late = abs(float(motion.times[0])) > TIME_SLACK * scene.delta
    if others or own is not scene or late or len(gaps) < 3 or np.ptp(gaps) > EVEN:
        return scene, 0.0
    cloths, squares = list(scene.cloths), 0.0
    for i, cloth in enumerate(scene.cloths):
        x, free = motion.of(i), motion.seen(i)[:4].all(axis=0) & ~cloth.fixed
        if not free.any() or cloth.velocity[free].any() or cloth.mode("velocity") != "n":
            continue
        v = (-3.0 * x[0] + 4.0 * x[1] - x[2]) / (2.0 * gaps[0])
        rough = np.sqrt(26.0 / 20.0) * (x[3] - 3.0 * x[2] + 3.0 * x[1] - x[0]) / (2.0 * gaps[0])
        usual = np.diff(x, axis=0)[:, free] / gaps[0]
        fall = float(np.linalg.norm(scene.gravity)) * gaps[0]
        least = max(fall, SIGNIFICANT * rms(rough[free]), SLOW * rms(usual[np.isfinite(usual).all(axis=2)]))
        if rms(v[free]) > least:
            cloths[i] = replace(cloth, velocity=np.where(free[:, None], v, cloth.velocity))
            squares += rms(v[free]) ** 2
    return replace(scene, cloths=tuple(cloths)) if squares else scene, float(np.sqrt(squares))


def pins_of(motion: Motion, scene: Scene) -> Iterator[tuple[int, list[dict[str, Any]]]]:
    """The pins, as a scene's file has them, that each object needs to follow a target."""
    shown = motion.times < (scene.frames - 1 + TIME_SLACK) * scene.delta
    finest = ROUNDINGS * rounding(motion)
    for i, cloth in enumerate(scene.cloths):
        if cloth.mode("path") != "n":  # keys of more pins would be fitted as well
            continue
        seen, weights = motion.seen(i), motion.weights_of(i)
        seen = (seen if weights is None else seen & (weights > 0)) & shown[:, None]
        free = cloth.fixed.copy()
        for pin in cloth.pins:
            free[pin.vertices] = False
        least = max(LEAST * size(cloth), finest)
        chosen = [v for v in np.flatnonzero(free).tolist() if moves(motion.of(i)[seen[:, v], v], least)]
        if chosen:
            own = pins(motion, i, np.array(chosen), seen, scene)
            yield i, own + [*unseen_pins(motion, i, set(chosen), free, seen, scene)]


def size(cloth: Cloth) -> float:
    """The diagonal of the box around a cloth, m."""
    return float(np.linalg.norm(np.ptp(cloth.positions, axis=0)))


def moves(places: Array, least: float) -> bool:
    """Whether a vertex at places (N, 3), m, moves by more than noise, and more than the `least`."""
    if len(places) < FEWEST:
        return False
    variance = float(places.var(axis=0).sum())
    noise = 0.5 * float((np.diff(places, axis=0) ** 2).sum(axis=1).mean())
    ratio = min(SIGNIFICANT / np.sqrt(3 * len(places)), CLEAR)
    return bool(variance - noise > max(least**2, ratio * variance))


def pins(motion: Motion, i: int, vertices: Indices, seen: Flags, scene: Scene) -> list[dict[str, Any]]:
    """The pins of some vertices of an object: one that names the target's file, or one with keys for each."""
    cloth, x = scene.cloths[i], motion.of(i)
    paths = [keyed(motion.times[seen[:, v]], x[seen[:, v], v], cloth.positions[v]) for v in vertices]
    if motion.path and seen[:, vertices].any(axis=1).sum() == seen[:, vertices].all(axis=1).sum():
        points = (vertices + scene.vertices(i).start).tolist()
        rate = {"fps": round(1.0 / float(motion.times[1] - motion.times[0]), 9)}  # of a file without times
        for said in (motion.said, {**rate, **motion.said}):
            keys = Keys(np.zeros(0), np.zeros((0, 3)), file=motion.path, points=tuple(points), said=dict(said))
            if agree(keys, paths, motion.times[seen[:, vertices[0]]], SAME * size(cloth)):
                named = {"file": relative(motion.path, scene.folder), **said, "points": points}
                return [{"vertices": vertices.tolist(), "posKeys": named}]
    return [
        {"vertices": [int(v)], "posKeys": {"times": keys.times.tolist(), "values": vectors(keys.values)}}
        for v, keys in zip(vertices, paths, strict=True)
    ]


def unseen_pins(
    motion: Motion, i: int, moving: set[int], free: Flags, seen: Flags, scene: Scene
) -> Iterator[dict[str, Any]]:
    """The pins of held vertices of an object, of those `free` (n,) to have some, that no frame shows, where others of
    their part, which springs join, are seen to be `moving`: by the affine map from where these begin to where they are
    that is nearest, and moves all alike in directions in which they hardly extend.
    """
    cloth, x, shown = scene.cloths[i], motion.of(i), seen.any(axis=0)
    times = np.union1d(0.0, motion.times[seen.any(axis=1)])
    part = connected_components(cloth.springs[cloth.fixed[cloth.springs].all(axis=1)], len(free))
    for each in np.unique(part[list(moving)]):
        known, hidden = (np.flatnonzero(free & (part == each) & rows) for rows in (shown, ~shown))
        paths = [keyed(motion.times[seen[:, v]], x[seen[:, v], v], cloth.positions[v]) for v in known]
        ways = np.stack([moved(path, times) * (v in moving) for v, path in zip(known, paths, strict=True)])
        middle = cloth.positions[known].mean(axis=0)
        away, reach = (cloth.positions[rows] - middle for rows in (hidden, known))
        weights = 1.0 / len(known) + away @ np.linalg.pinv(reach, rcond=NARROW)
        for v, values in zip(hidden.tolist(), np.tensordot(weights, ways, 1), strict=True):
            yield {"vertices": [v], "posKeys": {"times": times.tolist(), "values": vectors(values)}}


def keyed(times: Array, places: Array, start: Array) -> Keys:
    """The keys of a vertex that is at `start` (3,) at time 0 and then at some places (N, 3), m; where time 0 is not
    shown it moves to the first of them.
    """
    if times[0] > 0.0:
        return Keys(np.append(0.0, times), np.concatenate([np.zeros((1, 3)), places - start]))
    return Keys(times, places - places[0])


def agree(keys: Keys, paths: list[Keys], times: Array, tolerance: float) -> bool:
    """Whether the points of a file take vertices where their own keys do, at all times shown, within a tolerance, m."""
    try:
        found = moved(keys, times)
    except InvalidInput:
        return False
    own = np.stack([moved(each, times) for each in paths], axis=1)
    return found.shape == own.shape and bool(np.abs(found - own).max() <= tolerance)


def relative(path: str, folder: str) -> str:
    """The path from a folder, where there is one."""
    try:
        return os.path.relpath(path, folder or os.curdir).replace(os.sep, "/")
    except ValueError:  # on another drive
        return os.path.abspath(path)
