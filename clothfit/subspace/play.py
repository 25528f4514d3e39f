"""Playing a model: its motion under other inputs, and how long a frame takes.

Inputs beyond those of the recorded motions are clamped to their range: what a subspace has not seen it can not show.
"""

from __future__ import annotations

from dataclasses import dataclass
from time import perf_counter
from typing import Any

import numpy as np

from clothfit.base.arrays import Array
from clothfit.base.errors import InvalidInput
from clothfit.base.limits import FARTHEST
from clothfit.base.memory import check_memory
from clothfit.engine.system import System, build
from clothfit.motion.motion import Motion, in_scene
from clothfit.scene.scene import Scene
from clothfit.subspace.frames import push_all
from clothfit.subspace.model import Model, Part
from clothfit.subspace.network.weights import Stepper
from clothfit.subspace.physics.march import roll
from clothfit.subspace.physics.samples import Reduced

SLACK = 1e-9
"""m/s, m/s² or m beyond a range that is rounding."""


@dataclass(frozen=True)
class Played:
    """A motion, and what there is to say of it."""

    motion: Motion
    coordinates: list[Array]  # of each object (frames, r)
    clamped: list[str]  # one sentence for each kind of input that left its range
    seconds: dict[str, float]  # in all: state, decode, and push out where that was asked for


def check_objects(model: Model, scene: Scene) -> None:
    """Raise InvalidInput where a scene's objects are not those of a model."""
    if scene.vertex_counts != tuple(len(part.basis) for part in model.parts):
        raise InvalidInput(f"{scene.name}: its objects are not those of the model")


def play(model: Model, scene: Scene, frames: int, distance: float | None = None) -> Played:
    """The motion of so many frames of a scene with the model's objects; vertices nearer to obstacles than a `distance`,
    m, are pushed out (`frames`). Raises InvalidInput where the scene's objects are others.
    """
    check_objects(model, scene)
    if frames < 1:
        raise InvalidInput(f"frames must be at least 1 (the initial state); {frames} was given")
    check_memory(frames, sum(scene.vertex_counts), 0)
    said: dict[str, None] = {}
    spent = {"state": 0.0, "decode": 0.0}
    x, coordinates = [], []
    for c, part in enumerate(model.parts):
        own = ready(model, part, scene, c, frames - 1, said)
        rolled(own, min(1, frames - 1), scene.name)  # compiled, and its memory touched
        begin = perf_counter()
        q = rolled(own, frames - 1, scene.name)
        middle = perf_counter()
        x.append(positions(own, q))
        end = perf_counter()
        spent["state"] += middle - begin
        spent["decode"] += end - middle
        if distance is not None:
            push_all(own.system, x[-1], distance)
            spent["push out"] = spent.get("push out", 0.0) + perf_counter() - end
        coordinates.append(q)
    times = scene.delta * np.arange(frames, dtype=np.float64)
    motion = Motion(np.concatenate(x, axis=1), times, scene.vertex_counts, None, scene.name)
    return Played(in_scene(motion, scene), coordinates, list(said), spent)


def ready(model: Model, part: Part, scene: Scene, c: int, steps: int, said: dict[str, None]) -> Reduced | Stepper:
    """What steps an object, with its inputs clamped; what was clamped goes to `said`."""
    system = build(scene, c, steps=steps)
    return stepper(part, clamped(system, model.limits, said), steps, said)


def stepper(part: Part, system: System, steps: int, said: dict[str, None]) -> Reduced | Stepper:
    """The reduced cloth of a system, or its network for so many steps."""
    if part.network is None:
        return Reduced(system, part.basis, part.chosen)
    return Stepper(part.network, system, part.basis, steps, said)


def clamped(system: System, limits: dict[str, Any], said: dict[str, None]) -> System:
    """The system with its inputs within the range of those that were recorded."""

    def within(name: str, table: Array, text: str, unit: str) -> Array:
        """The same table where it is within its limits, 0 where there are none."""
        low, high = (np.array(each) for each in limits.get(name, np.zeros((2, 3))))
        held = np.clip(table, low, high)
        far = float(np.abs(table - held).max(initial=0.0))
        if far <= SLACK:
            return table
        said[text.format(f"by {far:.3g} {unit} at most")] = None
        return np.asarray(held)

    inputs, change = system.inputs, "{} leaves the range that was recorded, {{}}; it is clamped"
    if "start" in limits:
        fast = "the start is faster than those that were recorded, {}; it is clamped"
        system = system._replace(v0=within("start", system.v0, fast, "m/s"))
    if inputs is None:
        return system
    held: dict[str, Any] = {
        name: within(name, getattr(inputs, name), change.format(name), unit)
        for name, unit in (("wind", "m/s"), ("gravity", "m/s²"))
    }
    if inputs.path.size:
        start = system.x0[inputs.pins]
        moved = inputs.path - start
        near = within("pins", moved, "pins leave the range that was recorded, {}; they are clamped", "m")
        if near is not moved:
            path, v0 = np.ascontiguousarray(start + near), system.v0.copy()
            v0[inputs.pins] = (path[1] - path[0]) / system.h
            system, held["path"] = system._replace(v0=v0), path
    changed: dict[str, Any] = {name: table for name, table in held.items() if table is not getattr(inputs, name)}
    return system._replace(inputs=inputs._replace(**changed)) if changed else system


def rolled(own: Reduced | Stepper, steps: int, name: str) -> Array:
    """The coordinates (steps + 1, r) of a motion. Raises Diverged, as a simulation does."""
    if isinstance(own, Stepper):
        return own.roll(steps)
    q = roll(own, steps)
    lost = np.flatnonzero(np.isnan(q[:, 0]))
    check_finite(q, int(lost[0]) if len(lost) else steps, name)
    return q


def check_finite(q: Array, frame: int, name: str) -> None:
    """Raise Diverged where coordinates are not those of a motion."""
    if not np.abs(q).max(initial=0.0) < FARTHEST:
        from clothfit.motion.divergence import Diverged

        raise Diverged(f"{name}: the motion on the subspace diverged at frame {frame}", frame)


def positions(own: Reduced | Stepper, q: Array) -> Array:
    """Positions (frames, n, 3), m, in chunks that stay small."""
    from clothfit.subspace.physics.samples import decode

    out = np.empty((len(q), *own.system.x0.shape))
    for first in range(0, len(q), 64):
        out[first : first + 64] = decode(own, q[first : first + 64], first)
    return out
