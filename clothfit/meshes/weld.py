"""Welding joins the vertices of a mesh that lie at one place and removes what no cloth can have.

It removes triangles that collapse, triangles with the corners of an earlier one, and vertices in no triangle. The rest
keeps its order, so a mesh with nothing to join stays as it is.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from clothfit.base.arrays import Indices
from clothfit.formats.animation import Parts
from clothfit.meshes.mesh import Mesh
from clothfit.meshes.problems import first_of_each, tiny, together


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
    stay = np.flatnonzero((a != b) & (b != c) & (a != c))
    stay = stay[first_of_each(np.sort(triangles[stay], axis=1))]
    triangles = triangles[stay]
    kept = np.unique(triangles)
    number = np.full(len(lot), -1, np.int32)
    number[kept] = np.arange(len(kept))
    texture = None if mesh.texture is None else mesh.texture[stay]
    made = Mesh(mesh.positions[kept], number[triangles].reshape(-1, 3), texture, _parts(mesh.parts, number[lot]))
    joined = int((lot != np.arange(len(lot))).sum())
    return Welded(made, number[lot], joined, len(mesh.triangles) - len(triangles))


def _parts(parts: Parts, number: Indices) -> Parts:
    """The parts with the new vertices; those that are left with none are left out."""
    moved = ((name, np.unique(number[own])) for name, own in parts)
    left = ((name, own[own >= 0]) for name, own in moved)
    return tuple((name, own) for name, own in left if len(own))
