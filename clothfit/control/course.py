"""What pictures and reports show of a controlled motion: the keys as poses of the cloths, how far the motion is from
each of them over time, and what every step of it takes.

F frames, n vertices of all objects, K keys, G times of keys.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from clothfit.base.arrays import Array, Indices
from clothfit.control.control import moved
from clothfit.control.keyframes import Key
from clothfit.motion.motion import Motion
from clothfit.scene.scene import Scene


@dataclass(frozen=True, eq=False)
class Course:
    """A controlled motion beside its keys and beside the motion without controls."""

    scene: Scene  # with the controls
    times: Array  # (F,), s
    own: Array  # (F, n, 3), m
    free: Array  # (F, n, 3), m, without the controls; where that diverges it stays
    keys: Sequence[Key]
    poses: Array  # (G, n, 3), m, what keys of one time ask for; NaN for vertices that none asks for
    means: tuple[Array, ...]  # of each time the places (M, 3), m, that means of vertices are to be at
    due: Indices  # (G,), the frames of these times
    distance: Array  # (K, F), m, root mean square distance from each key
    forces: Array  # (F, n, 3), N, in the step that begins at each frame; 0 at the last
    effort: Array  # (F,), N² s, of that step

    def next(self, frame: int) -> int:
        """Which time of keys, 0 … G − 1, comes at a frame or after it; the last one after all."""
        return min(int(np.searchsorted(self.due, frame)), len(self.due) - 1)


def course(scene: Scene, controlled: Scene, keys: Sequence[Key], motion: Motion) -> Course:
    """The course of the motion of a scene with controls; `scene` has none."""
    x, times = motion.positions, motion.times
    due = np.unique([key.step for key in keys]).astype(np.int32)
    poses = np.full((len(due), x.shape[1], 3), np.nan)
    means: list[list[Array]] = [[] for _ in due]
    for key in keys:
        place = int(np.searchsorted(due, key.step))
        if key.share is None:
            poses[place, scene.vertices(key.cloth)][key.vertices] = key.positions
        else:
            means[place].append(key.positions[0])
    forces = np.zeros_like(x)
    if controlled.forces is not None:
        forces[:-1] = controlled.forces.at(times[:-1])[0]
    return Course(
        controlled, times, x, moved(scene, len(x) - 1), keys, poses,
        tuple(np.array(each, float).reshape(-1, 3) for each in means), due,
        np.array([away(key, x[:, scene.vertices(key.cloth)]) for key in keys]),
        forces, scene.delta * (forces**2).sum(axis=(1, 2)),
    )  # fmt: skip


def away(key: Key, x: Array) -> Array:
    """Root mean square distance (F,), m, of the positions x (F, n, 3) of a key's object from the key."""
    own = x[:, key.vertices]
    if key.share is not None:
        own = np.einsum("v,fvc->fc", key.share, own)[:, None]
    return np.asarray(np.sqrt(((own - key.positions) ** 2).sum(axis=2).mean(axis=1)))
