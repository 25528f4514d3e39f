"""Held vertices that move in a target follow it: they become pins on the target's path, each target's in its own scene.

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
from collections.abc import Iterator
from dataclasses import replace
from typing import Any, NamedTuple

import numpy as np

from clothfit.base.arrays import Array, Flags, Indices
from clothfit.base.errors import InvalidInput
from clothfit.engine.inputs.sampling import moved
from clothfit.fit.hints import rms
from clothfit.motion.degrade import rounding
from clothfit.motion.motion import Motion
from clothfit.motion.times import TIME_SLACK
from clothfit.objective.experiment import Targets, experiments
from clothfit.scene.cloth import Cloth
from clothfit.scene.keys import Keys
from clothfit.scene.scene import Scene, vectors, with_pins

SIGNIFICANT, CLEAR = 4.0, 0.7
"""Standard deviations of r above that of noise, once in 30,000; and an r that is enough for a few frames."""

FEWEST = 5
"""Frames that show a vertex, below which r says nothing."""

LEAST = 1e-3
"""Motion relative to the size of the cloth: 1 mm in 1 m."""

ROUNDINGS = 3.0

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
        chosen = [v for v in np.flatnonzero(free) if moves(motion.of(i)[seen[:, v], v], least)]
        if chosen:
            yield i, pins(motion, i, np.array(chosen), seen, scene)


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
