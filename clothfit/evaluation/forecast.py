"""What simulating or fitting a scene will meet: how short its steps must be, how much memory it takes, and what changes
over time in it.
"""

from __future__ import annotations

import os
from dataclasses import dataclass
from math import inf
from typing import NamedTuple

import numpy as np

from clothfit.engine import system
from clothfit.engine.inputs import interpolation, sampling
from clothfit.engine.inputs.sampling import keyed
from clothfit.engine.rollout import state_bytes
from clothfit.engine.stability import UNLIMITED, frequency, limit
from clothfit.engine.system import build
from clothfit.objective import memory_needs as storage
from clothfit.scene.fit_vector import fitted_cloths
from clothfit.scene.kinds import INTEGRATORS, REST
from clothfit.scene.scene import Scene


@dataclass(frozen=True)
class Steps:
    """The longest stable step of an integrator."""

    integrator: str
    limit: float  # longest stable step at the start, s; infinite where all steps are stable, 0 where none is
    stable: bool  # whether the scene's delta is stable


@dataclass(frozen=True)
class Forecast:
    """What a scene will need."""

    steps: tuple[Steps, ...]  # of each integrator; the limit is that of the object with the shortest
    motion: int  # bytes of the positions of all frames, in memory and in a file
    fit: int | None  # bytes that a fit needs in all, see `fit_bytes`; None where nothing is flagged


def forecast(scene: Scene) -> Forecast:
    """Predict stable steps and memory of a scene."""
    least, state = dict.fromkeys(range(REST), inf), []
    for index in range(len(scene.cloths)):
        system = build(scene, index)
        state.append(state_bytes(system))
        with np.errstate(all="ignore"):  # of values at the ends of the range of doubles
            omega = frequency(system)
        for method in set(least) - set(UNLIMITED):
            least[method] = min(least[method], limit(system._replace(method=method), omega).step)
    steps = tuple(Steps(name, least[i], scene.delta <= least[i]) for i, name in enumerate(INTEGRATORS[:REST]))
    return Forecast(steps, motion_bytes(scene), fit_bytes(scene, state))


def motion_bytes(scene: Scene) -> int:
    """Bytes of the positions of all frames."""
    return scene.frames * sum(scene.vertex_counts) * 24


def fit_bytes(scene: Scene, state: list[int]) -> int | None:
    """Bytes that a fit needs in all if it keeps every state; None where nothing is flagged.

    `state` has the bytes of a state of each object. The target has all vertices after every step. With less memory a
    fit takes longer (`clothfit.base.memory`).
    """
    cloths = fitted_cloths(scene)
    if not cloths:
        return None
    work = sum(storage.WORK * scene.vertex_counts[index] for index in cloths)
    return motion_bytes(scene) + work + (scene.frames - 1) * max(state[index] for index in cloths)


class Input(NamedTuple):
    """One value that changes over time."""

    place: str  # of its keys in the scene
    vertices: int | None  # that it moves, of a pin
    keys: int
    first: float  # s
    last: float  # s
    interpolation: str
    file: str | None
    least: tuple[float, ...]  # value along x, y, z, in the unit of the field
    most: tuple[float, ...]

    def __str__(self) -> str:
        source = f" from {os.path.basename(self.file)}" if self.file else ""
        moved = "" if self.vertices is None else f", {self.vertices} vertices"
        spans = ", ".join(f"{low:.4g} … {high:.4g}" for low, high in zip(self.least, self.most, strict=True))
        when = f"{self.first:.4g} … {self.last:.4g} s"
        return f"{self.place}{moved}: {self.keys} keys{source}, {when}, {self.interpolation}, values ({spans})"


def inputs_of(scene: Scene) -> list[Input]:
    """All of them, in the order of the file. Raises InvalidScene for a file that cannot be read or does not fit."""
    check_inputs(scene)
    found = []
    for keys, vertices in keyed(scene):
        own = interpolation.resolved(keys)
        values = own.values.reshape(-1, 3)
        least, most = (tuple(end(values, axis=0).tolist()) for end in (np.min, np.max))
        times = float(own.times[0]), float(own.times[-1])
        found.append(
            Input(keys.place, vertices, len(own.times), *times, keys.interpolation, keys.file, least, most)
        )
    return found


def check_inputs(scene: Scene) -> None:
    """Raise InvalidScene for an input whose file cannot be read or does not fit."""
    for cloth in scene.cloths:
        sampling.build(scene, cloth, 1)
    system.meshes_of(scene, 0)
