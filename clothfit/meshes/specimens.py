"""Specimens of the tests of fabrics, whose shape at rest shows how a fabric bends and stretches, with what holds them.

    drape       a disc between the two smaller discs of a drape tester (G. E. Cusick, The measurement of fabric drape,
                Journal of the Textile Institute 59, 1968): what is between these is fixed, the rest hangs down
    cantilever  a strip that juts out over an edge and bends under its weight (F. T. Peirce, The "handle" of cloth as a
                measurable quantity, Journal of the Textile Institute 21, 1930): what lies on the table is fixed
    strip       a strip that hangs from its upper side

All are grids along the warp, x, but the disc: there a grid ends in the circles.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from clothfit.base.arrays import Array, Flags
from clothfit.base.errors import InvalidInput
from clothfit.meshes.mesh import Mesh, plane

DRAPE, CANTILEVER, STRIP = SPECIMENS = ("drape", "cantilever", "strip")

SIZES = {DRAPE: (0.30, 0.18), CANTILEVER: (0.15, 0.025), STRIP: (0.30, 0.05)}
"""Of the disc and of the discs that hold it, their diameters; of strips, what is free and its width, m."""

HELD = 2
"""Rows of cells of a cantilever that lie on the table."""


class Specimen(NamedTuple):
    """A mesh and what holds it."""

    mesh: Mesh
    fixed: Flags  # (n,)
    warp: tuple[float, float, float]


def specimen(kind: str, divisions: int, size: tuple[float, float] | None = None) -> Specimen:
    """A specimen with divisions + 2 vertices across its longer side. Raises InvalidInput where none can be made."""
    first, second = size or SIZES[kind]
    if not (first > 0 and second > 0) or (kind == DRAPE and not second < first):
        raise InvalidInput(f"{kind}: {first:g} by {second:g} m: nothing can be made of that"
                           + (", the disc must be larger than what holds it" if kind == DRAPE else ""))  # fmt: skip
    if kind == DRAPE:
        return disc(divisions + 1, first / 2, second / 2)
    if kind == STRIP:
        mesh = plane(divisions, second, first, upright=True)
        top = mesh.positions[:, 1].max()
        return Specimen(mesh, mesh.positions[:, 1] >= top - 1e-9 * first, (0.0, 1.0, 0.0))
    cell = first / (divisions + 1)
    mesh = plane(divisions + HELD, first + HELD * cell, second)
    x = mesh.positions[:, 0] - mesh.positions[:, 0].min() - HELD * cell
    positions = np.column_stack([x, mesh.positions[:, 1:]])
    return Specimen(mesh._replace(positions=positions), x <= 0.5 * cell, (1.0, 0.0, 0.0))


def disc(cells: int, radius: float, held: float) -> Specimen:
    """A disc of so many cells across, m, held within a radius."""
    from scipy.spatial import Delaunay

    cell = 2 * radius / max(cells, 4)
    count = int(np.ceil(radius / cell)) + 1
    i, j = (each.ravel() for each in np.meshgrid(np.arange(-count, count + 1), np.arange(-count, count + 1)))
    points = cell * np.column_stack([i, j]).astype(float)
    away = np.hypot(*points.T)
    kept = (away < radius - 0.6 * cell) & (np.abs(away - held) > 0.6 * cell)
    rings = [ring(held, cell), ring(radius, cell)]
    points = np.concatenate([points[kept], *rings])
    # a grid has two triangulations of each cell: those whose diagonals alternate
    tilt = np.where((i + j)[kept] % 2 == 0, 1e-4 * cell, -1e-4 * cell)
    bent = points * (1 + np.concatenate([0 * tilt, np.zeros(sum(map(len, rings)))])[:, None])
    bent[: len(tilt)] += np.column_stack([tilt, 0 * tilt])
    triangles = Delaunay(bent).simplices
    a, b, c = (points[triangles[:, k]] for k in range(3))
    area = 0.5 * ((b - a)[:, 0] * (c - a)[:, 1] - (b - a)[:, 1] * (c - a)[:, 0])
    triangles = np.where((area > 0)[:, None], triangles, triangles[:, ::-1])[np.abs(area) > 1e-3 * cell**2]
    positions = np.column_stack([points[:, 0], np.zeros(len(points)), points[:, 1]])
    fixed = np.hypot(*points.T) <= held * (1 + 1e-9)
    return Specimen(Mesh(positions, triangles.astype(np.int32)), fixed, (1.0, 0.0, 0.0))


def ring(radius: float, cell: float) -> Array:
    """Points of a circle about a cell apart, as many as lie alike to both axes, (N, 2) m."""
    count = 4 * max(2, round(np.pi * radius / (2 * cell)))
    angle = 2 * np.pi * np.arange(count) / count
    return radius * np.column_stack([np.cos(angle), np.sin(angle)])
