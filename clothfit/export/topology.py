"""Which springs of a cloth lie along edges (traction) and which across them (bending): the file does not say.

The faces tell: a spring between two corners of a face is along an edge; one between the two corners opposite an edge
that two faces share goes across it, and that edge is its hinge. Where the faces tell neither, it is `other`.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from clothfit.base.arrays import Flags, Indices
from clothfit.scene.cloth import Cloth


class Roles(NamedTuple):
    """What the springs of a cloth are for; S springs."""

    traction: Flags  # (S,) along an edge
    bending: Flags  # (S,) across one
    hinges: Indices  # (S, 2) the edge that a bending spring goes across, the smaller vertex first; else its own ends

    def name(self, spring: int) -> str:
        """In words."""
        return "traction" if self.traction[spring] else "bending" if self.bending[spring] else "other"

    @property
    def names(self) -> list[str]:
        """All in words."""
        return [self.name(spring) for spring in range(len(self.traction))]


def roles(cloth: Cloth) -> Roles:
    """Tell the springs of a cloth apart."""
    ends = np.sort(cloth.springs, axis=1)
    edges = np.sort(cloth.triangles[:, [[0, 1], [0, 2], [1, 2]]].reshape(-1, 2), axis=1)
    opposite = cloth.triangles[:, [2, 1, 0]].reshape(-1)
    if not len(edges) or not len(ends):
        none = np.zeros(len(ends), dtype=np.bool_)
        return Roles(none, none, ends)
    _, found, group = np.unique(edges, axis=0, return_index=True, return_inverse=True)
    first = found[group.reshape(-1)]
    second = first != np.arange(len(first))
    across = np.sort(np.stack([opposite, opposite[first]], axis=1), axis=1)[second]
    traction = np.isin(key(ends, cloth), key(edges, cloth))
    keys, at = np.unique(key(across, cloth), return_index=True)
    place = np.minimum(np.searchsorted(keys, key(ends, cloth)), max(len(keys) - 1, 0))
    bending = ~traction & (keys[place] == key(ends, cloth)) if len(keys) else np.zeros(len(ends), dtype=np.bool_)
    hinges = np.where(bending[:, None], edges[second][at[place]], ends) if len(keys) else ends
    return Roles(traction, bending, hinges)


def key(pairs: Indices, cloth: Cloth) -> Indices:
    """One number for each pair of vertices."""
    numbers: Indices = pairs[:, 0].astype(np.int64) * len(cloth.mass) + pairs[:, 1]
    return numbers
