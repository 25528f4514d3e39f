"""How the vertices of a mesh are connected: its edges, its parts, and vertices at one place.

The mesh may be any: many triangles may share an edge, and vertices may be in none.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, TypeAlias

import numpy as np
import numpy.typing as npt

from clothfit.base.arrays import Array, Flags, Indices
from clothfit.base.errors import InvalidInput
from clothfit.base.graph import connected_components
from clothfit.base.messages import metres
from clothfit.meshes.mesh import keys

Numbers: TypeAlias = npt.NDArray[np.integer[Any]]

MOST_PAIRS = 100
"""The most pairs of near vertices per vertex; with more, the distance finds more than seams."""


@dataclass(frozen=True, eq=False)
class Edges:
    """The sides of all triangles, grouped by the edge that they lie at."""

    ends: Indices  # (E, 2), the smaller index first
    of: Numbers  # (3 T,), the edge of each side
    count: Numbers  # (E,), sides at each edge
    along: Flags  # (3 T,), the triangle walks the side from the smaller index to the larger
    opposite: Indices  # (3 T,), the triangle's third corner


def together(positions: Array, distance: float) -> Indices:
    """For each of the positions (n, 3) the first index of its group, in which steps of at most `distance`, m, lead from
    one to the next. Raises InvalidInput where that joins more than seams.
    """
    from scipy.spatial import KDTree

    n = len(positions)
    if not 0 <= distance < np.inf:
        raise InvalidInput(f"weld: the distance must be at least 0 and finite; {distance:g} m was given")
    tree = KDTree(positions)
    if tree.count_neighbors(tree, distance) > (MOST_PAIRS + 1) * n:
        raise InvalidInput(f"weld: within {metres(distance)} of most vertices are too many others; give a smaller one")
    label = connected_components(tree.query_pairs(distance, output_type="ndarray"), n)
    first = np.full(label.max(initial=-1) + 1, n)
    np.minimum.at(first, label, np.arange(n))
    found: Indices = first[label].astype(np.int32)
    return found


def components(pairs: Indices, n: int) -> tuple[Indices, Indices]:
    """The parts into which pairs (P, 2) connect n vertices: the number of vertices of each, largest first, and its
    first vertex; vertices in no pair are left out.
    """
    label = connected_components(pairs, n)
    used = np.unique(pairs)
    _, first, sizes = np.unique(label[used], return_index=True, return_counts=True)
    order = np.argsort(-sizes, kind="stable")
    return sizes[order].astype(np.int32), used[first][order].astype(np.int32)


def edges(triangles: Indices) -> Edges:
    """The sides of the triangles (T, 3), grouped by edge."""
    walked = triangles[:, [[0, 1], [1, 2], [2, 0]]].reshape(-1, 2)
    _, first, group, count = np.unique(keys(walked), return_index=True, return_inverse=True, return_counts=True)
    opposite = triangles[:, [2, 0, 1]].reshape(-1)
    return Edges(np.sort(walked[first], axis=1), group, count, walked[:, 0] < walked[:, 1], opposite)


def across(met: Edges) -> Indices:
    """Pairs (B, 2) of the vertices opposite each edge that triangles share, the smaller index first: the first
    triangle's with that of every other.
    """
    order = np.argsort(met.of, kind="stable")
    starts = np.cumsum(met.count) - met.count
    first = met.opposite[order][np.repeat(starts, met.count)]
    later = np.arange(len(order)) != np.repeat(starts, met.count)
    return np.sort(np.stack([first, met.opposite[order]], axis=1)[later], axis=1)


def first_of_each(rows: Indices) -> Flags:
    """Which of the rows (R, k) are the first of their kind."""
    order = np.lexsort(rows.T)  # keeps equal ones in their order; faster than np.unique of rows
    new = np.ones(len(rows), bool)
    new[1:] = (rows[order[1:]] != rows[order[:-1]]).any(axis=1)
    found = np.zeros(len(rows), bool)
    found[order[new]] = True
    return found
