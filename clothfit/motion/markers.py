"""Markers and vertices: which vertex of a scene each marker of a capture shows.

The user's map, a CSV with the columns `marker`, `object`, `vertex`, says it. Without a map, a marker belongs to the
vertex of the scene at its start that is nearest to where the marker is first seen; where moving and turning all of them
as a whole plainly brings them nearer to vertices, to the one that is nearest then. That place is sought by iterated
closest points (P. J. Besl, N. D. McKay, 1992) from many. A vertex without a marker is not observed.
"""

from __future__ import annotations

import os
from collections.abc import Sequence
from itertools import product
from operator import itemgetter
from typing import NamedTuple

import numpy as np

from clothfit.base.arrays import Array, Flags, Indices
from clothfit.base.errors import InvalidMotion
from clothfit.base.messages import counted, metres, spelt
from clothfit.formats.files import name_of
from clothfit.formats.markers import table_of, text_of
from clothfit.motion.motion import rms
from clothfit.scene.scene import Scene, owner

MAP_COLUMNS = ("marker", "object", "vertex")

MOST_MAP_BYTES = 10_000_000
"""Bytes of a map of markers."""

TURNS, ITERATIONS, MOST = 3, 20, 100
"""Angles about the last axis that are tried, and closest points from each place, with so many markers."""

PLAIN, FEWEST, ALIKE, EXACT = 0.2, 5, 2.0, 1e-12
"""Distance from vertices, relative to that of markers as they came, up to which another place is theirs; markers that
show one; and squares relative to the least, or to those of edges, that are as good.
"""

WHOLE = 2.0 * np.pi
"""More than any turn: what a place costs where what is held moves more than the rest."""

CLEAR = 0.5
"""Distance to the nearest vertex, relative to the next one, up to which a marker is at that one beyond doubt."""


class Match(NamedTuple):
    """The vertex of a marker."""

    marker: str
    object: int
    vertex: int  # of the object
    distance: float  # m, from the marker where first seen, once placed, to the vertex at the start; NaN if never seen


class Place(NamedTuple):
    """Where markers plainly belong."""

    R: Array  # (3, 3)
    d: Array  # (3,), m: they are at R y + d
    others: int  # places that are as good, with other vertices


class Matches(NamedTuple):
    """The vertices of all markers that have one."""

    each: tuple[Match, ...]
    columns: Indices  # of the markers in the file
    vertices: Indices  # numbered through the scene
    omission: str | None  # a sentence on the markers left out
    mapped: bool  # whether the user's map assigns them
    place: Place | None = None  # where they are matched; None: as they came
    unclear: int = 0  # those that are at no vertex beyond doubt

    @property
    def distances(self) -> Array:
        """The distances of the markers that were seen, m."""
        return np.array([match.distance for match in self.each if np.isfinite(match.distance)])

    def __str__(self) -> str:
        gaps = self.distances
        how = "by the map" if self.mapped else "the nearest vertex to each"
        how += " once they are moved and turned as a whole" if self.place else ""
        summary = f"{counted(len(self.each), 'marker', 'markers')}, {how}"
        if not len(gaps):
            return summary
        summary += f", {metres(float(np.median(gaps)))} away (median), {metres(float(gaps.max()))} at most"
        if self.unclear:
            summary += f"; {self.unclear} of them lie between vertices, and may be others' (--set map)"
        if self.place and self.place.others:
            places = counted(self.place.others, "other place fits", "other places fit")
            summary += f"; {places} as well, and the nearest is taken (--set map says which vertex each is)"
        return summary


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
    first, start, place, unclear = points[seen.argmax(axis=0), np.arange(len(ever))], initial(scene), None, 0
    if path is None:
        columns, why = np.flatnonzero(ever).tolist(), "never seen"
        if not columns:
            raise InvalidMotion(f"{name}: no marker is seen in any frame")
        held = np.concatenate([cloth.fixed for cloth in scene.cloths])
        if (place := other_place(points[0, seen[0]], wandering(points, seen)[seen[0]], start, held)) is not None:
            first = first @ place.R.T + place.d
        vertices, unclear = nearest(first[columns], start)
        pairs = list(zip(columns, vertices, strict=True))
    else:
        pairs, why = pairs_from_map(path, names, scene), "not in the map"
    check_apart(pairs, names, scene, name if path is None else name_of(path))
    left = [names[i] for i in sorted(set(range(len(names))) - {i for i, _ in pairs})]
    omission = f"{why}, and left out: {listed(left)}" if left else None
    columns, vertices = (list(each) for each in zip(*pairs, strict=True))
    gaps = np.linalg.norm(first[columns] - start[vertices], axis=1)
    gaps[~ever[columns]] = np.nan
    found = zip(columns, vertices, gaps, strict=True)
    each = [Match(names[i], *owner(v, scene.vertex_counts), float(gap)) for i, v, gap in found]
    places = np.array(columns, np.int32), np.array(vertices, np.int32)
    return Matches(tuple(each), *places, omission, path is not None, place, unclear)


def wandering(points: Array, seen: Flags) -> Array:
    """How far points (frames, n, 3), where they are `seen` (frames, n), move about their means (n,), RMS, m."""
    known, count = seen[..., None], np.maximum(seen.sum(axis=0), 1)
    mean = points.sum(axis=0, where=known) / count[:, None]
    return np.asarray(np.sqrt(((points - mean) ** 2).sum(axis=(0, 2), where=known) / count))


def nearest(points: Array, start: Array) -> tuple[list[int], int]:
    """Of the vertices at `start` (N, 3) the one that is nearest to each of the points (n, 3), and how many of these are
    near another one as well.
    """
    from scipy.spatial import KDTree

    away, vertices = map(np.asarray, KDTree(start).query(points, k=[1, 2]))
    return [int(each) for each in vertices[:, 0]], int((away[:, 0] > CLEAR * away[:, 1]).sum())


def other_place(points: Array, wander: Array, start: Array, held: Flags) -> Place | None:
    """The place that plainly brings markers (n, 3), which move by `wander` (n,), m (RMS), nearer to vertices at `start`
    (N, 3) than they are, each to its own. Of those as good the least turn and way, where what is `held` (N,) does not
    move more than the rest. None: there is none.
    """
    from scipy.spatial import KDTree

    if min(len(points), len(start)) < FEWEST:
        return None
    some, tree = slice(None, None, -(-len(points) // MOST)), KDTree(start)
    points, wander = points[some], wander[some]
    before = float(np.mean(tree.query(points)[0] ** 2)) * (1.0 - 2.0 / len(points))  # a place takes six unknowns
    size = float(np.linalg.norm(np.ptp(start, axis=0)))
    edge, found = float(np.median(tree.query(start, k=[2])[0])), dict[bytes, tuple[float, float, Array, Array]]()
    begun = [(each.T, start.mean(axis=0) - each.T @ points.mean(axis=0)) for each in turns(start, points)]
    for (R, d), shift in product([*begun, (np.eye(3), np.zeros(3))], product((0.0, -edge, edge), repeat=3)):
        d, now = d + shift, np.zeros(0, np.intp)
        for _ in range(ITERATIONS):
            last, (away, now) = now, map(np.asarray, tree.query(points @ R.T + d))
            if np.array_equal(now, last):
                break
            R, d = rigid(points, start[now])
        if len(np.unique(now)) == len(points):
            own = held[now]
            odd = bool(own.any() and not own.all() and wander[own].mean() > wander[~own].mean())
            found[now.tobytes()] = float(np.mean(away**2)), WHOLE * odd + way_of(R, d, points, size), R, d
    best = min((each[0] for each in found.values()), default=np.inf)
    if not best < PLAIN**2 * before:
        return None
    most = ALIKE * best + EXACT * edge**2
    (_, R, d), *others = sorted((each[1:] for each in found.values() if each[0] <= most), key=itemgetter(0))
    return Place(R, d, sum(each[0] < WHOLE for each in others))


def rigid(points: Array, others: Array) -> tuple[Array, Array]:
    """The rotation (3, 3) and translation (3,), m, that bring points (n, 3) nearest to others (n, 3).

    W. Kabsch, A solution for the best rotation to relate two sets of vectors, Acta Cryst. A 32 (1976).
    """
    centre, other = points.mean(axis=0), others.mean(axis=0)
    u, _, v = np.linalg.svd((points - centre).T @ (others - other))
    turn = np.diag([1.0, 1.0, np.sign(np.linalg.det(u @ v)) or 1.0])
    R = (u @ turn @ v).T
    return R, other - R @ centre


def way_of(R: Array, d: Array, points: Array, size: float) -> float:
    """By how much x → R x + d turns, in radians, and moves points (n, 3), relative to a size, m."""
    return float(np.arccos(np.clip(0.5 * np.trace(R) - 0.5, -1.0, 1.0)) + rms(points @ R.T + d - points) / size)


def turns(start: Array, points: Array) -> list[Array]:
    """Rotations (3, 3) that may bring a mesh at `start` (n, 3) to points (m, 3): none, and those between principal
    axes, turned about the last one as well.
    """
    own, other = (np.linalg.eigh(np.cov(each.T))[1][:, ::-1] for each in (start, points))
    found = [np.eye(3)]
    for a, b in ((1.0, 1.0), (1.0, -1.0), (-1.0, 1.0), (-1.0, -1.0)):
        signs = np.diag([a, b, a * b * np.linalg.det(own) * np.linalg.det(other)])
        for angle in np.linspace(0.0, 0.5 * np.pi, TURNS, endpoint=False):
            c, s = np.cos(angle), np.sin(angle)
            found.append(other @ np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]]) @ signs @ own.T)
    return found


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
