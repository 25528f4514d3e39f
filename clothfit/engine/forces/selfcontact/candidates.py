"""Which boxes of one set overlap boxes of another: a uniform grid, in time proportional to what is found.

Each box of the second set is put into every cell that it reaches; a box of the first set looks into its cells. Two
boxes that meet in several cells count in one of them: that of the lower corner of what they share. Cells are as wide as
the boxes are on average, and there are at most some for each box.
"""

from __future__ import annotations

import numpy as np

from clothfit.base.arrays import Array, Indices
from clothfit.kernels.kernel import kernel

CELLS = 4
"""Most cells for each box."""

ROOM = 32
"""Pairs for each box of the first set that there is room for at first."""


def overlapping(boxes: Array, others: Array | None = None) -> Indices:
    """The pairs (M, 2) of boxes (A, 6) and (B, 6), lower corners first, that overlap; without others those of the
    boxes among themselves, the lower number first.
    """
    alike = others is None
    others = boxes if others is None else others
    if not len(boxes) or not len(others):
        return np.zeros((0, 2), np.int32)
    corner = others[:, :3].min(axis=0)
    extent = np.maximum(others[:, 3:].max(axis=0) - corner, 1e-300)
    width = max(float((each[:, 3:] - each[:, :3]).mean()) for each in (boxes, others)) or 1e-300
    while np.prod(np.ceil(extent / width)) > CELLS * len(others) + 64:
        width *= 1.25
    shape = np.maximum(np.ceil(extent / width), 1).astype(np.int64)
    cells, own = np.empty((len(boxes), 6), np.int32), np.empty((len(others), 6), np.int32)
    find_cells(boxes, corner, width, shape, cells)
    find_cells(others, corner, width, shape, own)
    start, member = filed(own, shape)
    room = np.empty((ROOM * len(boxes), 2), np.int32)
    while (count := search(boxes, cells, others, own, shape, start, member, alike, room)) > len(room):
        room = np.empty((count, 2), np.int32)
    return room[:count]


@kernel
def find_cells(boxes, corner, width, shape, cells):
    """Write the first and the last cell (A, 6) of boxes along each axis; what is outside counts to the last ones."""
    for b in range(len(boxes)):
        for c in range(6):
            axis = c % 3
            place = int((boxes[b, c] - corner[axis]) / width)
            cells[b, c] = min(max(place, 0), shape[axis] - 1)


@kernel
def filed(own, shape):
    """The boxes in each cell: those of cell c are member[start[c]] … member[start[c + 1] − 1]."""
    start = np.zeros(shape[0] * shape[1] * shape[2] + 1, np.int64)
    for b in range(len(own)):
        for x in range(own[b, 0], own[b, 3] + 1):
            for y in range(own[b, 1], own[b, 4] + 1):
                for z in range(own[b, 2], own[b, 5] + 1):
                    start[(x * shape[1] + y) * shape[2] + z] += 1
    for c in range(len(start) - 1):
        start[c + 1] += start[c]
    member = np.empty(start[-1], np.int32)
    for b in range(len(own) - 1, -1, -1):
        for x in range(own[b, 0], own[b, 3] + 1):
            for y in range(own[b, 1], own[b, 4] + 1):
                for z in range(own[b, 2], own[b, 5] + 1):
                    c = (x * shape[1] + y) * shape[2] + z
                    start[c] -= 1
                    member[start[c]] = b
    return start, member


@kernel
def meet(boxes, a, others, b):
    """Whether two boxes overlap."""
    along0 = boxes[a, 0] <= others[b, 3] and others[b, 0] <= boxes[a, 3]
    along1 = boxes[a, 1] <= others[b, 4] and others[b, 1] <= boxes[a, 4]
    return along0 and along1 and boxes[a, 2] <= others[b, 5] and others[b, 2] <= boxes[a, 5]


@kernel
def search(boxes, cells, others, own, shape, start, member, alike, room):
    """Write the pairs of boxes that overlap, as many as there is room for; returns how many there are."""
    count = 0
    for a in range(len(boxes)):
        for x in range(cells[a, 0], cells[a, 3] + 1):
            for y in range(cells[a, 1], cells[a, 4] + 1):
                for z in range(cells[a, 2], cells[a, 5] + 1):
                    c = (x * shape[1] + y) * shape[2] + z
                    for e in range(start[c], start[c + 1]):
                        b = member[e]
                        if (alike and b <= a) or not meet(boxes, a, others, b):
                            continue
                        first = x == max(cells[a, 0], own[b, 0]) and y == max(cells[a, 1], own[b, 1])
                        if first and z == max(cells[a, 2], own[b, 2]):
                            if count < len(room):
                                room[count, 0], room[count, 1] = a, b
                            count += 1
    return count
