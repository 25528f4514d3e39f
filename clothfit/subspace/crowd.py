"""Many instances of a model at once, each under inputs of its own: vertices as one product, and layers of a network.

A single decoding reads the whole basis for one vector of coordinates and waits for memory; for N instances the basis is
read once, as X = Q Uᵀ with Q (N, r). The same holds for normals by regression. With `exact` normals are those of the
faces.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from time import process_time
from typing import Any

import numpy as np
from numpy.typing import NDArray

from clothfit.base import interrupts
from clothfit.base.arrays import Array
from clothfit.engine.inputs.tables import Inputs
from clothfit.motion.motion import Motion, in_scene
from clothfit.scene.scene import Scene
from clothfit.subspace import carrier, inputs
from clothfit.subspace.frames import Decoder
from clothfit.subspace.inputs import Ranges, episodes
from clothfit.subspace.model import Model
from clothfit.subspace.network.weights import Network
from clothfit.subspace.physics.march import March
from clothfit.subspace.play import check_finite, check_objects, positions, ready

Single = NDArray[np.float32]

WITHIN = 2.0 / 3.0
"""Of the recorded range is that of random keys: a spline through them goes beyond."""


@dataclass(frozen=True)
class Crowded:
    """What became of the instances."""

    coordinates: list[Array]  # of each object, (N, frames, r)
    clamped: list[str]  # one sentence for each kind of input that left its range
    us: dict[str, float]  # per instance and frame, of one thread: state, decode, normals


class Cloths:
    """Reduced cloths that step one after another; those with alike inputs share their memory."""

    def __init__(self, each: Iterable[Any]) -> None:
        kinds: dict[Any, Any] = {}
        self.runs = []
        for fresh in each:
            alike = kinds.setdefault(kind_of(fresh.system.inputs), fresh)
            self.runs.append(fresh if alike is fresh else alike.under(fresh.system))
        self.systems = [own.system for own in self.runs]
        alike_to: dict[int, March] = {}  # by the layout that runs of a kind share
        self.motions = []
        for own in self.runs:
            self.motions.append(March(own, alike_to.get(id(own.layout))))
            alike_to.setdefault(id(own.layout), self.motions[-1])
        self.q = np.zeros((len(self.runs), self.runs[0].r))

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


class Crowd:
    """N instances of one object of a model, at the start."""

    def __init__(self, model: Model, c: int, scenes: Sequence[Scene], steps: int) -> None:
        """A scene for each instance, which differ in their inputs; room for so many steps."""
        part, first = model.parts[c], scenes[0].cloths[c]
        self.said: dict[str, None] = {}
        each = (ready(model, part, scene, c, steps, self.said) for scene in scenes)
        self.runs: Networks | Cloths = Cloths(each) if part.network is None else Networks(part.network, each)
        self.t = 0
        self.decoder = Decoder(first.positions, part.basis, first.triangles, part.normals)
        self.free = self.runs.systems[0].vertex.free

    @property
    def q(self) -> Array:
        """The coordinates (N, r)."""
        return self.runs.q

    def step(self) -> None:
        """Take a step of all instances. Raises Diverged."""
        self.runs.step(self.t)
        self.t += 1
        check_finite(self.q, self.t, "an instance")

    def positions(self) -> Single:
        """Positions (N, n, 3), m, valid until the next call."""
        x = self.decoder.all_positions(self.q)
        for i, system in enumerate(self.runs.systems):
            inputs = system.inputs
            if inputs is not None and carrier.moves(inputs):
                x[i, self.free] += carrier.shift(inputs, 1, self.t)[0].astype(np.float32)
                x[i, inputs.pins] = inputs.path[self.t]
        return x

    def normals(self, x: Single) -> Single:
        """Unit normals (N, n, 3), valid until the next call: by regression where the model has that, else those of the
        faces at positions x.
        """
        return self.decoder.all_normals(self.q, x)


def kind_of(inputs: Inputs | None) -> Any:
    """What two inputs must have in common to be played in the same memory: which of their tables have rows."""
    if inputs is None:
        return None
    return tuple(len(getattr(inputs, name)) > 0 for name in ("wind", "gravity", "centre", "path")), len(inputs.pins)


def play(model: Model, scenes: Sequence[Scene], frames: int) -> Crowded:
    """Play an instance of the model in each of some scenes. Raises Diverged, InvalidInput."""
    for scene in scenes:
        check_objects(model, scene)
    crowds = [Crowd(model, c, scenes, frames - 1) for c in range(len(model.parts))]
    found = [np.zeros((len(scenes), frames, each.q.shape[1])) for each in crowds]
    spent = np.zeros(3)
    for each, q in zip(crowds, found, strict=True):
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
    said = {sentence.partition(",")[0]: sentence for each in crowds for sentence in each.said}  # one of each kind
    us = 1e6 * spent / max(1, (frames - 1) * len(scenes))
    return Crowded(found, list(said.values()), dict(zip(("state", "decode", "normals"), us.tolist(), strict=True)))


def varied(model: Model, scene: Scene, count: int, frames: int, seed: int = 0) -> list[Scene]:
    """A scene for each of so many instances, with random inputs within the range of the recorded ones."""
    found = {name: WITHIN * float(np.abs(each).max()) for name, each in model.limits.items()}
    held = scene.moves  # then the range of the pins is that of their own way, which stays
    ranges = Ranges(found.get("wind", 0.0), 0.0 if held else found.get("pins", 0.0))
    own = episodes(scene, ranges, count, scene.delta * max(1, frames - 1), seed)
    return [inputs.varied(scene, each) for each in own]


def motion(model: Model, scene: Scene, found: Crowded, instance: int) -> Motion:
    """The motion of one of the instances, which was played in a scene."""
    x, said = [], dict[str, None]()
    for c, part in enumerate(model.parts):
        q = found.coordinates[c][instance]
        x.append(positions(ready(model, part, scene, c, len(q) - 1, said), q))
    times = scene.delta * np.arange(len(x[0]), dtype=np.float64)
    return in_scene(Motion(np.concatenate(x, axis=1), times, scene.vertex_counts, None, scene.name), scene)
