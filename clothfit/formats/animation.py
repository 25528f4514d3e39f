"""Animations: positions over time as another tool's file holds them, before they are those of a scene's vertices.

The points are numbered as in the file. A format's module reads its file's own numbers, axes and unit; `axes` then
converts them, and whoever knows the scene makes a `Motion` of them.
"""

from __future__ import annotations

from dataclasses import dataclass

from clothfit.base.arrays import Array, Flags, Indices
from clothfit.formats.axes import Axes


@dataclass(frozen=True, eq=False)
class Animation:
    """Positions of the points of a file at some times."""

    positions: Array  # (frames, points, 3), in the file's axes and unit; NaN where not seen
    axes: Axes  # those of the file: what it says itself, else its format's convention
    times: Array | None = None  # (frames,), s, increasing; None: the file does not tell
    triangles: Indices | None = None  # (T, 3), points; None: it has no faces
    observed: Flags | None = None  # (frames, points); None: everything was seen
    names: tuple[str, ...] | None = None  # (points,), of markers
    notes: tuple[str, ...] = ()  # sentences: what was assumed that the file does not say
    spacing: float = 1.0  # frames of the file's own counting between two of these, where it has no times
