"""The paths of handles, the pins of a scene, as other programs play them: keys of places and turns.

Between two keys a program moves on a straight line at one speed, or stands still where the scene says "hold". That is
what linear keys of the scene are; smooth ones, and turns, are given after every time step, which is all that a
simulation sees of them. Coordinates and quaternions are in right-handed axes with y up, as glTF and USD have them.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from clothfit.base.arrays import Array, Indices
from clothfit.base.errors import InvalidInput
from clothfit.engine.inputs.interpolation import interpolated, resolved
from clothfit.engine.inputs.sampling import pivot_of, turned
from clothfit.formats.axes import RIGHT, from_scene
from clothfit.scene.cloth import Cloth
from clothfit.scene.keys import Keys, Pin
from clothfit.scene.scene import Scene


class Handle(NamedTuple):
    """A path that fixed vertices of an object follow."""

    name: str
    cloth: int  # the object
    vertices: Indices  # (P,), of the object
    times: Array  # (K,), s, from 0 on
    places: Array  # (K, 3), m
    holds: bool  # whether it stays at each place until the next time
    turn_times: Array  # (R,), s
    turns: Array  # (R, 4), quaternions x, y, z, w, of the vertices about the place; (0, 4): they do not turn


def handles(scene: Scene) -> list[Handle]:
    """The handles of all objects, up to the end of the scene's steps. Raises InvalidInput where there is none."""
    if scene.frame:
        raise InvalidInput(f"{scene.name}: frame: paths of pins in axes that move cannot be exported")
    found = []
    for number, cloth in enumerate(scene.cloths):
        for i, pin in enumerate(cloth.pins):
            found += of_pin(scene, number, cloth, pin, f"object{number}_pin{i}")
    if not found:
        raise InvalidInput(f"{scene.name}: has no pins; only their paths are exported (objects[i].pins)")
    return found


def of_pin(scene: Scene, number: int, cloth: Cloth, pin: Pin, name: str) -> list[Handle]:
    """The handle of a pin; of one whose vertices go their own ways a handle for each."""
    steps = scene.delta * np.arange(scene.frames, dtype=float)
    start = cloth.positions[pin.vertices] + cloth.shift
    times, change = path(pin.position, steps)
    turn_times, turns = rotations(pin.rotation, steps)
    holds = pin.position is not None and pin.position.interpolation == "hold"
    if change.ndim == 2 or change.shape[1] == 1:
        pivot = pivot_of(pin.rotation, pin.pivot, start.mean(axis=0) - cloth.shift) + cloth.shift
        places = from_scene(pivot + change.reshape(-1, 3), RIGHT)
        return [Handle(name, number, pin.vertices, times, places, holds, turn_times, turns)]
    if len(turns):
        raise InvalidInput(f"{scene.name}: {name}: vertices that turn while each follows a point cannot be exported")
    return [
        Handle(f"{name}_{vertex}", number, pin.vertices[j : j + 1], times, from_scene(start[j] + change[:, j], RIGHT),
               holds, turn_times, turns)
        for j, vertex in enumerate(pin.vertices.tolist())
    ]  # fmt: skip


def path(keys: Keys | None, steps: Array) -> tuple[Array, Array]:
    """Times (K,), s, and the change since time 0 there, (K, 3) or (K, P, 3), m."""
    if keys is None:
        return steps[:1], np.zeros((1, 3))
    known = resolved(keys)
    end = float(steps[-1])
    times = steps
    if known.interpolation != "smooth" or len(known.times) == 1:
        inside = known.times[(known.times > 0.0) & (known.times < end)]
        times = np.unique(np.concatenate([[0.0], inside, [end]]))
    found = interpolated(known, np.append(0.0, times))
    return times, found[1:] - found[0]


def rotations(keys: Keys | None, steps: Array) -> tuple[Array, Array]:
    """Times (R,), s, and quaternions (R, 4) in right-handed axes; each within half a turn of the one before."""
    from scipy.spatial.transform import Rotation

    if keys is None:
        return np.zeros(0), np.zeros((0, 4))
    mirror = np.diag([-1.0, 1.0, 1.0])
    found = Rotation.from_matrix(mirror @ turned(keys, steps) @ mirror).as_quat()
    opposite = np.concatenate([[False], (found[1:] * found[:-1]).sum(axis=1) < 0.0])
    return steps, found * np.where(np.cumsum(opposite) % 2 == 1, -1.0, 1.0)[:, None]
