"""What changes over time in a scene, for `info` and `validate`."""

from __future__ import annotations

import os
from typing import NamedTuple

import numpy as np

from clothfit.engine import system
from clothfit.engine.inputs import interpolation, sampling
from clothfit.engine.inputs.sources import keyed
from clothfit.scene.keys import Keys
from clothfit.scene.scene import Scene


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
    check(scene)
    return [described(keys, count) for keys, count in keyed(scene)]


def check(scene: Scene) -> None:
    """Raise InvalidScene for an input whose file cannot be read or does not fit, and for a cloth that crosses itself
    where the scene asks that it does not.
    """
    for index, cloth in enumerate(scene.cloths):
        sampling.build(scene, cloth, 1)
        system.surface_of(scene, index)
    system.meshes_of(scene, 0)


def described(keys: Keys, vertices: int | None) -> Input:
    """What there is to say of keys."""
    own = interpolation.resolved(keys)
    values = own.values.reshape(-1, 3)
    least, most = (tuple(np.asarray(end(values, axis=0)).tolist()) for end in (np.min, np.max))
    times = float(own.times[0]), float(own.times[-1])
    return Input(keys.place, vertices, len(own.times), *times, keys.interpolation, keys.file, least, most)
