"""Families of springs and regions of a cloth: the groups that share one parameter in mode R.

A spring is an edge where it is a side of a triangle, and bends where it joins the two vertices opposite a shared side,
or the ends of two edges in a row of a grid. `directions` says which edges run along the cloth, across it or diagonally;
a bending spring is named by the direction in which it bends the cloth, which is across its hinge: over an edge across
the cloth it bends along it. On a mesh without directions there are just edges and bending.

n vertices, S springs.
"""

from __future__ import annotations

from dataclasses import replace
from functools import lru_cache
from typing import Any, NamedTuple

import numpy as np

from clothfit.base.arrays import Array, Indices
from clothfit.scene import directions
from clothfit.scene.cloth import ELSEWHERE, Cloth, Layout
from clothfit.scene.directions import ACROSS, ALONG, DIAGONAL, NONE, Edges, Keys, Slots

WAYS = (" along", " across", " diagonal", "")  # in the order of the classes of edges
FAMILIES = (*(f"edges{way}" for way in WAYS), *(f"bending{way}" for way in WAYS), "other")
OTHER = len(FAMILIES) - 1

WHOLE = "all"
"""The name of the group of all vertices, where a cloth has no regions."""


class Groups(NamedTuple):
    """Groups of the elements, vertices or springs, of a cloth; each has a member."""

    names: tuple[str, ...]
    of: Indices  # (elements,), the group of each, read-only


def spring_groups(cloth: Cloth) -> Groups:
    """The groups of the springs of a cloth: their families in each region.

    A spring lies in the first region that has both its ends. The families are those that the file gives, else those of
    the mesh, along the warp that it gives.
    """
    return _spring_groups(_Same(cloth.positions, cloth.triangles, cloth.springs, cloth.layout))


def vertex_groups(cloth: Cloth) -> Groups:
    """The groups of the vertices of a cloth: its regions. A vertex lies in the first region that has it."""
    regions = cloth.layout.regions
    if not regions:
        return _kept((WHOLE,), np.zeros(len(cloth.positions), np.intp))
    names = *(region.name for region in regions), ELSEWHERE
    return _kept(names, _region(np.arange(len(cloth.positions)), cloth.layout))


class _Same:
    """Some objects as a key: equal to itself and to others of the very same objects, however large they are."""

    def __init__(self, *objects: Any) -> None:
        self.objects = objects

    def __hash__(self) -> int:
        return hash(tuple(map(id, self.objects)))

    def __eq__(self, other: object) -> bool:
        return isinstance(other, _Same) and all(a is b for a, b in zip(self.objects, other.objects, strict=True))


@lru_cache(maxsize=8)
def _spring_groups(key: _Same) -> Groups:
    """The same, kept: every scene of a fit has the same positions, triangles, springs and layout."""
    springs, layout = key.objects[2], with_families(*key.objects)
    names, family, regions = layout.names, np.asarray(layout.family), layout.regions
    if not regions:
        return _kept(names, family)
    count = len(regions) + 1
    whole = [f"{name}, {part}" for name in names for part in (*(region.name for region in regions), ELSEWHERE)]
    return _kept(tuple(whole), family.astype(np.intp) * count + _region(springs, layout))


def with_families(positions: Array, triangles: Indices, springs: Indices, layout: Layout) -> Layout:
    """The layout with the families of the mesh, where it gives none."""
    if layout.family is not None:
        return layout
    given = None if layout.warp is None else np.broadcast_to(layout.warp, triangles.shape)
    found = _kept(FAMILIES, families_of(positions, triangles, springs, given))
    return replace(layout, names=found.names, family=found.of)


def _region(elements: Indices | Slots, layout: Layout) -> Slots:
    """The region of each of some vertices (E,) or springs (E, 2), by their vertices; the last is elsewhere."""
    found = np.full(len(elements), len(layout.regions))
    for i in reversed(range(len(layout.regions))):
        inside = np.isin(elements, layout.regions[i].vertices)
        found[inside if inside.ndim == 1 else inside.all(axis=1)] = i
    return found


def _kept(names: tuple[str, ...], of: Slots | Indices) -> Groups:
    """The groups that have members."""
    used, found = np.unique(of, return_inverse=True)
    group = found.astype(np.int32)
    group.setflags(write=False)
    return Groups(tuple(names[i] for i in used), group)


def families_of(positions: Array, triangles: Indices, springs: Indices, given: Array | None = None) -> Slots:
    """The family (S,) of each spring, an index into FAMILIES; `given` (T, 3) is the direction along the cloth in each
    triangle, where that is known.
    """
    key = directions.keys(springs)
    found = np.full(len(springs), OTHER)
    if not len(triangles) or not len(springs):
        return found
    edges = directions.edges_of(triangles)
    of_edge = directions.classes(positions, triangles, edges, given)
    for keys, family in (_rows(edges, of_edge), _hinges(triangles, edges, of_edge)):
        at = directions.places(key, keys)
        found[at >= 0] = family[at[at >= 0]]
    at, first = directions.places(key, edges.key), np.zeros(len(key), bool)
    first[np.unique(key, return_index=True)[1]] = True
    known = (at >= 0) & (first | (found == OTHER))  # of two springs between the same vertices one bends
    found[known] = of_edge[at[known]]
    return found


def _hinges(triangles: Indices, edges: Edges, of_edge: Slots) -> tuple[Keys, Slots]:
    """Pairs of vertices opposite a shared edge, as keys, and their families."""
    pairs = directions.pairs_of(edges)
    opposite = directions.opposite(triangles, pairs)
    apart = opposite[:, 0] != opposite[:, 1]
    bends = np.array([ACROSS, ALONG, DIAGONAL, NONE]) + len(WAYS)
    return directions.keys(opposite)[apart], bends[of_edge[pairs.edge]][apart]


def _rows(edges: Edges, of_edge: Slots) -> tuple[Keys, Slots]:
    """Pairs of vertices that two edges of a grid in a row join, as keys, and their families."""
    found = [(np.zeros(0, np.int64), np.zeros(0, np.intp))]
    for way in (ALONG, ACROSS):
        ends = edges.ends[of_edge == way]
        middle, other = np.concatenate([ends, ends[:, ::-1]]).T
        order = np.argsort(middle, kind="stable")
        count = np.bincount(middle)
        start = (np.cumsum(count) - count)[count == 2]
        pairs = np.stack([other[order[start]], other[order[start + 1]]], axis=1)
        found.append((directions.keys(pairs), np.full(len(pairs), len(WAYS) + way)))
    key, family = zip(*found, strict=True)
    return np.concatenate(key), np.concatenate(family)
