"""Families of springs and regions of a cloth: the groups that share one parameter in mode R.

A spring is an edge where it is a side of a triangle, and bends where it joins the two vertices opposite a shared side,
or the ends of two edges in a row of a grid. `directions` says which edges run along the cloth, across it or diagonally;
a bending spring is named by the direction in which it bends the cloth, which is across its hinge: over an edge across
the cloth it bends along it. On a mesh without directions there are just edges and bending.

n vertices, S springs.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from clothfit.base.arrays import Array, Indices
from clothfit.scene import directions
from clothfit.scene.cloth import Cloth
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
    """The groups of the springs of a cloth: their families in each region."""
    return _kept(FAMILIES, _families(cloth.positions, cloth.triangles, cloth.springs))


def vertex_groups(cloth: Cloth) -> Groups:
    """The groups of the vertices of a cloth: its regions."""
    return _kept((WHOLE,), np.zeros(len(cloth.positions), np.intp))


def _kept(names: tuple[str, ...], of: Slots) -> Groups:
    """The groups that have members."""
    used, found = np.unique(of, return_inverse=True)
    group = found.astype(np.int32)
    group.setflags(write=False)
    return Groups(tuple(names[i] for i in used), group)


def _families(positions: Array, triangles: Indices, springs: Indices, given: Array | None = None) -> Slots:
    """The family (S,) of each spring, an index into FAMILIES."""
    key = directions.keys(springs)
    found = np.full(len(springs), OTHER)
    if not len(triangles) or not len(springs):
        return found
    edges = directions.edges_of(triangles)
    of_edge = directions.classes(positions, triangles, edges, given)
    for keys, family in (
        _rows(edges, of_edge),
        _hinges(triangles, edges, of_edge),
        (edges.key, of_edge),
    ):  # the later ones win
        _assign(found, key, keys, family)
    return found


def _assign(found: Slots, key: Keys, keys: Keys, family: Slots) -> None:
    """Give springs with these keys their families; where a key is there twice, its first one."""
    keys, first = np.unique(keys, return_index=True)
    if len(keys):
        at = np.minimum(np.searchsorted(keys, key), len(keys) - 1)
        known = keys[at] == key
        found[known] = family[first[at[known]]]


def _hinges(triangles: Indices, edges: Edges, of_edge: Slots) -> tuple[Keys, Slots]:
    """Pairs of vertices opposite a shared edge, as keys, and their families."""
    pairs = directions.pairs_of(edges)
    opposite = triangles[pairs.triangle, pairs.side]
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
