"""Which springs of a cloth lie along edges (traction) and which across them (bending), as the file does not say; and
what those across edges add to the stiffness of the sheet in its plane.

The faces show it: a spring between two corners of a face is along an edge; one between the two corners opposite an edge
that two faces share goes across it, and that edge is its hinge. Where the faces show neither, it is `other`.

The spring across the hinge a–b joins c and d, with length L. Where the sheet stretches by ε in a direction at an angle
φ to a spring of length ℓ, that holds k ℓ² cos⁴φ ε²/2: on average over all directions 3/16 k ℓ² ε². So that tools
without springs across edges hold as much, the springs along the five edges of the two faces get, by their angles φ to
the one across,

    k' ℓ² = k L² cos⁴φ / Σ cos⁴φ
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from clothfit.base.arrays import Array, Flags, Indices
from clothfit.meshes.mesh import any_sides
from clothfit.scene.cloth import Cloth
from clothfit.scene.directions import keys, places


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
    own = keys(ends)
    traction, at = np.isin(own, keys(met.edge)), places(own, keys(across))
    bending = ~traction & (at >= 0)
    hinges = ends.copy()
    hinges[bending] = met.edge[second][at[bending]]
    return Roles(traction, bending, hinges)


def edge_stiffness(cloth: Cloth, role: Roles) -> Array:
    """Stiffnesses (S,), N/m, of the springs along edges, with what the bending springs carry; of these their own."""
    found: Array = np.array(cloth.stiffness)
    across, hinge = cloth.springs[role.bending], role.hinges[role.bending]
    if not len(across):
        return found
    (a, b), (c, d) = hinge.T, across.T
    edges = np.stack([np.stack(pair, axis=1) for pair in ((a, b), (a, c), (c, b), (b, d), (d, a))], axis=1)
    spring = springs_of(cloth, role, edges)
    n = cloth.positions[d] - cloth.positions[c]
    e = cloth.positions[edges[..., 1]] - cloth.positions[edges[..., 0]]
    with np.errstate(all="ignore"):
        square = (e * e).sum(axis=2)
        cosine = (e * n[:, None]).sum(axis=2) ** 2 / (square * (n * n).sum(axis=1)[:, None])
        share = np.where(spring >= 0, cosine**2, 0.0)
        whole = cloth.stiffness[role.bending] * cloth.rest[role.bending] ** 2 / share.sum(axis=1)
        added = np.nan_to_num(whole[:, None] * share / square, nan=0.0, posinf=0.0)
    np.add.at(found, spring[spring >= 0], added[spring >= 0])
    return found


def springs_of(cloth: Cloth, role: Roles, edges: Indices) -> Indices:
    """The spring along each of some edges (…, 2); −1 where there is none."""
    known = np.flatnonzero(role.traction)
    at = places(keys(edges.reshape(-1, 2)), keys(cloth.springs[known]))
    return np.append(known, -1)[at].astype(np.int32).reshape(edges.shape[:-1])
