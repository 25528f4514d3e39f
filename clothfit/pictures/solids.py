"""Colliders as triangles in axes of their own, and where these axes are over time; plain spheres are drawn as such.

Faces that meet at an edge have vertices of their own there, so that normals, taken at the vertices, are smooth on what
is round and only there. The vertices of a triangle are in the order of the scene's faces: clockwise seen from outside.
"""

from __future__ import annotations

from dataclasses import replace
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from clothfit.base.arrays import Array, Indices
from clothfit.engine.forces.collider_rows import SIZE
from clothfit.engine.inputs.sampling import poses, states
from clothfit.scene.cloth import BOX, MESH, PLANE, Collider
from clothfit.scene.scene import Scene

SEGMENTS, ARC = 48, 12
"""Parts around the axis of a capsule, and along a quarter of a circle at its ends."""

TILES, DARKER = 10, 0.93
"""A plane is drawn as so many by so many tiles, each second one so much darker: they show how it lies and moves."""

PLANE_SIZE = 1.6
"""Half of the side of a plane as it is drawn, relative to the radius of the motion."""


class Solid(NamedTuple):
    """A collider as it is drawn: P points, T triangles, at F times."""

    points: Array  # (P, 3), m, in its own axes
    triangles: Indices  # (T, 3)
    tone: Array  # (P,), brightness of the colour, 1 or less
    centre: Array  # (F, 3), m, where the origin of these axes is
    turn: Array  # (F, 3, 3), their directions, one in each column
    endless: bool  # whether what is drawn is a part of it
    moves: bool
    paths: Array | None = None  # (F, P, 3), m, the points where they go ways of their own

    def at(self, frame: int) -> Array:
        """The points (P, 3) at a frame, m."""
        points = self.points if self.paths is None else self.paths[frame]
        return np.asarray(self.centre[frame] + points @ self.turn[frame].T)


def solids(scene: Scene, times: Array, x: Array) -> tuple[Solid, ...]:
    """The colliders of a scene beside its plain spheres at times (F,), s; planes as large as a motion x (…, 3), m,
    asks for.
    """
    if not scene.colliders:
        return ()
    centres, turns = poses(scene.colliders, times)
    low, high = (end(x.reshape(-1, 3), axis=0) for end in (np.nanmin, np.nanmax))
    reach, made = 0.5 * float(np.linalg.norm(high - low)), []
    for c, each in enumerate(scene.colliders):
        middle = turns[0, c].T @ (0.5 * (low + high) - centres[0, c])
        points, triangles, tone = shape(each, middle, PLANE_SIZE * reach)
        placed = centres[:, c], turns[:, c], each.kind == PLANE, each.moves
        made.append(Solid(points, triangles, tone, *placed, paths_of(each, times)))
    return tuple(made)


def paths_of(collider: Collider, times: Array) -> Array | None:
    """The places (F, P, 3), m, of the vertices of a collider that changes in its axes at times (F,), s."""
    if collider.body is None:
        if collider.scaling is None:
            return None
        sizes = states([collider], times, 1.0, 0)[:, 0, SIZE]
        return np.stack([shape(replace(collider, size=each), np.zeros(3), 0.0)[0] for each in sizes])
    keys = collider.body.motion or collider.scaling
    if keys is None:
        return None
    from clothfit.engine.inputs.body_files import body_of
    from clothfit.engine.inputs.poses import places

    return places(body_of(collider), keys.interpolation, times)


def shape(collider: Collider, middle: Array, half: float) -> tuple[Array, Indices, Array]:
    """Points (P, 3), triangles (T, 3) and tones (P,) of a collider; a plane is drawn up to `half` from `middle` (3,),
    in its own axes, m.
    """
    if collider.kind == PLANE:
        return sheet(middle, half)
    if collider.kind == MESH:
        from clothfit.engine.inputs.body_files import body_of  # what reads all formats, which few scenes need

        place, triangles, _ = body_of(collider).surface
        return place, triangles, np.ones(len(place))
    points, triangles = box(collider.size) if collider.kind == BOX else capsule(*collider.size.tolist())
    return points, triangles, np.ones(len(points))


def sheet(middle: Array, half: float) -> tuple[Array, Indices, Array]:
    """A square of tiles in y = 0, its normal up."""
    row, column = (each.reshape(-1, 1) for each in np.mgrid[0:TILES, 0:TILES])
    corner = np.array([[0, 0], [0, 1], [1, 1], [1, 0]])  # clockwise seen from above, x to the right and z upwards
    side = 2.0 * half / TILES
    x = middle[0] - half + side * (column + corner[:, 0])
    z = middle[2] - half + side * (row + corner[:, 1])
    points = np.stack([x, np.zeros_like(x), z], axis=-1).reshape(-1, 3)
    dark = ((row + column) % 2 == 1).reshape(-1)
    return points, halves(np.arange(len(points)).reshape(-1, 4)), np.repeat(np.where(dark, DARKER, 1.0), 4)


def box(half: Array) -> tuple[Array, Indices]:
    """A box with half of its lengths (3,), m: four vertices for each side."""
    points = []
    for axis in range(3):
        u, v = (axis + 1) % 3, (axis + 2) % 3
        for sign in (1.0, -1.0):
            corners = np.zeros((4, 3))
            corners[:, axis] = sign
            corners[:, u] = [-1, -1, 1, 1]
            corners[:, v] = np.array([-1, 1, 1, -1]) * sign
            points.append(corners * half)
    return np.concatenate(points), halves(np.arange(24).reshape(-1, 4)[:, ::-1])


def capsule(r: float, s: float, length: float) -> tuple[Array, Indices]:
    """A round cone (`forces.surfaces`) along y: its profile, turned about the axis."""
    sine = np.clip((r - s) / length, -1.0, 1.0) if length > 0 else np.sign(r - s)
    seam = float(np.arcsin(sine))  # the latitude at which both balls meet the mantle
    low, high = np.linspace(-0.5 * np.pi, seam, 2 * ARC), np.linspace(seam, 0.5 * np.pi, 2 * ARC)
    radius = np.concatenate([r * np.cos(low), s * np.cos(high)])
    y = np.concatenate([r * np.sin(low) - 0.5 * length, s * np.sin(high) + 0.5 * length])
    angle = 2.0 * np.pi * np.arange(SEGMENTS) / SEGMENTS
    x, z = radius[:, None] * np.cos(angle), radius[:, None] * np.sin(angle)
    points = np.stack([x, np.broadcast_to(y[:, None], x.shape), z], axis=-1).reshape(-1, 3)
    numbers = np.arange(len(points)).reshape(-1, SEGMENTS)
    ring = np.concatenate([numbers, numbers[:, :1]], axis=1)
    cells = np.stack([ring[:-1, :-1], ring[1:, :-1], ring[1:, 1:], ring[:-1, 1:]], axis=-1).reshape(-1, 4)
    return points, halves(cells)


def halves(cells: NDArray[np.integer[Any]]) -> Indices:
    """Two triangles (2 K, 3) for each of the cells (K, 4)."""
    return np.concatenate([cells[:, [0, 1, 2]], cells[:, [0, 2, 3]]]).astype(np.int32)
