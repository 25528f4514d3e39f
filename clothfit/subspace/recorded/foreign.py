"""Motions of other programs as recorded data: their frames at the times of the steps, with the inputs that moved them.

A motion whose frames are at other times is read between them by cubic splines. Frames in which not all vertices are
seen do not count. What pushes or moves the cloth beside the scene's own wind, pins and obstacles must be named as
inputs, as a network learns what follows from what it is told.
"""

from __future__ import annotations

import os
from collections.abc import Sequence
from itertools import pairwise
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from clothfit.base.arrays import Array, Flags
from clothfit.base.errors import InvalidInput
from clothfit.base.memory import check_memory
from clothfit.motion.motion import Motion
from clothfit.motion.times import frame_places
from clothfit.scene.cloth import Cloth
from clothfit.scene.scene import Scene
from clothfit.subspace.recorded import inputs
from clothfit.subspace.recorded.recording import Recorded, archived, keep
from clothfit.subspace.recorded.variation import Episode, Ranges, varied

FEWEST = 4
"""Frames of a motion at least: a cubic spline needs as many."""

ROW = 1.5
"""Times the distance of the frames, up to which two of them are frames in a row."""


def episode(scene: Scene, path: str | None) -> Episode:
    """The episode of a motion with the inputs of a file, or with the scene's own. Raises InvalidInput."""
    if path is None:
        return Episode(())
    items = []
    for each in inputs.load(path):
        own = dict(each)
        if isinstance(own.get("file"), str):
            own["file"] = os.path.abspath(Path(path).parent / own["file"])
        items.append(own)
    inputs.applied(scene, items, name=path)
    return Episode(tuple(items))


def collect(scene: Scene, given: Sequence[tuple[Motion, Episode]], path: str | os.PathLike[str]) -> Recorded:
    """Write motions of a scene, each with its episode, as data. Raises InvalidInput."""
    if scene.frame:
        raise InvalidInput(f"{scene.name}: frame: motions of other programs need axes that stand still")
    found = [stepped(scene, motion, own) for motion, own in given]
    steps = max(len(x) for x, _ in found) - 1
    ends = np.cumsum([0, *scene.vertex_counts])
    with archived(scene, [own for _, own in given], Ranges(0.0, 0.0, 1.0), steps, path) as place:
        for e, (x, good) in enumerate(found):
            for c, (first, end) in enumerate(pairwise(ends)):
                keep(f"{place}/{e}", c, x[:, first:end], good)
    kept = sum(int(good.sum()) for _, good in found)
    return Recorded(kept, sum(len(good) for _, good in found) - kept, 0)


def stepped(scene: Scene, motion: Motion, own: Episode) -> tuple[NDArray[np.float32], Flags]:
    """The displacements (frames, n, 3), m, of a motion at the times of the steps, single precision, and which frames
    are seen whole; fixed vertices are where the scene has them.
    """
    whole = np.asarray(motion.seen().all(axis=1))
    if whole.sum() < FEWEST:
        raise InvalidInput(f"{motion.name}: {whole.sum()} frames show all vertices; at least {FEWEST} are needed")
    step, fraction = frame_places(motion, scene.delta)
    count = int(step[whole][-1]) + 1
    check_memory(count, motion.positions.shape[1], 0)
    x, good = at_steps(motion.positions[whole], motion.times[whole] / scene.delta, (step + fraction)[whole], count)
    return (held(varied(scene, own), x) - start(scene)).astype(np.float32), good


def at_steps(x: Array, places: Array, snapped: Array, count: int) -> tuple[Array, Flags]:
    """Positions (count, N, 3) after so many steps, and which of these have a frame, or lie between two in a row, from
    frames (F, N, 3) at `places`, in steps, which are whole numbers where they are `snapped` (`motion.times`).
    """
    steps = np.arange(count)
    after = np.clip(np.searchsorted(snapped, steps), 1, len(snapped) - 1)
    after = np.where(snapped[after - 1] == steps, after - 1, after)
    there = snapped[after] == steps
    if there.all():
        return x[after], there
    from scipy.interpolate import CubicSpline

    near = snapped[after] - snapped[after - 1] < ROW * np.median(np.diff(snapped))
    return np.asarray(CubicSpline(places, x, axis=0)(steps)), there | (near & (steps >= snapped[0]))


def start(scene: Scene) -> Array:
    """The positions (N, 3) of all vertices at the start, m."""
    return np.concatenate([cloth.positions for cloth in scene.cloths])


def held(scene: Scene, x: Array) -> Array:
    """The positions (frames, N, 3) with those of the fixed vertices that no key moves as the scene has them."""
    still = np.concatenate([cloth.fixed & ~np.isin(np.arange(len(cloth.mass)), moved(cloth)) for cloth in scene.cloths])
    return np.where(still[:, None], start(scene), x)


def moved(cloth: Cloth) -> NDArray[np.intp]:
    """The vertices of a cloth that keys move."""
    return np.concatenate([np.zeros(0, int), *(pin.vertices for pin in cloth.pins)]).astype(int)
