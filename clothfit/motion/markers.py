"""Markers and vertices: which vertex of a scene each marker of a capture shows.

A file says so, a CSV with the columns `marker`, `object`, `vertex`; else a marker belongs to the vertex that is nearest
to it where it is first seen, of the scene at its start. A vertex without a marker is not observed.
"""

from __future__ import annotations

import csv
import io
import os
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from clothfit.base.arrays import Array, Flags, Indices
from clothfit.base.errors import InvalidMotion
from clothfit.base.messages import counted, metres, shown
from clothfit.formats.files import content, name_of
from clothfit.scene.scene import Scene

MAP_COLUMNS = ("marker", "object", "vertex")

MOST_MAP_BYTES = 10_000_000
"""Bytes of a file that says which marker is which vertex."""


class Match(NamedTuple):
    """The vertex of a marker."""

    marker: str
    object: int
    vertex: int  # of the object
    distance: float  # m, of the marker, where it is first seen, from the vertex at the start; NaN where it never is


class Matches(NamedTuple):
    """The vertices of all markers that have one."""

    each: tuple[Match, ...]
    columns: Indices  # of the markers, in the file
    vertices: Indices  # of all the scene's
    note: str | None  # a sentence on those that are left out

    @property
    def distances(self) -> Array:
        """Those of the markers that were seen, m."""
        return np.array([match.distance for match in self.each if np.isfinite(match.distance)])

    def sentence(self, given: bool) -> str:
        """What to say of them; `given`: whether a file says which they are."""
        gaps = self.distances
        how = "by the map" if given else "the nearest vertex to each"
        pairs_from_map = f"{counted(len(self.each), 'marker', 'markers')}, {how}"
        if not len(gaps):
            return pairs_from_map
        return f"{pairs_from_map}, {metres(float(np.median(gaps)))} away (median), {metres(float(gaps.max()))} at most"


def initial(scene: Scene) -> Array:
    """The positions (vertices, 3) of all vertices of a scene at its start, m."""
    return np.concatenate([cloth.positions for cloth in scene.cloths])


def matched(
    points: Array, seen: Flags, names: Sequence[str], scene: Scene, path: str | os.PathLike[str] | None, name: str
) -> Matches:
    """The vertices of markers at `points` (frames, markers, 3), m, `seen` (frames, markers).

    `path`: of the file that says which they are, or None; `name`: of the file with the markers. Raises InvalidMotion.
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
    note = f"{why}, and left out: {listed(left)}" if left else None
    columns, vertices = (list(each) for each in zip(*pairs, strict=True))
    gaps = np.linalg.norm(first[columns] - initial(scene)[vertices], axis=1)
    gaps[~ever[columns]] = np.nan
    each = [Match(names[i], *owner(v, scene), float(gap)) for i, v, gap in zip(columns, vertices, gaps, strict=True)]
    return Matches(tuple(each), np.array(columns, np.int32), np.array(vertices, np.int32), note)


def nearest(points: Array, scene: Scene) -> list[int]:
    """The vertex, of all the scene's, that is nearest to each of the points (n, 3) at the start."""
    from scipy.spatial import KDTree

    return [int(vertex) for vertex in np.ravel(KDTree(initial(scene)).query(points)[1])]


def owner(vertex: int, scene: Scene) -> tuple[int, int]:
    """The object of a vertex of all the scene's, and its number there."""
    ends = np.cumsum(scene.vertex_counts)
    cloth = int(np.searchsorted(ends, vertex, side="right"))
    return cloth, vertex - int(ends[cloth] - scene.vertex_counts[cloth])


def check_apart(pairs: Sequence[tuple[int, int]], names: Sequence[str], scene: Scene, name: str) -> None:
    """Raise InvalidMotion where two markers have one vertex."""
    markers: dict[int, int] = {}
    for marker, vertex in pairs:
        if vertex in markers:
            cloth, own = owner(vertex, scene)
            both = f"markers {shown(names[markers[vertex]])} and {shown(names[marker])}"
            raise InvalidMotion(
                f"{name}: {both} both belong to objects[{cloth}] vertex {own}; say with --map which vertex each is, or "
                "leave one out there"
            )
        markers[vertex] = marker


def pairs_from_map(path: str | os.PathLike[str], names: Sequence[str], scene: Scene) -> list[tuple[int, int]]:
    """The pairs of marker and vertex, of all the scene's, that a file tells. Raises InvalidMotion."""
    name = name_of(path)
    try:
        text = content(path, MOST_MAP_BYTES).decode("utf-8-sig")
        stream = io.StringIO(text, newline=None)  # line ends of any kind
        separator = next((each for each in "\t;" if each in stream.readline()[:1000]), ",")
        stream.seek(0)
        rows = list(csv.reader(stream, delimiter=separator))
    except (UnicodeDecodeError, csv.Error) as error:
        raise InvalidMotion(f"{name}: is not a text with commas: {error}") from None
    header = [word.strip().lower() for word in rows[0]] if rows else []
    if not set(MAP_COLUMNS) <= set(header):
        raise InvalidMotion(f"{name}: line 1: the names of the columns are needed: {', '.join(MAP_COLUMNS)}")
    places = [header.index(column) for column in MAP_COLUMNS]
    index = {marker: i for i, marker in enumerate(names)}
    starts = np.cumsum([0, *scene.vertex_counts])
    pairs: dict[int, int] = {}
    for line, row in enumerate(rows[1:], 2):
        if not any(word.strip() for word in row):
            continue
        marker, *numbers = (row[i].strip() if i < len(row) else "" for i in places)
        if marker not in index:
            raise InvalidMotion(f"{name}: line {line}: there is no marker {shown(marker)}; there are {listed(names)}")
        if index[marker] in pairs:
            raise InvalidMotion(f"{name}: line {line}: the marker {shown(marker)} stands there twice")
        cloth, vertex = (int(word) if word.isdecimal() and len(word) < 19 else -1 for word in numbers)
        if not 0 <= cloth < len(scene.cloths) or not 0 <= vertex < scene.vertex_counts[cloth]:
            what = f"objects[{numbers[0][:20]}] vertex {numbers[1][:20]}"
            raise InvalidMotion(f"{name}: line {line}: there is no {what} in {scene.name}")
        pairs[index[marker]] = int(starts[cloth]) + vertex
    if not pairs:
        raise InvalidMotion(f"{name}: tells of no marker")
    return sorted(pairs.items())


def listed(names: Sequence[str], most: int = 5) -> str:
    """Some names, and how many more there are."""
    more = f" and {len(names) - most} more" if len(names) > most else ""
    return ", ".join(shown(each) for each in names[:most]) + more
