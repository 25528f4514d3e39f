"""What a picture of a controlled motion shows beside the cloths: forces as arrows, the means that keys ask for as dots,
and the keys in the place of a target.

F frames, n vertices of all objects.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from clothfit.base.arrays import Array, Indices
from clothfit.control.control import Course
from clothfit.pictures.camera import project
from clothfit.pictures.palette import CLOTHS, RED, TARGET_COLOUR, Colour
from clothfit.pictures.stage import Stage

MOST_ARROWS = 200
"""Of a frame; of more vertices every k-th has one."""

LONGEST, SHORTEST = 0.16, 0.006
"""Length of the arrow of the largest force, and of the shortest one that is drawn, relative to the cloths' size."""

ARROW = RED

FORCE: Colour = (0xD5 / 255, 0x5E / 255, 0.0)
"""The same colour for a legend."""

LEGEND = (("key", TARGET_COLOUR), ("cloth", CLOTHS[0]), ("force", FORCE))
"""Names and colours, from right to left."""


class Marks(NamedTuple):
    """What is drawn at each frame."""

    keys: Array  # (F, n, 3), m, the key that comes next
    arrows: Array  # (F, n, 3), m, from each vertex; 0 where there is none
    dots: tuple[Array, ...]  # of each frame the places (M, 3), m, that means are to be at
    held: Indices  # frames that a film shows for longer
    largest: float  # N, of the longest arrow; 0: there are none

    @property
    def legend(self) -> tuple[tuple[str, Colour], ...]:
        """Names and colours, from right to left."""
        return LEGEND if self.largest > 0 else LEGEND[:-1]

    def seen(self, x: Array) -> list[Array]:
        """What a picture of a motion x (F, n, 3), m, shows beside it: keys and tips of arrows."""
        return [self.keys, x + self.arrows[: len(x)]]


def marks(course: Course) -> Marks:
    """The marks of a course."""
    near = [course.next(frame) for frame in range(len(course.times))]
    size = float(np.linalg.norm(np.ptp(course.own[0], axis=0)))
    strength = np.linalg.norm(course.forces, axis=2)
    largest = float(strength.max(initial=0.0))
    arrows = course.forces * (LONGEST * size / largest if largest > 0 else 0.0)
    pushed = np.flatnonzero(strength.any(axis=0))
    kept = np.zeros(arrows.shape[1], bool)
    kept[pushed[:: max(1, -(-len(pushed) // MOST_ARROWS))]] = True
    arrows[:, ~kept] = 0.0
    arrows[np.linalg.norm(arrows, axis=2) < SHORTEST * size] = 0.0
    return Marks(course.poses[near], arrows, tuple(course.means[k] for k in near), course.due, largest)


def arrows(on: Stage, frame: int, x: Array, found: Marks) -> tuple[Array, Array]:
    """Tails and tips (K, 2), m, in the picture, of the arrows at positions x (n, 3)."""
    own = found.arrows[frame]
    drawn = own.any(axis=1)
    tails = x[drawn] - on.middle[frame]
    return project(on.camera, tails)[:, :2], project(on.camera, tails + own[drawn])[:, :2]


def dots(on: Stage, frame: int, found: Marks) -> Array:
    """The places (M, 2), m, in the picture, that means are to be at."""
    return project(on.camera, found.dots[frame] - on.middle[frame])[:, :2]
