"""What a player of MODEL needs that only the scene says, as arrays, so that it need not read scenes."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from clothfit.base.arrays import Array, Indices
from clothfit.engine.system import build
from clothfit.scene.scene import Scene
from clothfit.subspace import carrier

STAYS, CARRIED = -1, 0
"""Of `way`: a vertex that is fixed, and one that the mean of the pins carries; 1 + p follows pin p."""


class Still(NamedTuple):
    """An object at the start; the names of the fields are those of the arrays in MODEL."""

    start: NDArray[np.float32]  # x₀, (n, 3), m
    before: NDArray[np.float32]  # (r,), the coordinates that stand for those a step before the start
    triangles: Indices  # (T, 3)
    way: Indices  # (n,)

    @property
    def pins(self) -> int:
        """Number of pins."""
        return max(0, int(self.way.max(initial=0)))


def still(scene: Scene, c: int, basis: Array) -> Still:
    """Object c of a scene, with its basis (n, 3, r)."""
    system = build(scene, c, steps=1)
    way = np.where(system.vertex.free, CARRIED, STAYS).astype(np.int32)
    if system.inputs is not None:
        way[system.inputs.pins] = 1 + np.arange(len(system.inputs.pins))
    before = -system.h * carrier.start_velocity(system, basis)
    triangles = np.ascontiguousarray(scene.cloths[c].triangles, np.int32)
    return Still(system.x0.astype(np.float32), before.astype(np.float32), triangles, way)
