"""A moving frame of reference: the axes in which a scene is meant move in those of the world.

    X = turn (x − pivot) + pivot + shift

is the place in the world of what is at x in the scene; at time 0 both are the same. A cloth is simulated in the world,
where no forces of inertia act: its fixed vertices, pins and colliders are led there, and gravity and wind are those of
the world. Linear acceleration, Euler, centrifugal and Coriolis force are in it, as exactly as the steps are, and so
are all derivatives: distances, and with them squared errors, are the same in both. Written as forces in the scene's
axes, they would ask for a term that depends on velocities by an antisymmetric matrix, which a step's symmetric one has
no room for; taken at the step's beginning it adds energy.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from clothfit.base.arrays import Array


class Axes(NamedTuple):
    """The axes at T times."""

    turn: Array  # (T, 3, 3)
    pivot: Array  # (3,), m
    shift: Array  # (T, 3), m

    def at(self, place: int) -> Axes:
        """The axes at one of the times."""
        return Axes(self.turn[place : place + 1], self.pivot, self.shift[place : place + 1])

    def world(self, x: Array) -> Array:
        """Places (T, n, 3) of the scene's axes, or (1, n, 3) that stay there, in the world, m."""
        return np.asarray((x - self.pivot) @ self.turn.transpose(0, 2, 1) + (self.pivot + self.shift)[:, None])

    def own(self, places: Array) -> Array:
        """Places (T, n, 3) of the world in the scene's axes, m."""
        away = places - (self.pivot + self.shift)[:, None]
        return np.asarray(away @ self.turn + self.pivot)

    def directions(self, vectors: Array) -> Array:
        """Vectors (T, n, 3) of the world in the scene's axes."""
        return np.asarray(vectors @ self.turn)

    def world_directions(self, vectors: Array) -> Array:
        """Vectors (T, n, 3) of the scene's axes in the world."""
        return np.asarray(vectors @ self.turn.transpose(0, 2, 1))
