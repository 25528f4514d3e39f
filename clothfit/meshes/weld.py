"""To join the vertices of a mesh that lie at one place, and to leave out what no cloth can have.

Triangles that collapse are left out, of those with the same corners all but the first, and vertices in none. The rest
keeps its order, so that a mesh with nothing to join stays as it is.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from clothfit.base.arrays import Indices
from clothfit.meshes.mesh import Mesh
from clothfit.meshes.problems import tiny
from clothfit.meshes.topology import first_of_each, together


class Welded(NamedTuple):
    """A mesh that was welded; n vertices before."""

    mesh: Mesh
    vertices: Indices  # (n,), vertex now of each vertex before; −1: it is in no triangle and left out
    joined: int  # vertices that became part of another
    triangles: int  # that were left out

    @property
    def unused(self) -> int:
        """Vertices that were left out."""
        return int((self.vertices < 0).sum())

    @property
    def renumbered(self) -> bool:
        """Whether vertices have another index than before."""
        return not np.array_equal(self.vertices, np.arange(len(self.mesh.positions)))


def weld(mesh: Mesh, distance: float | None = None) -> Welded:
    """Join vertices within `distance`, m, of each other (default: what counts as one place); of each lot the first
    stays where it is. Raises InvalidInput when the distance joins more than seams.
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
