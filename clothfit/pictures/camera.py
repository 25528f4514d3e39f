"""From a motion to a flat picture: a camera, and which faces stand for a large mesh.

The camera looks along `forward` and projects in parallel onto `right` and `up`, so a sphere appears as a disc:

    u = right · x,    v = up · x,    depth = forward · x    (m; larger is farther)

Scenes are left-handed with y up, like the Unity editor's: seen along +z, +x is to the right, `right` = y × `forward`.
The light comes from the upper left of the camera.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from clothfit.base.arrays import Array, Indices

TRIED_YAWS, PITCH = (30.0, -30.0, 60.0, -60.0, 0.0), 24.0
"""Degrees: the directions of view to try, from +z towards +x, and how far down the camera looks."""

CLEARLY_MORE = 1.15
"""A later direction is chosen only if it shows this many times as much of the cloth as the earlier ones."""

LIGHT = (-0.45, 0.65, -0.6)
"""Towards the light, along right, up and forward."""

VIEW_MARGIN = 0.06
"""Free space around the motion, relative to its size."""

COMPARED_FRAMES = 12
"""Number of frames at which the directions are compared."""


class Camera(NamedTuple):
    """The directions of a view, and the rectangle of the plane of projection that it shows."""

    right: Array  # (3,), unit vectors
    up: Array
    forward: Array
    low: Array  # (2,) m, the lower left corner
    high: Array  # (2,) m, the upper right corner

    @property
    def aspect(self) -> float:
        """Height by width."""
        size = self.high - self.low
        return float(size[1] / size[0])


def looking(yaw: float, pitch: float) -> tuple[Array, Array, Array]:
    """Right, up and forward (3,) of a camera turned by `yaw` degrees from +z towards +x, looking down by `pitch`."""
    turn, tilt = np.radians(yaw), np.radians(pitch)
    forward = np.array([np.sin(turn) * np.cos(tilt), -np.sin(tilt), np.cos(turn) * np.cos(tilt)])
    right = np.array([np.cos(turn), 0.0, -np.sin(turn)])
    return right, np.cross(forward, right), forward


def direction(x: Array, triangles: Indices) -> tuple[Array, Array, Array]:
    """Right, up and forward (3,) of the tried direction that shows most of a motion x (F, n, 3), NaN where unknown."""
    frames = x[np.unique(np.linspace(0, len(x) - 1, COMPARED_FRAMES).round().astype(int))]
    best, most = looking(TRIED_YAWS[0], PITCH), 0.0
    for yaw in TRIED_YAWS:
        axes = looking(yaw, PITCH)
        shown = 0.0
        for frame in frames:
            a, b, c = (_along(frame, axes)[triangles[:, corner], :2].T for corner in range(3))
            (u, v), (p, q) = b - a, c - a
            shown += float(np.nansum(np.abs(u * q - v * p)))
        if shown > (CLEARLY_MORE if most else 1.0) * most:
            best, most = axes, shown
    return best


def facing(x: Array) -> Camera:
    """A camera perpendicular to the plane in which points x (n, 3) spread most."""
    known = x[np.isfinite(x).all(axis=1)]
    _, _, axes = np.linalg.svd(known - known.mean(axis=0), full_matrices=False)
    forward = axes[-1] if len(known) > 2 else np.array([0.0, 0.0, 1.0])
    forward = forward if forward @ (0.0, -1.0, 1.0) >= 0 else -forward
    upright = np.array([0.0, 1.0, 0.0]) if abs(forward[1]) < 0.9 else np.array([0.0, 0.0, 1.0])
    right = np.cross(upright, forward)
    right /= np.linalg.norm(right)
    return framed((right, np.cross(forward, right), forward), known)


def framed(axes: tuple[Array, Array, Array], points: Array) -> Camera:
    """A camera with these right, up and forward that shows all points (n, 3), with some room around them."""
    flat = _along(points[np.isfinite(points).all(axis=1)], axes)[:, :2]
    low, high = (flat.min(axis=0), flat.max(axis=0)) if len(flat) else (np.zeros(2), np.zeros(2))
    room = VIEW_MARGIN * max(float((high - low).max()), 1e-9)
    return Camera(*axes, low - room, high + room)


def shaped(seen: Camera, least: float, most: float) -> Camera:
    """The same camera, its view widened or heightened until height by width is within `least` and `most`."""
    width, height = seen.high - seen.low
    more = 0.5 * np.array([max(height / most - width, 0.0), max(least * width - height, 0.0)])
    return seen._replace(low=seen.low - more, high=seen.high + more)


def project(seen: Camera, x: Array) -> Array:
    """Right, up and depth (…, 3) of positions (…, 3), m."""
    return _along(x, (seen.right, seen.up, seen.forward))


def normals(x: Array, triangles: Indices) -> Array:
    """Normals (T, 3) of faces; their length is twice the area."""
    a, b, c = (x[triangles[:, corner]] for corner in range(3))
    return np.cross(b - a, c - a)


def thinned(x: Array, triangles: Indices, most: int) -> Indices:
    """At most `most` triangles (K, 3) that stand for all `triangles` between vertices x (n, 3).

    The vertices in one cell of a grid are merged into the first of them (J. Rossignac, P. Borrel, Multi-resolution 3D
    approximations, 1993); the grid gets coarser until few enough triangles are left.
    """
    kept, size = triangles, np.sqrt(np.linalg.norm(normals(x, triangles), axis=1).sum() / max(most, 1))
    low = np.nanmin(x, axis=0)
    while len(kept) > most and size > 0:
        cells = np.floor((np.nan_to_num(x) - low) / size).astype(np.int64)
        _, first, own = np.unique(cells, axis=0, return_index=True, return_inverse=True)
        corners = first[own.reshape(-1)][triangles]
        apart = (corners != np.roll(corners, 1, axis=1)).all(axis=1)
        _, one = np.unique(np.sort(corners[apart], axis=1), axis=0, return_index=True)
        kept, size = corners[apart][np.sort(one)], 1.2 * size
    return kept


def _along(x: Array, axes: tuple[Array, Array, Array]) -> Array:
    return np.asarray(x @ np.stack(axes, axis=1))
