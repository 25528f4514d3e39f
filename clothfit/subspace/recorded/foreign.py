"""Motions of other programs as recorded data: their frames at the times of the steps, with the inputs that moved them.

A motion whose frames are at other times is read between them by cubic splines. Frames in which not all vertices are
seen do not count. What pushes or moves the cloth beside the scene's own wind, pins and obstacles must be named as
inputs, as a network learns what follows from what it is told.
"""

from __future__ import annotations

import os
import tempfile
from collections.abc import Sequence
from dataclasses import asdict
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from clothfit.base.arrays import Array, Flags
from clothfit.base.errors import InvalidInput
from clothfit.base.writing import write_atomically
from clothfit.motion.motion import Motion
from clothfit.scene.scene import Scene, dumps
from clothfit.subspace.recorded import inputs
from clothfit.subspace.recorded.recording import Recorded, pack
from clothfit.subspace.recorded.variation import Episode, Ranges, varied

FEWEST = 4
"""Frames of a motion at least: a cubic spline needs as many."""

SAME = 1e-6
"""How far from a step a frame may be, in steps, to be that step's."""


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
    at_steps = [stepped(scene, motion, own) for motion, own in given]
    steps = max(len(x) for x, _ in at_steps) - 1
    about: dict[str, Any] = {
        "folder": os.path.abspath(scene.folder), "steps": steps, "ranges": asdict(Ranges(0.0, 0.0, 1.0)),
        "episodes": [asdict(own) for _, own in given],
    }  # fmt: skip
    ends = np.cumsum([0, *scene.vertex_counts])
    with tempfile.TemporaryDirectory(prefix="clothfit-", dir=os.path.dirname(os.path.abspath(path))) as place:
        for e, (x, good) in enumerate(at_steps):
            for c, (first, end) in enumerate(pairwise(ends)):
                np.save(f"{place}/{e}.{c}.x.npy", x[:, first:end])
                np.save(f"{place}/{e}.{c}.good.npy", good)
        write_atomically(path, lambda file: pack(file, dumps(scene), about, place))
    kept = sum(int(good.sum()) for _, good in at_steps)
    return Recorded(kept, sum(len(good) for _, good in at_steps) - kept, 0)


def stepped(scene: Scene, motion: Motion, own: Episode) -> tuple[NDArray[np.float32], Flags]:
    """The displacements (frames, n, 3), m, of a motion at the times of the steps, single precision, and which frames
    are seen whole; fixed vertices are where the scene has them.
    """
    whole = np.asarray(motion.seen().all(axis=1))
    if whole.sum() < FEWEST:
        raise InvalidInput(f"{motion.name}: {whole.sum()} frames show all vertices; at least {FEWEST} are needed")
    times = motion.times[whole]
    steps = np.arange(int(times[-1] / scene.delta + SAME) + 1)
    x, good = at_times(motion.positions[whole], times, np.asarray(scene.delta * steps, float))
    return (held(varied(scene, own), x) - start(scene)).astype(np.float32), good


def at_times(x: Array, times: Array, wanted: Array) -> tuple[Array, Flags]:
    """Positions (frames, N, 3) at wanted times, and which of these lie between two seen frames in a row."""
    gap = np.median(np.diff(times))
    after = np.clip(np.searchsorted(times, wanted - SAME * gap), 1, len(times) - 1)
    there = np.abs(times[after] - wanted) < SAME * gap
    good = (there | (times[after] - times[after - 1] < 1.5 * gap)) & (wanted >= times[0] - SAME * gap)
    if len(times) == len(wanted) and np.allclose(times, wanted, rtol=0.0, atol=SAME * gap):
        return x, good
    from scipy.interpolate import CubicSpline

    return np.asarray(CubicSpline(times, x, axis=0)(wanted)), good


def start(scene: Scene) -> Array:
    """The positions (N, 3) of all vertices at the start, m."""
    return np.concatenate([cloth.positions for cloth in scene.cloths])


def held(scene: Scene, x: Array) -> Array:
    """The positions (frames, N, 3) with those of the fixed vertices that no key moves as the scene has them."""
    still = np.concatenate([cloth.fixed & ~np.isin(np.arange(len(cloth.mass)), moved(cloth)) for cloth in scene.cloths])
    return np.where(still[:, None], start(scene), x)


def moved(cloth: Any) -> NDArray[np.intp]:
    """The vertices of a cloth that keys move."""
    return np.concatenate([np.zeros(0, int), *(pin.vertices for pin in cloth.pins)]).astype(int)
