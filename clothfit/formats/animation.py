"""Animations: positions over time as another tool's file holds them, before anyone knows the scene.

The points are numbered as in the file, in its axes and unit. `axes` converts them, `motion.foreign` makes a `Motion` of
them.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from clothfit.base.arrays import Array, Flags, Indices
from clothfit.formats.axes import Axes


@dataclass(frozen=True, eq=False)
class Animation:
    """Positions of the points of a file, frame by frame."""

    positions: Array  # (frames, points, 3), in the file's axes and unit; NaN where not seen
    axes: Axes  # as the file says, else by its format's convention
    times: Array | None = None  # (frames,), s, increasing; None: the file has none
    triangles: Indices | None = None  # (T, 3), points; None: it has no faces
    observed: Flags | None = None  # (frames, points); None: everything was seen
    names: tuple[str, ...] | None = None  # (points,), of markers
    notes: tuple[str, ...] = ()  # sentences on what was assumed
    spacing: float = 1.0  # frames of the file's own counting between two of these, where it has no times


def increasing(times: Array) -> bool:
    """Whether times (frames,) are finite and increase."""
    return bool(np.isfinite(times).all() and (np.diff(times) > 0).all())


def fans(lengths: NDArray[Any], corners: NDArray[Any]) -> Indices:
    """Triangles (T, 3) of polygons, as fans from the first corner of each.

    `lengths` (F,) counts the corners of each polygon; `corners` has them all, one polygon after another.
    """
    count = np.maximum(lengths - 2, 0)
    first = np.repeat(np.cumsum(lengths) - lengths, count)
    step = np.arange(count.sum()) - np.repeat(np.cumsum(count) - count, count)
    found: Indices = corners[np.stack([first, first + step + 1, first + step + 2], axis=1)].astype(np.int32, copy=False)
    return found
