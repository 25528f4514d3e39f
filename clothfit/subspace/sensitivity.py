"""How much a small difference at the start grows in the full simulation: whether points can be compared at all.

The start is moved by noise, a `PART` of the RMS of the motion's displacements, and simulated once more. Where the two
full motions part by a hundred times as much, one on a basis that leaves out such a part is another motion as well,
however exact its steps: then its spectrum and its envelope tell whether it is one of the same kind.

How far the points of a motion on a basis must be off is shown by the full simulation itself, where it goes on from what
the basis holds of a state (`floor`): no steps on the basis, by physics or by a network, know more of it.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from clothfit.base.arrays import Array
from clothfit.engine.inputs.tables import later
from clothfit.engine.rollout import rollout
from clothfit.engine.system import System, build
from clothfit.motion.motion import Motion, in_world
from clothfit.scene.scene import Scene
from clothfit.subspace import carrier
from clothfit.subspace.recorded.recording import TOLERANCE, Data

PART = 1e-3
"""Small against the motion, and large against what the solver leaves."""


SOUGHT = 0.02
"""Relative error of a motion on a basis from which on its floor is found."""

GOES_ON = (1 / 24, 1 / 12, 1 / 6, 1 / 3)
"""Parts of a motion after which the full simulation goes on from what a basis holds."""


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


def floor(basis: Array, system: System, x: Array, tolerance: float) -> float:
    """How far the full simulation is from a motion of displacements x (frames, n, 3), m, if it goes on from what a
    basis (n, 3, r) holds of one of its states: RMS over all frames, those before it without error, relative to that of
    the motion. The largest for some states.
    """
    size = float(np.sqrt((x**2).sum(axis=2).mean()))
    q = carrier.coordinates(x, system, carrier.projection(basis, system))
    starts = sorted({max(1, int(part * len(x))) for part in GOES_ON} & set(range(1, len(x) - 1)))
    return max((_after(basis, system, x, q, k, tolerance) for k in starts), default=0.0) / max(size, 1e-300)


def floor_of(scene: Scene, motion: Motion, bases: Sequence[Array]) -> float:
    """The largest `floor` of the objects of a full motion, for a basis of each."""
    held, found = in_world(motion, scene), []
    for c, basis in enumerate(bases):
        system = build(scene, c, steps=len(motion.times) - 1)
        found.append(floor(basis, system, held.of(c) - system.x0, scene.tolerance))
    return max(found)


def floor_of_recorded(data: Data, c: int, episode: int, basis: Array) -> float:
    """The `floor` of an object in a recorded motion."""
    system = build(data.scene_of(episode), c, steps=data.steps)
    return floor(basis, system, data.motion(episode, c)[0], TOLERANCE)


def at_best(found: float) -> str:
    """A `floor` in words."""
    text = "the full simulation itself is so far off where it goes on from what the vectors hold"
    return f"at best {100 * found:.2g} %: {text}"


def _after(basis: Array, system: System, x: Array, q: Array, k: int, tolerance: float) -> float:
    """The RMS distance, m, of the simulation that goes on from frame k."""
    flat, inputs = basis.reshape(-1, basis.shape[2]), system.inputs
    away = x[k - 1 : k + 1] - carrier.shift(inputs, 2, k - 1)  # of fixed vertices and pins nothing is left out
    free = system.vertex.free[:, None]
    held = np.where(free, (q[k - 1 : k + 1] @ flat.T).reshape(away.shape), away) + (x[k - 1 : k + 1] - away)
    v = (held[1] - held[0]) / system.h
    begun = system._replace(x0=system.x0 + held[1], v0=np.ascontiguousarray(v), inputs=later(inputs, k))
    made, good = rollout(begun, len(x) - 1 - k, tolerance)
    error = made.x[: good + 1] - system.x0 - x[k : k + good + 1]
    return float(np.sqrt((error**2).sum(axis=2).mean(axis=1).sum() / len(x)))
