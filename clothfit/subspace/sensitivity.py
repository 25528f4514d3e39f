"""How much a small difference at the start grows in the full simulation: whether points can be compared at all.

The start is moved by noise, a `PART` of the RMS of the motion's displacements, and simulated once more. Where the two
full motions part by a hundred times as much, one on a basis that leaves out such a part is another motion as well,
however exact its steps: then its spectrum and its envelope tell whether it is one of the same kind.
"""

from __future__ import annotations

import numpy as np

from clothfit.base.arrays import Array
from clothfit.engine.rollout import rollout
from clothfit.engine.system import build
from clothfit.motion.motion import Motion
from clothfit.motion.world import in_world
from clothfit.scene.scene import Scene

PART = 1e-3
"""Small against the motion, and large against what the solver leaves."""


def growth(scene: Scene, full: Motion, seed: int = 0) -> float:
    """The RMS distance of the two motions in the last fifth of the frames, relative to that at the start; the largest
    over the objects. 0 where nothing moves.
    """
    held, frames = in_world(full, scene), len(full.times)
    return max(_of_object(scene, held.of(c), c, frames, seed) for c in range(len(scene.cloths)))


def _of_object(scene: Scene, x: Array, c: int, frames: int, seed: int) -> float:
    system = build(scene, c, steps=max(1, frames - 1))
    size = PART * float(np.sqrt(((x - x[0]) ** 2).sum(axis=2).mean()))
    if size == 0.0:
        return 0.0
    noise = np.random.default_rng(seed).standard_normal(system.x0.shape) * size / np.sqrt(3.0)
    noise[~system.vertex.free] = 0.0
    moved, good = rollout(system._replace(x0=system.x0 + noise), frames - 1, scene.tolerance)
    away = np.sqrt(((moved.x[: good + 1] - x[: good + 1]) ** 2).sum(axis=2).mean(axis=1))
    return float(np.sqrt((away[-max(1, frames // 5) :] ** 2).mean())) / float(np.sqrt((noise**2).sum(axis=1).mean()))
