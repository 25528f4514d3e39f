"""Flat meshes for tests of fabrics: a square with a grid or irregular triangles, and a triangular lattice."""

import numpy as np
from scipy.spatial import Delaunay


def square(cells, size=1.0, jitter=0.0, line=None, seed=0):
    """Positions (n, 3) in the plane of x and z, and triangles (T, 3), of a square of cells × cells, whose inner
    vertices are moved at random by this share of a cell; those at x = `line` · size stay on that line.
    """
    at = np.arange(cells + 1) / cells
    x, z = (each.reshape(-1) for each in np.meshgrid(at, at))
    flat = np.stack([x, z], axis=1)
    free = (flat > 1e-9) & (flat < 1 - 1e-9)
    if line is not None:
        free[:, 0] &= np.abs(x - line) > 1e-9
    flat = flat + np.where(free, np.random.default_rng(seed).uniform(-jitter, jitter, flat.shape) / cells, 0.0)
    if jitter:
        faces = Delaunay(flat).simplices
    else:
        a = (np.arange(cells)[:, None] * (cells + 1) + np.arange(cells)).reshape(-1)
        b, c, d = a + 1, a + cells + 2, a + cells + 1
        faces = np.concatenate([np.stack([a, b, c], axis=1), np.stack([a, c, d], axis=1)])
    (u, v), w = (flat[faces[:, 1]] - flat[faces[:, 0]]).T, (flat[faces[:, 2]] - flat[faces[:, 0]]).T
    faces = faces[np.abs(u * w[1] - v * w[0]) > 1e-9]
    positions = np.zeros((len(flat), 3))
    positions[:, [0, 2]] = size * flat
    return positions, faces.astype(np.int32)


def triangular(rows, columns, length=1.0):
    """A parallelogram of equilateral triangles: positions (n, 3) and triangles (T, 3)."""
    i, j = (each.reshape(-1) for each in np.meshgrid(np.arange(columns), np.arange(rows)))
    positions = length * np.stack([i + 0.5 * j, 0.0 * i, np.sqrt(0.75) * j], axis=1)
    a = (np.arange(rows - 1)[:, None] * columns + np.arange(columns - 1)).reshape(-1)
    b, c, d = a + 1, a + columns, a + columns + 1
    return positions, np.concatenate([np.stack([a, b, c], 1), np.stack([b, d, c], 1)]).astype(np.int32)
