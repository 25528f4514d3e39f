"""Closed meshes for tests: vertices (V, 3), m, and triangles (T, 3), facing outward."""

from typing import Any

import numpy as np

from clothfit.base.arrays import Array, Indices
from helpers.physics import xyz


def sphere(rows: int, radius: float = 1.0) -> tuple[Array, Indices]:
    """A ball about the origin: so many rows of triangles from pole to pole, twice as many around."""
    around, tilt = 2 * rows, np.pi * np.arange(1, rows) / rows
    turn = 2 * np.pi * np.arange(around) / around
    ring = np.stack([np.cos(turn), np.zeros(around), -np.sin(turn)], axis=1)
    rings = np.sin(tilt)[:, None, None] * ring + np.cos(tilt)[:, None, None] * [0, 1, 0]
    points = np.concatenate([[[0, 1, 0]], rings.reshape(-1, 3), [[0, -1, 0]]])
    i, last = np.arange(around), len(points) - 1
    j = (i + 1) % around
    faces = [np.stack([np.zeros_like(i), 1 + i, 1 + j], axis=1)]
    for r in range(rows - 2):
        a, b = 1 + r * around + i, 1 + r * around + j
        faces += [np.stack([a, a + around, b], axis=1), np.stack([b, a + around, b + around], axis=1)]
    bottom = last - around
    faces.append(np.stack([np.full_like(i, last), bottom + j, bottom + i], axis=1))
    return radius * points, np.concatenate(faces).astype(np.int32)


def torus(large: int, small: int, radius: float = 1.0, tube: float = 0.35) -> tuple[Array, Indices]:
    """A ring about the y axis, with so many edges around it and around its tube."""
    u, w = (2 * np.pi * np.arange(count) / count for count in (large, small))
    out = radius + tube * np.cos(w)
    points = np.stack([np.outer(np.cos(u), out), np.tile(tube * np.sin(w), (large, 1)), -np.outer(np.sin(u), out)], 2)
    a = np.arange(large * small).reshape(large, small)
    b, c = np.roll(a, -1, axis=0), np.roll(a, -1, axis=1)
    d = np.roll(b, -1, axis=1)
    faces = [np.stack([a, b, c], 2).reshape(-1, 3), np.stack([b, d, c], 2).reshape(-1, 3)]
    return points.reshape(-1, 3), np.concatenate(faces).astype(np.int32)


def block(lengths: Any = (1, 1, 1)) -> tuple[Array, Indices]:
    """A box about the origin, of twelve triangles."""
    points = np.array([(x, y, z) for x in (-0.5, 0.5) for y in (-0.5, 0.5) for z in (-0.5, 0.5)]) * lengths
    quads = [(0, 1, 3, 2), (4, 6, 7, 5), (0, 4, 5, 1), (2, 3, 7, 6), (0, 2, 6, 4), (1, 5, 7, 3)]
    faces = [(a, b, c) for a, b, c, _ in quads] + [(a, c, d) for a, _, c, d in quads]
    return points, np.array(faces, np.int32)


def body(made: tuple[Array, Indices], **fields: Any) -> dict[str, Any]:
    """A collider of a mesh, as a scene's file has it."""
    points, faces = made
    mesh = {"vertices": [xyz(point) for point in points], "triangles": faces.reshape(-1).tolist()}
    return {"type": 4, "pos": xyz((0, 0, 0)), "scale": xyz((1, 1, 1)), "mesh": mesh, "release": 0, **fields}
