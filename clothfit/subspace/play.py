"""Playing a model: its motion under other inputs, and how long a frame takes.

Inputs beyond those of the recorded motions are clamped to their range: what a subspace has not seen it can not show.

Many instances of a model play at once, each under inputs of its own: vertices as one product, and layers of a network.
A single decoding reads the whole basis for one vector of coordinates and waits for memory; for N instances the basis is
read once, as X = Q Uᵀ with Q (N, r). The same holds for normals by regression.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from time import perf_counter, process_time
from typing import Any

import numpy as np
from numpy.typing import NDArray

from clothfit.base import interrupts
from clothfit.base.arrays import Array
from clothfit.base.errors import InvalidInput
from clothfit.base.limits import FARTHEST
from clothfit.base.memory import check_memory
from clothfit.engine.inputs.tables import Inputs
from clothfit.engine.system import System, build
from clothfit.motion.motion import Motion, in_scene
from clothfit.scene.scene import Scene
from clothfit.subspace import translation
from clothfit.subspace.frames import Decoder, push_all
from clothfit.subspace.inputs import Ranges, episodes, varied
from clothfit.subspace.model import Model, Part
from clothfit.subspace.network.weights import Network, Stepper
from clothfit.subspace.physics.march import March, roll
from clothfit.subspace.physics.samples import Reduced, decode

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
    return Played(motion_of(scene, x), coordinates, list(said), spent)


def motion_of(scene: Scene, x: Sequence[Array]) -> Motion:
    """The motion of a scene, from positions (frames, n, 3), m, of each object in the world."""
    times = scene.delta * np.arange(len(x[0]), dtype=np.float64)
    return in_scene(Motion(np.concatenate(x, axis=1), times, scene.vertex_counts, None, scene.name), scene)


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
    out = np.empty((len(q), *own.system.x0.shape))
    for first in range(0, len(q), 64):
        out[first : first + 64] = decode(own.system, own.basis, q[first : first + 64], first)
    return out


WITHIN = 2.0 / 3.0
"""Of the recorded range is that of random keys: a spline through them goes beyond."""


@dataclass(frozen=True)
class PlayedGroup:
    """What became of the instances."""

    coordinates: list[Array]  # of each object, (N, frames, r)
    clamped: list[str]  # one sentence for each kind of input that left its range
    us: dict[str, float]  # per instance and frame, of one thread: state, decode, normals


class Cloths:
    """Reduced cloths that step one after another; those with alike inputs share their memory."""

    def __init__(self, each: Iterable[Any]) -> None:
        self.systems: list[System] = []
        self.motions: list[March] = []
        kinds: dict[Any, tuple[Reduced, March]] = {}
        for own in each:
            self.systems.append(own.system)
            alike = kinds.get(kind_of(own.system.inputs))
            self.motions.append(March(alike[0].under(own.system), alike[1]) if alike else March(own))
            kinds.setdefault(kind_of(own.system.inputs), (own, self.motions[-1]))
        self.q = np.zeros((len(self.motions), self.motions[0].state.q.shape[1]))

    def step(self, t: int) -> None:
        """Take step t."""
        for i, motion in enumerate(self.motions):
            if motion.take(self.q[i : i + 1]) == 0:
                self.q[i] = np.nan


class Networks:
    """Instances that one network steps, each layer as one product."""

    def __init__(self, own: Network, each: Iterable[Any]) -> None:
        runs = list(each)
        self.own, self.systems = own, [run.system for run in runs]
        self.w = np.stack([run.w for run in runs])  # (N, steps, m)
        self.now = np.zeros((len(runs), own.r), np.float32)
        self.before = np.stack([run.before for run in runs])

    @property
    def q(self) -> Array:
        """The coordinates (N, r)."""
        return self.now.astype(float)

    def step(self, t: int) -> None:
        """Take step t."""
        own = self.own
        u = np.concatenate([self.now, self.now - self.before, self.w[:, t]], axis=1)
        linear, layer = u @ own.linear + own.offset, u
        for k, (weight, bias) in enumerate(zip(own.weights, own.biases, strict=True)):
            layer = layer @ weight + bias
            if k < len(own.weights) - 1:
                below = np.minimum(layer, 0.0)
                layer = np.maximum(layer, 0.0) + (np.expm1(below) if own.activation == "elu" else 0.0)
        self.before, self.now = self.now, np.clip(linear + layer, *own.range)


class Instances:
    """N instances of one object of a model, at the start."""

    def __init__(self, model: Model, c: int, scenes: Sequence[Scene], steps: int) -> None:
        """A scene for each instance, which differ in their inputs; room for so many steps."""
        part, first = model.parts[c], scenes[0].cloths[c]
        self.said: dict[str, None] = {}
        each = (ready(model, part, scene, c, steps, self.said) for scene in scenes)
        self.runs: Networks | Cloths = Cloths(each) if part.network is None else Networks(part.network, each)
        self.t = 0
        self.decoder = Decoder(first.positions, part.basis, first.triangles, part.normals)

    @property
    def q(self) -> Array:
        """The coordinates (N, r)."""
        return self.runs.q

    def step(self) -> None:
        """Take a step of all instances. Raises Diverged."""
        self.runs.step(self.t)
        self.t += 1
        check_finite(self.q, self.t, "an instance")

    def positions(self) -> NDArray[np.float32]:
        """Positions (N, n, 3), m, valid until the next call."""
        x = self.decoder.positions(self.q)
        for own, system in zip(x, self.runs.systems, strict=True):
            held = system.inputs
            if held is not None and held.path.size:
                own[system.vertex.free] += translation.shift(held, 1, self.t)[0].astype(np.float32)
                own[held.pins] = held.path[self.t]
        return x

    def normals(self, x: NDArray[np.float32]) -> NDArray[np.float32]:
        """Unit normals (N, n, 3), valid until the next call: by regression where the model has that, else those of the
        faces at positions x.
        """
        return self.decoder.normals(x) if self.decoder.regression is None else self.decoder.predicted(self.q)


def kind_of(inputs: Inputs | None) -> Any:
    """What two inputs must have in common to be played in the same memory: which of their tables have rows."""
    if inputs is None:
        return None
    return tuple(len(getattr(inputs, name)) > 0 for name in ("wind", "gravity", "centre", "path")), len(inputs.pins)


def play_all(model: Model, scenes: Sequence[Scene], frames: int) -> PlayedGroup:
    """Play an instance of the model in each of some scenes. Raises Diverged, InvalidInput."""
    for scene in scenes:
        check_objects(model, scene)
    groups = [Instances(model, c, scenes, frames - 1) for c in range(len(model.parts))]
    found = [np.zeros((len(scenes), frames, each.q.shape[1])) for each in groups]
    spent = np.zeros(3)
    for each, q in zip(groups, found, strict=True):
        each.normals(each.positions())  # compiled, and its memory touched
        for t in range(1, frames):
            times = [process_time()]
            each.step()
            times.append(process_time())
            x = each.positions()
            times.append(process_time())
            each.normals(x)
            spent += np.diff([*times, process_time()])
            q[:, t] = each.q
            interrupts.check()
    said = {sentence.partition(",")[0]: sentence for each in groups for sentence in each.said}  # one of each kind
    us = 1e6 * spent / max(1, (frames - 1) * len(scenes))
    return PlayedGroup(found, list(said.values()), dict(zip(("state", "decode", "normals"), us.tolist(), strict=True)))


def instances(model: Model, scene: Scene, count: int, frames: int, seed: int = 0) -> list[Scene]:
    """A scene for each of so many instances, with random inputs within the range of the recorded ones."""
    found = {name: WITHIN * float(np.abs(each).max()) for name, each in model.limits.items()}
    held = scene.moves  # then the range of the pins is that of their own way, which stays
    ranges = Ranges(found.get("wind", 0.0), 0.0 if held else found.get("pins", 0.0))
    own = episodes(scene, ranges, count, scene.delta * max(1, frames - 1), seed)
    return [varied(scene, each) for each in own]


def motion_in(model: Model, scene: Scene, found: PlayedGroup, instance: int) -> Motion:
    """The motion of one of the instances, which was played in a scene."""
    x = []
    for c, part in enumerate(model.parts):
        q = found.coordinates[c][instance]
        x.append(positions(ready(model, part, scene, c, len(q) - 1, {}), q))
    return motion_of(scene, x)
