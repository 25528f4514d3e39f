"""A tree of boxes about triangles, in which what is near is found without looking at the rest.

The tree is built once, where the triangles are at the start: each of its nodes halves them along the widest side of
their middles. Where they move, only the boxes change (`refit`). Nodes stand in preorder: after a node comes the first
of its two, and `skip` says which node comes after all that is below it. So a search needs no stack,

    node = root;  while node < end:  node = skip[node] where the box of node is too far, else node + 1.

Vertices and edges have such trees as well. What overlaps of two of them is found leaf by leaf of the one.
"""

from __future__ import annotations

from typing import NamedTuple, TypeAlias

import numpy as np
import numpy.typing as npt

from clothfit.base.arrays import Array, Indices
from clothfit.kernels.kernel import kernel
from clothfit.kernels.lanes.operations import add, lane0, lane1, lane2, load3, pack, splat, sub, where_less

Numbers: TypeAlias = npt.NDArray[np.int64]

LEAF = 4
"""Triangles of a leaf, at most."""

ROOM = 32
"""Pairs for each triangle that there is room for at first."""


class Tree(NamedTuple):
    """Boxes about T triangles, which stand leaf by leaf. N nodes."""

    box: Array  # (N, 6), m: the lowest x, y, z and the highest
    skip: Indices  # (N,), the node after all that is below
    first: Indices  # (N,), of the triangles of a leaf; as `last` where it is none
    last: Indices  # (N,), below which they are


class Parts(NamedTuple):
    """Triangles, edges or vertices that have a tree, T of them with m vertices each, leaf by leaf."""

    vertices: Indices  # (T, m)
    number: Indices  # (T,), of each before they were so ordered
    tree: Tree


def empty(size: int) -> Tree:
    """Memory for so many nodes."""
    return Tree(np.zeros((size, 6)), *(np.zeros(size, np.int32) for _ in range(3)))


def build(middle: Array) -> tuple[Tree, Indices]:
    """A tree with empty boxes for triangles with these middles (T, 3), at least one, and their order in it (T,)."""
    count = len(middle)
    levels = max(0, int(np.ceil(np.log2(count / LEAF))))
    order: Numbers = np.arange(count)
    begin, node = np.zeros(1, np.int64), np.zeros(1, np.int64)
    size = 2 ** (levels + 1) - 1
    tree = empty(size)
    for level in range(levels + 1):
        below = 2 ** (levels - level + 1) - 1
        tree.skip[node] = node + below
        if level < levels:
            order = halved(middle, order, begin)
            node = np.stack([node + 1, node + 1 + below // 2], axis=1).reshape(-1)
            begin = np.arange(2 ** (level + 1), dtype=np.int64) * count >> (level + 1)
    tree.first[node], tree.last[node] = begin, np.append(begin[1:], count)
    return tree, order.astype(np.int32)


def halved(middle: Array, order: Numbers, begin: Numbers) -> Numbers:
    """The order (T,) in which each group, from one of `begin` to the next, is sorted along its widest side."""
    placed = middle[order]
    width = np.maximum.reduceat(placed, begin) - np.minimum.reduceat(placed, begin)
    group = np.repeat(np.arange(len(begin)), np.diff(np.append(begin, len(order))))
    along = placed[np.arange(len(order)), width.argmax(axis=1)[group]]
    return order[np.lexsort((along, group))]


def parts(vertices: Indices, place: Array) -> Parts:
    """Parts with these vertices (T, m), which are at place (V, 3)."""
    if not len(vertices):
        return Parts(vertices, np.zeros(0, np.int32), empty(0))
    tree, order = build(place[vertices].mean(axis=1))
    return Parts(np.ascontiguousarray(vertices[order]), order, tree)


def overlapping(one: Parts, other: Parts, place: Array, way: Array, room: float, margin: float) -> Indices:
    """The pairs (M, 2) of one and of another, or of those of one kind among themselves, the lower number first, that
    may come nearer than some room, m, where each vertex goes straight from its place by its way, (V, 3) each, and ends
    no farther than `margin`, m, from there along each axis.
    """
    if not (len(one.number) and len(other.number)):
        return np.zeros((0, 2), np.int32)
    alike, low, high = one is other, place - 0.5 * room, place + 0.5 * room
    own = fitted(one, low, high), fitted(one, way - margin, way + margin)
    others = own if alike else (fitted(other, low, high), fitted(other, way - margin, way + margin))
    found = np.empty((ROOM * len(one.number), 2), np.int32)
    while (count := search(one, other, own, others, alike, low, high, found)) > len(found):
        found = np.empty((count, 2), np.int32)
    return found[:count]


def fitted(own: Parts, low: Array, high: Array) -> Array:
    """The boxes (N, 6) of the nodes about what their vertices have."""
    tree = own.tree._replace(box=np.empty_like(own.tree.box))
    refit(tree, 0, len(tree.skip), own.vertices, low, high)
    return tree.box


@kernel(nogil=True)
def search(one, other, own, others, alike, low, high, found):
    """Write the pairs that may meet, as many as there is room for; returns how many there are."""
    count = 0
    for leaf in range(len(one.tree.skip)):
        if one.tree.first[leaf] == one.tree.last[leaf]:
            continue
        whole, way, node = bounds(own[0][leaf]), bounds(own[1][leaf]), leaf if alike else 0
        while node < len(other.tree.skip):
            slack = past(way, bounds(others[1][node]))
            if not meet(whole, bounds(others[0][node]), slack):
                node = other.tree.skip[node]
                continue
            for f in range(other.tree.first[node], other.tree.last[node]):
                box = corners(other.vertices[f], low, high)
                for e in range(one.tree.first[leaf], f if alike and node == leaf else one.tree.last[leaf]):
                    if meet(corners(one.vertices[e], low, high), box, slack):
                        if count < len(found):
                            a, b = one.number[e], other.number[f]
                            found[count, 0], found[count, 1] = (b, a) if alike and b < a else (a, b)
                        count += 1
            node += 1
    return count


@kernel
def corners(own, low, high):
    """The lowest and the highest of what vertices have (lanes)."""
    lowest, highest = load3(low, own[0]), load3(high, own[0])
    for e in range(1, len(own)):
        below, above = load3(low, own[e]), load3(high, own[e])
        lowest, highest = where_less(below, lowest, below, lowest), where_less(highest, above, above, highest)
    return lowest, highest


@kernel
def bounds(box):
    """The same of a box of a tree."""
    return pack(box[0], box[1], box[2], 0.0), pack(box[3], box[4], box[5], 0.0)


@kernel
def past(way, other):
    """How far one goes below another, and that below the one, at most, for the bounds of their ways (lanes, ≤ 0)."""
    none, below, above = splat(0.0), sub(other[0], way[1]), sub(way[0], other[1])
    return where_less(below, none, below, none), where_less(above, none, above, none)


@kernel
def meet(one, other, slack):
    """Whether two boxes have a point in common, or may have on ways that go `past` each other by some slack."""
    one_gap, other_gap = add(sub(other[0], one[1]), slack[0]), add(sub(one[0], other[1]), slack[1])
    gap = where_less(one_gap, other_gap, other_gap, one_gap)
    return lane0(gap) <= 0.0 and lane1(gap) <= 0.0 and lane2(gap) <= 0.0


@kernel(nogil=True)
def refit(tree, root, end, parts, low, high):
    """Set the boxes of the nodes `root` to below `end` about parts (T, m) of vertices from low to high (V, 3)."""
    for node in range(end - 1, root - 1, -1):
        box, after = tree.box[node], tree.skip[node]
        if after == node + 1:
            for axis in range(3):
                box[axis], box[3 + axis] = 1e300, -1e300
            for f in range(tree.first[node], tree.last[node]):
                for corner in range(parts.shape[1]):
                    for axis in range(3):
                        i = parts[f, corner]
                        box[axis], box[3 + axis] = min(box[axis], low[i, axis]), max(box[3 + axis], high[i, axis])
        else:
            one, other = tree.box[node + 1], tree.box[tree.skip[node + 1]]
            for axis in range(3):
                box[axis] = min(one[axis], other[axis])
                box[3 + axis] = max(one[3 + axis], other[3 + axis])


@kernel
def gap(box, p):
    """The square of the distance of a point (lanes) from a box, m²."""
    x, y, z = lane0(p), lane1(p), lane2(p)
    dx = max(max(box[0] - x, x - box[3]), 0.0)
    dy = max(max(box[1] - y, y - box[4]), 0.0)
    dz = max(max(box[2] - z, z - box[5]), 0.0)
    return dx * dx + dy * dy + dz * dz
