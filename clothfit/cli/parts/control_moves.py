"""What of a scene `clothfit control` may move, from its options."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import click

from clothfit.base.errors import InvalidInput
from clothfit.cli.common.console import Console
from clothfit.cli.common.options import gathered
from clothfit.cli.parts import checkpoints

if TYPE_CHECKING:
    from clothfit.base.arrays import Flags
    from clothfit.base.checkpoint import Checkpoint
    from clothfit.control.controls import Controls, Handle
    from clothfit.control.keyframes import Key
    from clothfit.scene.cloth import Cloth
    from clothfit.scene.scene import Scene

MOST_MODES = 10_000




@dataclass(frozen=True)
class Moves:
    """The options as they are given."""

    actuate: str | None
    handles: str | None
    wind: bool
    velocity: bool
    every: float | None
    modes: int | None

    def check(self) -> None:
        """Raise InvalidInput on values that cannot be."""
        if self.every is not None and not (math.isfinite(self.every) and self.every > 0):
            raise InvalidInput(f"--every must be above 0; {self.every:g} s was given")
        if self.modes is not None and not 1 <= self.modes <= MOST_MODES:
            raise InvalidInput(f"--modes must be within 1 … {MOST_MODES}; {self.modes} was given")
        if self.modes is not None and self.others and self.actuate is None:
            raise InvalidInput("--modes are shapes of forces; ask for these too: --actuate all")

    @property
    def pushes(self) -> bool:
        """Whether forces are asked for."""
        return self.actuate is not None or not self.others

    @property
    def follows(self) -> bool:
        """Whether forces of every vertex and step are, and nothing else."""
        return not (self.others or self.every or self.modes)

    @property
    def others(self) -> bool:
        """Whether anything else than forces may move."""
        return bool(self.handles or self.wind or self.velocity)

    def of(self, keys: Sequence[Key], scene: Scene) -> Controls:
        """What may move of a scene. Raises InvalidInput."""
        from clothfit.control.controls import Controls

        cloth = min(key.cloth for key in keys)
        pushed = None
        if self.pushes:
            pushed = actuated(self.actuate or "all", cloth, scene)
        handles = handles_of(self.handles, cloth, scene) if self.handles else ()
        if self.wind and not any(own.feels_air for own in scene.cloths):
            raise InvalidInput("--wind: the air drags no object of the scene (dragCoefficient), so no wind moves one")
        return Controls(pushed, handles, self.wind, self.velocity, self.every, self.modes)


options = gathered(
    "moves", Moves,
    click.option("--actuate", metavar="all|VERTICES",
                 help="Forces on these vertices of the first object with keys, such as 0,11,20-30, or on a region of "
                 "the scene.  [default: all, unless something else is to move]"),
    click.option("--handles", metavar="VERTICES",
                 help="Vertices that are led along a path, such as 0,132-143: each number, range or region is one "
                 "handle. pins: those of the scene."),
    click.option("--wind", is_flag=True, help="The wind, over time."),
    click.option("--velocity", is_flag=True, help="The velocities at the start."),
    click.option("--every", type=float, metavar="SECONDS",
                 help="Time between two keys of paths, of the wind and, then, of forces.  "
                 "[default: 0.1; forces of each step]"),
    click.option("--modes", type=int, metavar="COUNT",
                 help="Forces in the first so many modes of vibration only."),
)  # fmt: skip
"""Adds what may move; the function is given it as `moves`."""


def actuated(text: str, cloth: int, scene: Scene) -> list[Flags]:
    """Of each object the vertices on which forces act. Raises InvalidInput."""
    import numpy as np

    flags = [np.ones(count, bool) for count in scene.vertex_counts]
    if text != "all":
        flags[cloth] = named("--actuate", text, scene.cloths[cloth])
        if not (flags[cloth] & ~scene.cloths[cloth].fixed).any():
            raise InvalidInput(f"--actuate {text}: all of these vertices are fixed")
    return flags


def named(option: str, text: str, own: Cloth) -> Flags:
    """The vertices of a region, or of a list of numbers. Raises InvalidInput."""
    import numpy as np

    from clothfit.cli.parts.new_options import ranges
    from clothfit.meshes.new_scene import listed

    for region in own.layout.regions:
        if text.strip() == region.name:
            return np.isin(np.arange(len(own.mass)), region.vertices)
    return listed(len(own.mass), ranges(option, text), option)


def handles_of(text: str, cloth: int, scene: Scene) -> tuple[Handle, ...]:
    """The handles, with commas between them. Raises InvalidInput."""
    import numpy as np

    from clothfit.control.controls import Handle
    from clothfit.scene.keys import Pin

    own, found = scene.cloths[cloth], []
    taken = np.zeros(len(own.mass), bool)
    for part in own.pins if text.strip() == "pins" else text.split(","):
        if isinstance(part, Pin):
            flags = np.isin(np.arange(len(taken)), part.vertices)
        else:
            flags = named("--handles", part, own)
        if (taken & flags).any():
            raise InvalidInput(f"--handles: vertex {np.flatnonzero(taken & flags)[0]} is in two of them")
        taken |= flags
        found.append(Handle(cloth, np.flatnonzero(flags).astype(np.int32)))
    if not found:
        raise InvalidInput(f"--handles pins: objects[{cloth}] has no pins")
    return tuple(found)


@contextmanager
def all_tried() -> Iterator[Callable[..., None]]:
    """What is yielded calls a function that writes a file; where one cannot, the others are written all the same, and
    the first error is raised at the end.
    """
    faults: list[InvalidInput] = []

    def writing(write: Callable[..., object], *arguments: Any) -> None:
        try:
            write(*arguments)
        except InvalidInput as error:
            faults.append(error)

    yield writing
    if faults:
        raise faults[0]


def closed(file: Checkpoint | None, asked: bool, status: str, console: Console) -> None:
    """Remove a checkpoint that nobody asked for and that is no longer useful; say how to go on from another one."""
    if file is None:
        return
    if file.fault:
        console.warn(file.fault)
    if not file.written:
        return
    if status in checkpoints.ENDED:
        if not asked:
            file.remove()
        return
    console.say(f"to go on, repeat the command with --resume: {file.name}")
