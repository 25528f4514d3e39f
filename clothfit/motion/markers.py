"""Markers and vertices: which vertex of a scene each marker of a capture shows.

The user's map, a CSV with the columns `marker`, `object`, `vertex`, says it. Without a map, a marker belongs to the
vertex of the scene at its start that is nearest to where the marker is first seen. A vertex without a marker is not
observed.
"""

from __future__ import annotations

import os
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from clothfit.base.arrays import Array, Flags, Indices
from clothfit.base.errors import InvalidMotion
from clothfit.base.messages import counted, metres, spelt
from clothfit.formats.files import name_of
from clothfit.formats.markers import table_of, text_of
from clothfit.scene.scene import Scene, owner

MAP_COLUMNS = ("marker", "object", "vertex")

MOST_MAP_BYTES = 10_000_000
"""Bytes of a map of markers."""


class Match(NamedTuple):
    """The vertex of a marker."""

    marker: str
    object: int
    vertex: int  # of the object
    distance: float  # m, from the marker where first seen to the vertex at the start; NaN if never seen


class Matches(NamedTuple):
    """The vertices of all markers that have one."""

    each: tuple[Match, ...]
    columns: Indices  # of the markers in the file
    vertices: Indices  # numbered through the scene
    omission: str | None  # a sentence on the markers left out
    mapped: bool  # whether the user's map assigns them

    @property
    def distances(self) -> Array:
        """The distances of the markers that were seen, m."""
        return np.array([match.distance for match in self.each if np.isfinite(match.distance)])

    def __str__(self) -> str:
        gaps = self.distances
        how = "by the map" if self.mapped else "the nearest vertex to each"
        summary = f"{counted(len(self.each), 'marker', 'markers')}, {how}"
        if not len(gaps):
            return summary
        return f"{summary}, {metres(float(np.median(gaps)))} away (median), {metres(float(gaps.max()))} at most"


def initial(scene: Scene) -> Array:
    """The positions (vertices, 3) of all vertices of a scene at its start, m."""
    return np.concatenate([cloth.positions for cloth in scene.cloths])


def matched(
    points: Array, seen: Flags, names: Sequence[str], scene: Scene, path: str | os.PathLike[str] | None, name: str
) -> Matches:
    """The vertices of markers at `points` (frames, markers, 3), m, `seen` (frames, markers).

    `path`: the map, or None; `name`: of the file with the markers. Raises InvalidMotion.
    """
    ever: Flags = np.asarray(seen.any(axis=0))
    first = points[seen.argmax(axis=0), np.arange(len(ever))]
    if path is None:
        columns, why = np.flatnonzero(ever).tolist(), "never seen"
        if not columns:
            raise InvalidMotion(f"{name}: no marker is seen in any frame")
        pairs = list(zip(columns, nearest(first[columns], scene), strict=True))
    else:
        pairs, why = pairs_from_map(path, names, scene), "not in the map"
    check_apart(pairs, names, scene, name if path is None else name_of(path))
    left = [names[i] for i in sorted(set(range(len(names))) - {i for i, _ in pairs})]
    omission = f"{why}, and left out: {listed(left)}" if left else None
    columns, vertices = (list(each) for each in zip(*pairs, strict=True))
    gaps = np.linalg.norm(first[columns] - initial(scene)[vertices], axis=1)
    gaps[~ever[columns]] = np.nan
    found = zip(columns, vertices, gaps, strict=True)
    each = [Match(names[i], *owner(v, scene.vertex_counts), float(gap)) for i, v, gap in found]
    places = np.array(columns, np.int32), np.array(vertices, np.int32)
    return Matches(tuple(each), *places, omission, path is not None)


def nearest(points: Array, scene: Scene) -> list[int]:
    """The vertex, numbered through the scene, that is nearest to each of the points (n, 3) at the start."""
    from scipy.spatial import KDTree

    return [int(vertex) for vertex in np.ravel(KDTree(initial(scene)).query(points)[1])]


def check_apart(pairs: Sequence[tuple[int, int]], names: Sequence[str], scene: Scene, name: str) -> None:
    """Raise InvalidMotion where two markers have the same vertex."""
    markers: dict[int, int] = {}
    for marker, vertex in pairs:
        if vertex in markers:
            cloth, own = owner(vertex, scene.vertex_counts)
            both = f"markers {spelt(names[markers[vertex]])} and {spelt(names[marker])}"
            raise InvalidMotion(
                f"{name}: {both} both belong to objects[{cloth}] vertex {own}; say with --map which vertex each is, or "
                "leave one out there"
            )
        markers[vertex] = marker


def pairs_from_map(path: str | os.PathLike[str], names: Sequence[str], scene: Scene) -> list[tuple[int, int]]:
    """The pairs of marker and vertex, numbered through the scene, in a map. Raises InvalidMotion."""
    name = name_of(path)
    table = table_of(text_of(path, MOST_MAP_BYTES), name)
    places = [table.column((column,)) for column in MAP_COLUMNS]
    if None in places:
        raise InvalidMotion(f"{name}: line 1: the names of the columns are needed: {', '.join(MAP_COLUMNS)}")
    index = {marker: i for i, marker in enumerate(names)}
    starts = np.cumsum([0, *scene.vertex_counts])
    pairs: dict[int, int] = {}
    for line, cells in table.rows:
        marker, *numbers = (cells[i].strip() for i in places if i is not None)
        if marker not in index:
            raise InvalidMotion(f"{name}: line {line}: there is no marker {spelt(marker)}; there are {listed(names)}")
        if index[marker] in pairs:
            raise InvalidMotion(f"{name}: line {line}: the marker {spelt(marker)} is listed twice")
        cloth, vertex = (int(cell) if cell.isdecimal() and len(cell) < 19 else -1 for cell in numbers)
        if not 0 <= cloth < len(scene.cloths) or not 0 <= vertex < scene.vertex_counts[cloth]:
            what = f"objects[{numbers[0][:20]}] vertex {numbers[1][:20]}"
            raise InvalidMotion(f"{name}: line {line}: there is no {what} in {scene.name}")
        pairs[index[marker]] = int(starts[cloth]) + vertex
    if not pairs:
        raise InvalidMotion(f"{name}: names no marker")
    return sorted(pairs.items())


def listed(names: Sequence[str], most: int = 5) -> str:
    """Some names, and how many more there are."""
    more = f" and {len(names) - most} more" if len(names) > most else ""
    return ", ".join(spelt(each) for each in names[:most]) + more
