"""Welding joins the vertices of a mesh that lie at one place and removes what no cloth can have.

It removes triangles that collapse, triangles with the corners of an earlier one, and vertices in no triangle. The rest
keeps its order, so a mesh with nothing to join stays as it is.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from clothfit.base.arrays import Indices
from clothfit.meshes.mesh import Mesh
from clothfit.meshes.problems import tiny
from clothfit.meshes.topology import first_of_each, together


class Welded(NamedTuple):
    """A welded mesh, which had n vertices before."""

    mesh: Mesh  # the welded one
    vertices: Indices  # (n,), the new index of each old vertex; −1: it was in no triangle and is removed
    joined: int  # number of vertices that became part of another
    triangles: int  # number of triangles that were removed

    @property
    def unused(self) -> int:
        """Number of vertices that were removed."""
        return int((self.vertices < 0).sum())

    @property
    def renumbered(self) -> bool:
        """Whether some vertex has another index than before."""
        return not np.array_equal(self.vertices, np.arange(len(self.mesh.positions)))


def weld(mesh: Mesh, distance: float | None = None) -> Welded:
    """Join vertices within `distance`, m, of each other (default: a millionth of the mesh's diagonal). The first vertex
    of each group keeps its place. Raises InvalidInput when the distance joins more than seams.
    """
    lot = together(mesh.positions, tiny(mesh) if distance is None else distance)
    triangles = lot[mesh.triangles]
    a, b, c = triangles.T
    triangles = triangles[(a != b) & (b != c) & (a != c)]
    triangles = triangles[first_of_each(np.sort(triangles, axis=1))]
    kept = np.unique(triangles)
    number = np.full(len(lot), -1, np.int32)
    number[kept] = np.arange(len(kept))
    made = Mesh(mesh.positions[kept], number[triangles].reshape(-1, 3))
    joined = int((lot != np.arange(len(lot))).sum())
    return Welded(made, number[lot], joined, len(mesh.triangles) - len(triangles))
