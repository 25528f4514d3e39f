"""Which springs of a cloth lie along edges (traction) and which across them (bending), as the file does not say.

The faces show it: a spring between two corners of a face is along an edge; one between the two corners opposite an edge
that two faces share goes across it, and that edge is its hinge. Where the faces show neither, it is `other`.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from clothfit.base.arrays import Flags, Indices
from clothfit.meshes.mesh import any_sides, keys
from clothfit.scene.cloth import Cloth


class Roles(NamedTuple):
    """The roles of the S springs of a cloth."""

    traction: Flags  # (S,) along an edge
    bending: Flags  # (S,) across one
    hinges: Indices  # (S, 2) the edge that a bending spring goes across, the smaller vertex first; else its own ends

    def name(self, spring: int) -> str:
        """The role of a spring, in words."""
        return "traction" if self.traction[spring] else "bending" if self.bending[spring] else "other"

    @property
    def names(self) -> list[str]:
        """The roles of all springs, in words."""
        return [self.name(spring) for spring in range(len(self.traction))]


def roles(cloth: Cloth) -> Roles:
    """Find the role of each spring of a cloth."""
    ends, met = np.sort(cloth.springs, axis=1), any_sides(cloth.triangles)
    second = met.first != np.arange(len(met.first))
    across = np.stack([met.opposite, met.opposite[met.first]], axis=1)[second]
    own, (known, at) = keys(ends), np.unique(keys(across), return_index=True)
    traction = np.isin(own, keys(met.edge))
    bending = ~traction & np.isin(own, known)
    hinges = ends.copy()
    hinges[bending] = met.edge[second][at[np.searchsorted(known, own[bending])]]
    return Roles(traction, bending, hinges)
