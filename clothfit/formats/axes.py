"""Axes and units of other tools' files, and the scene's: y up, left-handed, metres, as in Unity.

Where z is up in a file, (x, y, z) becomes (x, z, −y); where its axes are right-handed, x is negated, as Unity does with
the models that it imports. Lengths are multiplied by `scale`, m per unit of the file.

What a user says where a file does not say it, or is wrong, is a `Convention`, and for reading with frame rate, frames
and the vertices of markers a `Reading`; the rest comes from the file, else from the convention of its format
(`registry`).
"""

from __future__ import annotations

import math
import os
import re
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, NamedTuple

from clothfit.base.errors import InvalidInput

if TYPE_CHECKING:
    from clothfit.base.arrays import Array, Indices

UPS, HANDS = ("y", "z"), ("left", "right")

UNITS = (1e-12, 1e12)
"""The smallest and the largest unit of a file, m. A motion in other units would be rounded to 0 or to infinity."""

SLICE = re.compile(r"\s*(-?[0-9]{1,18})?\s*:\s*(-?[0-9]{1,18})?\s*")


class Axes(NamedTuple):
    """The axes and the unit of a file's coordinates."""

    up: str = "y"  # the axis that points up, one of UPS
    handedness: str = "right"  # one of HANDS
    scale: float = 1.0  # m per unit of the file

    def __str__(self) -> str:
        unit = "metres" if self.scale == 1 else f"units of {self.scale:g} m"
        return f"{self.up} up, {self.handedness}-handed, {unit}"


SCENE = Axes("y", "left", 1.0)

RIGHT = Axes("y", "right", 1.0)
"""The axes of most other programs."""

Z_UP = Axes("z", "right", 1.0)


def to_scene(points: Array, axes: Axes, own: bool = False) -> Array:
    """Points (…, 3) of a file in the scene's axes, m. Where they are the caller's `own`, frames (F, n, 3) are turned in
    place, one by one: a second copy of a motion takes much memory.
    """
    if own and points.ndim == 3 and points.dtype == float and points.flags.writeable and points.flags.c_contiguous:
        for frame in points:
            frame[:] = to_scene(frame, axes)
        return points
    turned = points.astype(float)
    turned[..., 0] = -points[..., 0] if axes.handedness == "right" else points[..., 0]
    turned[..., 1] = points[..., 2 if axes.up == "z" else 1]
    turned[..., 2] = -points[..., 1] if axes.up == "z" else points[..., 2]
    turned *= axes.scale
    return turned


def from_scene(points: Array, axes: Axes) -> Array:
    """Points (…, 3) of the scene, m, in a file's axes: the inverse of `to_scene`."""
    turned = points.astype(float)
    turned[..., 0] = -points[..., 0] if axes.handedness == "right" else points[..., 0]
    turned[..., 1] = -points[..., 2] if axes.up == "z" else points[..., 1]
    turned[..., 2] = points[..., 1 if axes.up == "z" else 2]
    turned /= axes.scale
    return turned


def facing(triangles: Indices, axes: Axes) -> Indices:
    """Triangles (T, 3) turned from a file's axes to the scene's, or back: a mirror image reverses their corners, so
    that the same side stays the front.
    """
    return triangles[:, ::-1] if axes.handedness == "right" else triangles



@dataclass(frozen=True)
class Convention:
    """Axes and unit of a file; None: those of the file or its format. Raises InvalidInput on an impossible value."""

    scale: float | None = None  # m per unit of the file, within UNITS
    up: str | None = None  # "y" or "z": the axis that points up
    handedness: str | None = None  # "left" or "right"

    def __post_init__(self) -> None:
        positive("scale", self.scale)
        if self.scale is not None and not UNITS[0] <= self.scale <= UNITS[1]:
            raise InvalidInput(f"scale must be {UNITS[0]:g} to {UNITS[1]:g} m per unit; {self.scale:g} was given")
        for name, choices in {"up": UPS, "handedness": HANDS}.items():
            if (value := getattr(self, name)) not in (None, *choices):
                raise InvalidInput(f"{name} must be {' or '.join(choices)}; {value!r} was given")

    def axes(self, default: Axes) -> Axes:
        """These axes, with those of `default` where nothing is said."""
        said: dict[str, Any] = {"scale": self.scale, "up": self.up, "handedness": self.handedness}
        return default._replace(**{name: value for name, value in said.items() if value is not None})


AUTO, ORDER, SURFACE, SCAN = BINDINGS = ("auto", "order", "surface", "scan")
"""What the points of a file may be: the scene's vertices in order, places on its surface, or whichever fits; or a scan,
whose points are others in each frame.
"""


@dataclass(frozen=True)
class Reading(Convention):
    """How to read a file; None: as the file or its format says. Raises InvalidInput on an impossible value."""

    fps: float | None = None  # frames per second, above 0; None: as the file says, else one frame per time step
    frames: str | None = None  # which frames, as in a slice "A:B" of a list; they keep their times
    markers: str | os.PathLike[str] | None = None  # a CSV file of marker, object, vertex; None: the nearest vertices
    bind: str | None = None  # what the file's points are, one of `BINDINGS`; None: auto
    mesh: str | None = None  # of several in a file, by names with commas between; None: those that move

    def __post_init__(self) -> None:
        super().__post_init__()
        positive("fps", self.fps)
        if self.bind not in (None, *BINDINGS):
            raise InvalidInput(f"bind must be {', '.join(BINDINGS[:-1])} or {BINDINGS[-1]}; {self.bind!r} was given")
        self.chosen()

    @property
    def plain(self) -> bool:
        """Whether all fields are None."""
        return self == Reading()

    def chosen(self) -> slice:
        """The frames to read, as a slice. Raises InvalidInput."""
        match = SLICE.fullmatch(self.frames if self.frames is not None else ":")
        if match is None:
            raise InvalidInput(f"frames: {self.frames!r} is not A:B, such as 0:100, 50: or :-1 (B is left out)")
        first, end = (None if word is None else int(word) for word in match.groups())
        return slice(first, end)


def positive(name: str, value: float | None) -> None:
    """Raise InvalidInput unless a value is above 0 and finite."""
    if value is not None and not 0 < value < math.inf:
        raise InvalidInput(f"{name} must be above 0 and finite; {value:g} was given")
