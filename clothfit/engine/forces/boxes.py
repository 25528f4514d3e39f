"""A tree of boxes about triangles, in which what is near a point is found without looking at the rest.

The tree is built once, where the triangles are at the start: each of its nodes halves them along the widest side of
their middles. Where they move, only the boxes change (`refit`). Nodes stand in preorder: after a node comes the first
of its two, and `skip` says which node comes after all that is below it. So a search needs no stack,

    node = root;  while node < end:  node = skip[node] where the box of node is too far, else node + 1.
"""

from __future__ import annotations

from typing import NamedTuple, TypeAlias

import numpy as np
import numpy.typing as npt

from clothfit.base.arrays import Array, Indices
from clothfit.kernels.kernel import kernel
from clothfit.kernels.lanes.operations import lane0, lane1, lane2

Numbers: TypeAlias = npt.NDArray[np.int64]

LEAF = 4
"""Triangles of a leaf, at most."""


class Tree(NamedTuple):
    """Boxes about T triangles, which stand leaf by leaf. N nodes."""

    box: Array  # (N, 6), m: the lowest x, y, z and the highest
    skip: Indices  # (N,), the node after all that is below
    first: Indices  # (N,), of the triangles of a leaf; as `last` where it is none
    last: Indices  # (N,), below which they are


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


@kernel
def refit(tree, root, end, triangles, place):
    """Set the boxes of the nodes `root` to below `end` about triangles (T, 3) of vertices at place (V, 3)."""
    for node in range(end - 1, root - 1, -1):
        box, after = tree.box[node], tree.skip[node]
        if after == node + 1:
            for axis in range(3):
                box[axis], box[3 + axis] = place[triangles[tree.first[node], 0], axis], -1e300
            for f in range(tree.first[node], tree.last[node]):
                for corner in range(3):
                    for axis in range(3):
                        x = place[triangles[f, corner], axis]
                        box[axis], box[3 + axis] = min(box[axis], x), max(box[3 + axis], x)
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


@kernel
def apart(box, low, high):
    """Whether a box has no point in common with the one from low to high (lanes)."""
    x = box[0] > lane0(high) or box[3] < lane0(low)
    return x or box[1] > lane1(high) or box[4] < lane1(low) or box[2] > lane2(high) or box[5] < lane2(low)
