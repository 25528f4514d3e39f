"""Which edges of a triangle mesh run along the cloth, across it, or diagonally.

Cloth is woven, and most cloth meshes are grids whose cells are cut into two triangles. A *cell* here is a pair of
triangles that, unfolded into a plane at their common side, is nearly a rectangle; that side is a diagonal. In a cell
opposite sides have the same direction and adjacent ones differ. These rules spread through all cells that share sides,
over folds and curves, since only lengths and angles within triangles count. They contradict each other on a mesh
without a direction (around the corner of a cube three cells meet), and there are few cells in an irregular one: neither
gets directions. A direction that is given, such as the warp, says which of the two is along, and where there is no grid
the angle with it decides.

n vertices, T triangles, E edges.
"""

from __future__ import annotations

from typing import Any, NamedTuple, TypeAlias

import numpy as np
import numpy.typing as npt

from clothfit.base.arrays import Array, Flags, Indices
from clothfit.base.eigen import connected_components

ALONG, ACROSS, DIAGONAL, NONE = range(4)
"""The classes of edges."""

SKEW = np.radians(20.0)
"""How far the corners of a cell may be from right angles; those of a rhombus of equilateral triangles are 30° off."""

COVERAGE = 0.5
"""The share of the triangles of a connected piece that the cells of a grid must make up."""

ALIGNED = np.cos(np.radians(30.0)) ** 2
"""The least mean cos² of the angle between the edges of a grid and a given direction that runs along them."""

STRAIGHT, STEEP = np.cos(np.radians([22.5, 67.5])) ** 2
"""cos² of the angles with a given direction below which an edge of no grid runs along, and above which across it."""

Keys: TypeAlias = npt.NDArray[np.int64]
Slots: TypeAlias = npt.NDArray[np.intp]


class Edges(NamedTuple):
    """The edges of a triangle mesh. Side k of a triangle is opposite its corner k."""

    key: Keys  # (E,), `keys` of the ends, rising
    ends: Indices  # (E, 2), the smaller index first
    of: Slots  # (T, 3), the edge of each side
    uses: Slots  # (E,), triangles at each edge

    @property
    def hem(self) -> Indices:
        """The vertices at edges of one triangle alone, where the cloth ends."""
        return np.unique(self.ends[self.uses == 1])


class Pairs(NamedTuple):
    """Pairs of triangles that share an edge."""

    edge: Slots  # (P,)
    triangle: Slots  # (P, 2), the first triangle at the edge and another one
    side: Slots  # (P, 2), the edge's side in each


def keys(pairs: npt.NDArray[np.integer[Any]]) -> Keys:
    """A number for each pair (P, 2) of vertices in either order, sorted by the smaller and then the larger."""
    low, high = np.sort(pairs, axis=1).astype(np.int64).T
    return np.asarray((low << 32) + high)


def places(wanted: Keys, known: Keys) -> Slots:
    """Where each wanted key is first among the known ones; −1 where it is not."""
    distinct, first = np.unique(known, return_index=True)
    if not len(distinct):
        return np.full(len(wanted), -1)
    at = np.minimum(np.searchsorted(distinct, wanted), len(distinct) - 1)
    return np.where(distinct[at] == wanted, first[at], -1)


def edges_of(triangles: Indices) -> Edges:
    """The edges of the triangles (T, 3)."""
    sides = triangles[:, [[1, 2], [2, 0], [0, 1]]].reshape(-1, 2)
    key, first, group, count = np.unique(keys(sides), return_index=True, return_inverse=True, return_counts=True)
    return Edges(key, np.sort(sides[first], axis=1), group.reshape(-1, 3), count)


def pairs_of(edges: Edges) -> Pairs:
    """The pairs of triangles at each shared edge: the first with every other, in the order of the edges."""
    order = np.argsort(edges.of.reshape(-1), kind="stable")
    starts = np.cumsum(edges.uses) - edges.uses
    first = order[np.repeat(starts, edges.uses)]
    later = np.arange(len(order)) != np.repeat(starts, edges.uses)
    met = np.stack([first[later], order[later]], axis=1)
    return Pairs(edges.of.reshape(-1)[order[later]], met // 3, met % 3)


def opposite(triangles: Indices, pairs: Pairs) -> Indices:
    """The two vertices (P, 2) opposite the edge that a pair of the triangles (T, 3) shares, in its order."""
    return triangles[pairs.triangle, pairs.side]


def along(triangles: Indices) -> Flags:
    """Which sides of the triangles (T, 3) they walk from the smaller index to the larger."""
    return triangles[:, [1, 2, 0]] < triangles[:, [2, 0, 1]]


def classes(positions: Array, triangles: Indices, edges: Edges, given: Array | None = None) -> Slots:
    """The class (E,) of each edge. `given` (T, 3) is the direction along the cloth in each triangle; it need neither
    lie in the triangle nor have a length, and where it has none the mesh decides.
    """
    parts, colour = _grid(triangles, edges, angles(positions, triangles))
    aligned = None if given is None else _aligned(positions, triangles, edges, given)
    found = np.full(len(edges.key), NONE)
    if aligned is not None:
        known = ~np.isnan(aligned)
        found[known] = np.select([aligned[known] >= STRAIGHT, aligned[known] <= STEEP], [ALONG, ACROSS], DIAGONAL)
    e = positions[edges.ends[:, 1]] - positions[edges.ends[:, 0]]
    length = np.sqrt((e * e).sum(axis=1))
    unit = np.abs(e) / np.where(length > 0, length, 1.0)[:, None]
    for part in np.unique(parts[parts >= 0]):
        own = np.flatnonzero(parts == part)
        legs = own[colour[own] != DIAGONAL]
        first = _first(unit[legs], None if aligned is None else aligned[legs], colour[legs])
        if first is not None:
            found[own] = np.where(colour[own] == first, ALONG, ACROSS)
            found[own[colour[own] == DIAGONAL]] = DIAGONAL
    return found


def _first(unit: Array, aligned: Array | None, colour: Slots) -> int | None:
    """Which of the two colours of a grid runs along the cloth; None where the given direction follows neither.

    Without one it is that which follows x more, else z, else the colour of the first edge.
    """
    if aligned is not None and not np.isnan(aligned).all():
        means = [float(np.nanmean(aligned[colour == each])) for each in (0, 1)]
        return int(np.argmax(means)) if max(means) >= ALIGNED else None
    x, z = (np.round(unit[colour == 0].mean(axis=0) - unit[colour == 1].mean(axis=0), 2)[[0, 2]]).tolist()
    if x or z:
        return 0 if (x or z) > 0 else 1
    return int(colour[0])


def angles(positions: Array, triangles: Indices) -> Array:
    """The angle (T, 3) at each corner, 0 where a triangle has a side without length."""
    at = positions[triangles]
    out, back = np.roll(at, -1, axis=1) - at, np.roll(at, 1, axis=1) - at
    normal = np.cross(out, back)
    return np.asarray(np.arctan2(np.sqrt((normal * normal).sum(axis=2)), (out * back).sum(axis=2)))


def _aligned(positions: Array, triangles: Indices, edges: Edges, given: Array) -> Array:
    """Mean cos² (E,) of the angle between each edge and the given directions (T, 3) in its triangles; NaN unknown."""
    at = positions[triangles]
    normal = _unit(np.cross(at[:, 1] - at[:, 0], at[:, 2] - at[:, 0]))
    given = _unit(given)
    inside = given - (given * normal).sum(axis=1)[:, None] * normal
    steep = (inside * inside).sum(axis=1) < STEEP  # the direction leaves the cloth, so it says little about it
    inside = _unit(inside)
    sides = _unit(np.roll(at, 1, axis=1) - np.roll(at, -1, axis=1))
    cos = (sides * inside[:, None]).sum(axis=2) ** 2
    known = np.repeat(~steep & (normal.any(axis=1)), 3)
    total, count = (
        np.bincount(edges.of.reshape(-1)[known], weights, len(edges.key))
        for weights in (cos.reshape(-1)[known], None)
    )
    return np.asarray(np.where(count > 0, total / np.maximum(count, 1), np.nan))


def _unit(vectors: Array) -> Array:
    """The vectors (..., 3) with length 1; those without a length stay 0."""
    length = np.sqrt((vectors * vectors).sum(axis=-1, keepdims=True))
    return np.asarray(vectors / np.where(length > 0, length, 1.0))


def _grid(triangles: Indices, edges: Edges, angle: Array) -> tuple[Slots, Slots]:
    """Of each edge (E,) of a mesh with these corner angles (T, 3) the grid that it belongs to, -1 none, and its colour:
    0 or 1 for the two directions of a grid, DIAGONAL.
    """
    cells = _cells(triangles, edges, angle)
    (t, u), (k, j) = cells.triangle.T, cells.side.T
    i = np.argmax(triangles[u] == triangles[t, (k + 1) % 3][:, None], axis=1)  # the same end of the diagonal, in u
    same = np.concatenate([
        np.stack([edges.of[t, (k + 2) % 3], edges.of[u, i]], axis=1),
        np.stack([edges.of[t, (k + 1) % 3], edges.of[u, 3 - i - j]], axis=1),
    ])  # fmt: skip
    half, corner = _halves(edges, angle, cells)
    legs = np.stack([edges.of[half, (corner + 1) % 3], edges.of[half, (corner + 2) % 3]], axis=1)
    part, colour = _coloured(len(edges.key), same, legs)
    part[edges.of[half, corner]], colour[edges.of[half, corner]] = part[legs[:, 0]], DIAGONAL
    piece = connected_components(edges.ends, int(triangles.max(initial=-1)) + 1)
    all_of = np.bincount(piece[triangles[:, 0]], minlength=1)
    own = part[edges.of[t, (k + 1) % 3]]
    halves_of = 2 * np.bincount(own[own >= 0], minlength=2 * len(edges.key))
    part[halves_of[part] < COVERAGE * all_of[piece[edges.ends[:, 0]]]] = -1
    return part, colour


def _cells(triangles: Indices, edges: Edges, angle: Array) -> Pairs:
    """The pairs of triangles that make up a cell each; no triangle is in two."""
    pairs = pairs_of(edges)
    pairs = Pairs(*(each[edges.uses[pairs.edge] == 2] for each in pairs))
    (t, u), (k, j) = pairs.triangle.T, pairs.side.T
    corners = [angle[t, k], angle[u, j]]
    for end in ((k + 1) % 3, (k + 2) % 3):
        same = np.argmax(triangles[u] == triangles[t, end][:, None], axis=1)
        corners.append(angle[t, end] + angle[u, same])
    skew = np.abs(np.stack(corners) - np.pi / 2).max(axis=0)
    least = np.full(len(triangles), SKEW)
    np.minimum.at(least, pairs.triangle, skew[:, None])
    chosen = (skew < SKEW) & (skew <= least[t]) & (skew <= least[u])
    uses = np.bincount(pairs.triangle[chosen].reshape(-1), minlength=len(triangles))
    chosen &= (uses[pairs.triangle] == 1).all(axis=1)
    return Pairs(*(each[chosen] for each in pairs))


def _halves(edges: Edges, angle: Array, cells: Pairs) -> tuple[Slots, Slots]:
    """Triangles that are half a cell, and the corner of each that is a right angle: those of the cells, and those that
    the border of the mesh cuts along the diagonal.
    """
    corner = np.argmin(np.abs(angle - np.pi / 2), axis=1)
    every = np.arange(len(angle))
    lone = np.abs(angle[every, corner] - np.pi / 2) < SKEW
    lone &= edges.uses[edges.of[every, corner]] == 1
    lone[cells.triangle.reshape(-1)] = False
    return (
        np.concatenate([cells.triangle.reshape(-1), every[lone]]),
        np.concatenate([cells.side.reshape(-1), corner[lone]]),
    )


def _coloured(count: int, same: Slots, differ: Slots) -> tuple[Slots, Slots]:
    """Part and colour, 0 or 1, of each of `count` edges, where the pairs (P, 2) of edges in `same` have one colour and
    those in `differ` two; part -1 where an edge is in no pair, or no two colours can be right.

    Each edge is two nodes of a graph, one for each colour that it may have; links join what goes together. Where both
    nodes of an edge are connected, the rules contradict each other.
    """
    links = np.concatenate([same, same + count, differ + [0, count], differ + [count, 0]])
    label = connected_components(links, 2 * count).reshape(2, count)
    part = label.min(axis=0)
    colour = (label[0] != part).astype(np.intp)
    part[label[0] == label[1]] = -1
    untouched = np.ones(count, bool)
    untouched[same], untouched[differ] = False, False
    part[untouched] = -1
    return part, colour

