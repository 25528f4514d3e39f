"""What an engine and its thread hand to each other, and how a divergence reads."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np

from clothfit.base.arrays import Array
from clothfit.base.errors import InvalidInput
from clothfit.live.moving import Moving
from clothfit.motion.divergence import Diverged, Fault, States, worst
from clothfit.scene.scene import Scene


class Frame(NamedTuple):
    """What the thread has finished."""

    number: int  # steps since the start
    time: float  # s
    mark: int  # what `reset` gave with the scene; 0 at first
    positions: Array  # (n, 3), m, of all objects, in the scene's axes; never written to again


@dataclass
class Wishes:
    """What is asked of the thread, to be done before its next step."""

    scene: Scene | None = None  # to go on in
    mark: int = 0  # of its frames
    rebuild: bool = False  # whether its pins or obstacles differ
    restart: bool = False
    grips: dict[int, tuple[int, Array] | None] = field(default_factory=dict)  # by object: vertex and place, or let go

    def __bool__(self) -> bool:
        return self.scene is not None or self.restart or bool(self.grips)


def checked_speed(speed: float | None) -> float | None:
    """A speed. Raises InvalidInput when it is none."""
    known = isinstance(speed, (int, float)) and not isinstance(speed, bool)
    if speed is not None and not (known and 1e-3 <= speed <= 1e3):
        raise InvalidInput(f"speed: a number from 0.001 to 1000 is needed, or None; {speed!r} was given")
    return None if speed is None else float(speed)


def diverged(cloth: Moving) -> Diverged:
    """The error for a cloth whose next step is not good."""
    from clothfit.engine.stability import advice

    scene, (x, v), step = cloth.scene, cloth.bad, cloth.step + 1
    states = States(np.array([step - 1, step], np.int32), np.stack([cloth.x, x]), np.stack([cloth.v, v]))
    vertex, count = worst(x, cloth.v), len(cloth.x)
    place = f"objects[{cloth.index}], vertex {vertex} of {count}"
    at = f"at step {step} (t = {step * scene.delta:.4g} s)"
    message = f"{scene.name}: the simulation diverged {at}, {place}; {advice(scene, cloth.index)}"
    return Diverged(message, step, None, Fault(cloth.index, states))
