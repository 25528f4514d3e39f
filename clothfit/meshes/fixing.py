"""Which vertices of a new cloth are meant, those that do not move or a region: in a box, at a side, or by numbers.

Sides are those of the scene's axes: right, top and front are where x, y and z (forward) are largest.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from clothfit.base.arrays import Array, Flags
from clothfit.base.errors import InvalidInput

SIDES = {"left": (0, -1), "right": (0, 1), "bottom": (1, -1), "top": (1, 1), "back": (2, -1), "front": (2, 1)}
"""Axis and direction of each side."""

SIDE_DEPTH = 1e-3
"""The depth of a side, as a share of the mesh's extent."""


def in_box(positions: Array, corner: Sequence[float], opposite: Sequence[float]) -> Flags:
    """Which of the positions (n, 3) lie in the box between two corners, m, or on its surface."""
    low, high = np.minimum(corner, opposite), np.maximum(corner, opposite)
    inside: Flags = np.all((positions >= low) & (positions <= high), axis=1)
    return inside


def at_side(positions: Array, side: str, reach: float | None = None, option: str = "fix side") -> Flags:
    """Which of the positions (n, 3) lie at a side of all of them, one of SIDES, within `reach`, m (default: a
    thousandth of their extent). Raises InvalidInput when there is no such side; `option` is its name in messages.
    """
    if side not in SIDES:
        raise InvalidInput(f"{option}: there is no {side!r}; use {', '.join(SIDES)}")
    axis, sign = SIDES[side]
    depth = sign * positions[:, axis]
    extent = float(np.ptp(depth))
    if not extent:
        raise InvalidInput(f"{option}: the mesh is flat along {'xyz'[axis]}, so its {side} is all of it; name another")
    if reach is not None and not 0 <= reach < np.inf:
        raise InvalidInput(f"{option}: the reach must be at least 0 and finite; {reach:g} m was given")
    near: Flags = depth >= depth.max() - (SIDE_DEPTH * extent if reach is None else reach)
    return near


def listed(count: int, ranges: Sequence[tuple[int, int]], option: str = "fix vertices") -> Flags:
    """Which of `count` vertices are in the ranges, both ends included. Raises InvalidInput when one does not exist."""
    chosen = np.zeros(count, bool)
    for first, last in ranges:
        if not 0 <= first <= last < count:
            wrong = last if last >= count else first
            raise InvalidInput(f"{option}: vertex {wrong} does not exist (the mesh has vertices 0 to {count - 1})")
        chosen[first : last + 1] = True
    return chosen
