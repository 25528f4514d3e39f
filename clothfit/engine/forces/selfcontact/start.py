"""A cloth that crosses itself at the start cannot be kept from that: where it does."""

from __future__ import annotations

import numpy as np

from clothfit.base.arrays import Array, Indices
from clothfit.base.errors import InvalidScene
from clothfit.engine.forces.selfcontact import candidates
from clothfit.engine.forces.selfcontact.pairs import Surface, boxes


def check(surface: Surface, place: str) -> None:
    """Raise InvalidScene where an edge of a cloth, with this place in the scene, passes through a triangle."""
    found = pierced(surface)
    if not len(found):
        return
    e, t = found[0]
    (a, b), corners = surface.edges[e].tolist(), ", ".join(map(str, surface.triangles[t].tolist()))
    more = f" (and {len(found) - 1} more)" if len(found) > 1 else ""
    raise InvalidScene(
        f"{place}.vertPos: the edge from vertex {a} to {b} passes through the triangle {t} ({corners}){more}; "
        "selfCollision needs a cloth that does not cross itself at the start"
    )


def pierced(surface: Surface) -> Indices:
    """The pairs (M, 2) of an edge and a triangle that it passes through at the start."""
    x, edges, triangles = surface.start, surface.edges, surface.triangles
    found = candidates.overlapping(*boxes(x, x, edges), *boxes(x, x, triangles))
    ends, corners = edges[found[:, 0]], triangles[found[:, 1]]
    apart = ~(ends[:, :, None] == corners[:, None]).any(axis=(1, 2))
    found, (p, q), (a, b, c) = found[apart], x[ends[apart]].swapaxes(0, 1), x[corners[apart]].swapaxes(0, 1)
    across = volumes(a, b, c, p) * volumes(a, b, c, q) < 0.0
    turns = np.array([volumes(p, q, a, b), volumes(p, q, b, c), volumes(p, q, c, a)])
    within = (turns >= 0).all(axis=0) | (turns <= 0).all(axis=0)
    return np.asarray(found[across & within])


def volumes(a: Array, b: Array, c: Array, d: Array) -> Array:
    """Six times the signed volumes (M,) of tetrahedra with these corners (M, 3)."""
    return np.asarray(np.einsum("mi,mi->m", np.cross(b - a, c - a), d - a))
