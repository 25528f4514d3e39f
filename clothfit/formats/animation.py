"""Animations: positions over time as another tool's file holds them, before anyone knows the scene.

The points are numbered as in the file, in its axes and unit. `axes` converts them, `motion.foreign` makes a `Motion` of
them.

Tools name parts of meshes in many ways: objects, groups, materials. Here a part is a name and the vertices of its
triangles. Parts without vertices, or with all, are left out, and names are made to differ. None of this is worth a
refusal: what cannot be understood is left out.
"""

from __future__ import annotations

import os
import re
from collections.abc import Callable, Hashable, Iterable, Sequence
from dataclasses import dataclass
from typing import Any, TypeAlias, TypeVar

import numpy as np
from numpy.typing import NDArray

from clothfit.base.arrays import Array, Flags, Indices
from clothfit.base.errors import InvalidMotion
from clothfit.base.messages import counted, named
from clothfit.formats.axes import Axes
from clothfit.formats.files import name_of

Shape = TypeVar("Shape")  # a mesh, as the library or the reader of a format has it

Parts: TypeAlias = tuple[tuple[str, Indices], ...]
"""Names and vertices, rising."""

NO_NAMES = frozenset({"", "(null)", "none", "default", "off"})
"""What tools write, in either case, where there is no name."""

LONGEST_NAME, MOST_PARTS = 60, 64
"""Characters of a name, and parts of a mesh: with more than that names are numbers, such as those of fragments."""

ASSUMED_RATE = 30.0
"""Frames per second where neither the file nor the user gives a rate."""

BELOW = 3
"""The rank of a name that may be that of several meshes."""

SINGLE = 2.0**-23
"""Rounding of numbers in single precision, and of what is computed with them."""

MOST_NAMED = 12
"""Names in a message."""

HALF = 0.5
"""The weight from which a vertex is held."""

EVEN = 1e-3
"""How far a frame may be from its place in an even rate, as a share of the time between two frames."""


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
    texture: Array | None = None  # (T, 3, 2), texture coordinates u, v of the corners of the triangles; NaN unknown
    parts: Parts = ()  # of a mesh, as the file names them
    pins: Indices | None = None  # vertices that the file marks as held, rising; None: it marks none
    spacing: float = 1.0  # frames of the file's own counting between two of these, where it has no times
    normals: Array | None = None  # (frames, points, 3) of a scan, whose points are others in each frame; 0 unknown


class OtherPoints(InvalidMotion):
    """The frames of a sequence have other points."""


def of_scan(frames: Sequence[tuple[Array, Indices | None]], axes: Axes) -> Animation:
    """A scan of frames of points (n, 3), another n for each, with their triangles (T, 3); none was not seen."""
    most = max(len(points) for points, _ in frames)
    positions, normals = np.full((len(frames), most, 3), np.nan), np.zeros((len(frames), most, 3))
    for frame, (points, triangles) in enumerate(frames):
        positions[frame, : len(points)] = points
        if triangles is not None and len(triangles):
            normals[frame, : len(points)] = normals_at(points, triangles)
    return Animation(positions, axes, normals=normals, observed=np.isfinite(positions).all(axis=2))


def normals_at(points: Array, triangles: Indices) -> Array:
    """Unit normals (n, 3) at points (n, 3) of triangles (T, 3), each counted by its area; 0 at points without any."""
    a, b, c = points[triangles].transpose(1, 0, 2)
    found = np.zeros_like(points)
    np.add.at(found, triangles.T, np.cross(b - a, c - a)[None])
    return np.asarray(found / np.maximum(np.linalg.norm(found, axis=1, keepdims=True), 1e-300))


def increasing(times: Array) -> bool:
    """Whether times (frames,) are finite and increase."""
    return bool(np.isfinite(times).all() and (np.diff(times) > 0).all())


def check_times(times: Array, place: str) -> None:
    """Raise InvalidMotion, naming the place, unless times (frames,) are finite and increase."""
    if not increasing(times):
        raise InvalidMotion(f"{place}: times: must be finite and increasing")


def check_finite(name: str, positions: Array, times: Array | None = None) -> None:
    """Raise InvalidMotion where positions of a file are infinite, not NaN, which were not seen, or times not finite."""
    if np.isinf(positions).any() or not (times is None or np.isfinite(times).all()):
        raise InvalidMotion(f"{name}: some of its positions or times are infinite")


def check_polygons(lengths: NDArray[Any], corners: NDArray[Any], count: int, place: str) -> None:
    """Raise InvalidMotion, naming the place, unless polygons, as in `fans`, are those of a mesh of `count` vertices."""
    if (lengths < 0).any() or lengths.sum() != len(corners):
        raise InvalidMotion(f"{place}: its faces need {lengths.sum()} corners and have {len(corners)}")
    if len(corners) and not 0 <= corners.min() <= corners.max() < count:
        raise InvalidMotion(f"{place}: a triangle names a vertex beyond the {count} of its mesh")


def chosen(shapes: Sequence[Shape], paths: Sequence[str], wanted: str, place: str) -> list[Shape]:
    """The meshes of a file that are `wanted`: names with commas between. A name is a path, or the end of one; or that
    of a node that a mesh, or several, are below; or how a name begins, in either case. Raises InvalidMotion where there
    is none of it, or more than one.
    """
    found: list[Shape] = []
    for name in filter(None, (each.strip() for each in wanted.split(","))):
        own = list(zip(shapes, map(_names, paths), strict=True))
        steps = _names(name)
        ranked = (
            [shape for shape, path in own if path == steps],
            [shape for shape, path in own if path[-len(steps) :] == steps],
            [shape for shape, path in own if path[-len(steps) - 1 : -1] == steps],
            [shape for shape, path in own if [name] == steps and name in path[:-1]],
            [shape for shape, path in own if any(each.lower().startswith(name.lower()) for each in path[-2:])],
        )
        rank = next((k for k, each in enumerate(ranked) if each), None)
        if rank is None:
            raise InvalidMotion(f"{place}: there is no mesh {named(name)} in it; it has {listed(short(paths))}")
        if rank != BELOW and len(ranked[rank]) > 1:
            there = [paths[shapes.index(each)] for each in ranked[rank]]
            raise InvalidMotion(f"{place}: several of its meshes have the name {named(name)}; name {listed(there)}")
        found += [each for each in ranked[rank] if each not in found]
    return found


def _names(path: str) -> list[str]:
    return [each for each in path.split("/") if each]


def listed(names: Sequence[str]) -> str:
    """The first few names."""
    return ", ".join(map(named, names[:MOST_NAMED])) + (", …" if len(names) > MOST_NAMED else "")


def short(paths: Sequence[str]) -> list[str]:
    """For each path of a mesh the shortest name that is only its own: that of its object, of the mesh, or the path."""
    split = [_names(path) for path in paths]
    ends = [[path[-2] if len(path) > 1 else path[-1] for path in split], [path[-1] for path in split]]
    found = []
    for i, path in enumerate(paths):
        own = [name for name in (ends[0][i], ends[1][i]) if sum(name in other for other in split) == 1]
        found.append(own[0] if own and "," not in own[0] else path)
    return found


class Pins:
    """The vertices that attributes of meshes, one after another, mark as held."""

    def __init__(self) -> None:
        self._held: list[NDArray[Any]] = []
        self._start = 0
        self.names: list[str] = []

    def add(self, count: int, attributes: Iterable[tuple[str, NDArray[Any]]]) -> None:
        """Add a mesh of so many vertices, with the names and the weights of its attributes, of which those count that
        have one for each vertex.
        """
        for name, weights in attributes:
            values = np.asarray(weights, np.float64).reshape(-1)
            if len(values) == count and (values >= HALF).any():
                self._held.append(self._start + np.flatnonzero(values >= HALF))
                self.names.append(name)
        self._start += count

    def found(self, notes: list[str]) -> Indices | None:
        """All of them, rising, with a note on what marks them; None where nothing does."""
        if not self._held:
            return None
        found = np.unique(np.concatenate(self._held)).astype(np.int32)
        held = counted(len(found), "vertex", "vertices")
        notes.append(f"its attribute {listed(sorted(set(self.names)))} holds {held}")
        return found


def is_pin(name: str) -> bool:
    """Whether an attribute of this name marks held vertices, and is not a bone's: spine, pinky."""
    return re.search("(?<![sS])(?:pin|PIN)(?![kK])|Pin(?!k)", name) is not None


def moving(shapes: Sequence[Shape], moves: Callable[[Shape], bool], notes: list[str]) -> tuple[Sequence[Shape], bool]:
    """The meshes of a file that change their shape, with a note where others are left out, or all where none does; and
    whether one does.
    """
    found = [each for each in shapes if moves(each)]
    if found and len(found) < len(shapes):
        left = len(shapes) - len(found)
        notes.append(counted(left, "mesh keeps its shape and is left out", "meshes keep their shape and are left out"))
    return found or shapes, bool(found)


def common_times(name: str, times: Sequence[tuple[str, Any]]) -> Any:
    """The times of the samples of all meshes of a file, given with their names. Raises InvalidMotion where they differ.
    """
    first, common = times[0]
    for other, own in times:
        if not np.array_equal(own, common):
            both = f"{named(first)} and {named(other)}"
            raise InvalidMotion(f"{name}: {both} have samples at different times; export one of them alone")
    return common


def fans(lengths: NDArray[Any], corners: NDArray[Any]) -> Indices:
    """Triangles (T, 3) of polygons, as fans from the first corner of each.

    `lengths` (F,) counts the corners of each polygon; `corners` has them all, one polygon after another.
    """
    count = np.maximum(lengths - 2, 0)
    first = np.repeat(np.cumsum(lengths) - lengths, count)
    step = np.arange(count.sum()) - np.repeat(np.cumsum(count) - count, count)
    found: Indices = corners[np.stack([first, first + step + 1, first + step + 2], axis=1)].astype(np.int32, copy=False)
    return found


def with_gaps(animation: Animation) -> Array:
    """The positions, NaN where they were not observed."""
    if animation.observed is None:
        return animation.positions
    return np.where(animation.observed[..., None], animation.positions, np.nan)


def times_of(animation: Animation) -> Array:
    """Times of the frames, s; at RATE where they are not known."""
    return np.arange(len(animation.positions)) / ASSUMED_RATE if animation.times is None else animation.times


def rate_of(animation: Animation) -> float | None:
    """Frames per second; None where the rate is not even."""
    times = times_of(animation)
    if len(times) < 2:
        return ASSUMED_RATE
    step = float(times[-1] - times[0]) / (len(times) - 1)
    away = np.abs(times - times[0] - step * np.arange(len(times)))
    return rounded(1 / step) if away.max() <= EVEN * step else None


def unrounded(times: Array) -> Array:
    """Times (frames,), s, of single precision, without its rounding where they are at an even rate of few digits."""
    near = SINGLE * float(np.abs(times).max(initial=0.0))
    if len(times) < 2 or not np.diff(times).min() > 0.0:
        return times
    for digits in (0, 3):
        rate = round((len(times) - 1) / float(times[-1] - times[0]), digits)
        plain = (round(float(times[0]) * rate) + np.arange(len(times))) / rate if rate > 0.0 else times
        if np.abs(plain - times).max() <= near:
            return plain
    return times


def rated(path: str | os.PathLike[str], animation: Animation) -> float:
    """Frames per second, for formats with one rate for all frames. Raises InvalidMotion where the rate is not even."""
    rate = rate_of(animation)
    if rate is None:
        raise InvalidMotion(
            f"{name_of(path)}: frames that are not at equal distances in time cannot be written; use .trc or .csv"
        )
    return rate


def rounded(rate: float) -> float:
    """A rate without the rounding errors of its times: 50, not 49.99999999999999."""
    plain = float(f"{rate:.9g}")
    return plain if abs(plain - rate) <= 1e-12 * rate else rate


def parts_of(found: Iterable[tuple[str, NDArray[np.intp]]], triangles: Indices) -> Parts:
    """The parts of a mesh, from names and the indices of their triangles (T, 3)."""
    used = np.unique(triangles)
    made: dict[str, Indices] = {}
    for name, own in found:
        vertices = np.unique(triangles[own]).astype(np.int32)
        known = name.strip().lower() not in NO_NAMES
        if known and 0 < len(vertices) < len(used):
            made[unused(name, made)] = vertices
    return tuple(made.items()) if len(made) <= MOST_PARTS else ()


def unused(name: str, taken: Iterable[str]) -> str:
    """A name, short and printable, with a number where it is taken."""
    short = "".join(c if c.isprintable() else "?" for c in name.strip())[:LONGEST_NAME]
    known, made, number = set(taken), short, 1
    while made in known:
        number += 1
        made = f"{short} {number}"
    return made


def known(texture: Array) -> Array | None:
    """Texture coordinates (T, 3, 2), None where there are none at all."""
    return texture if np.isfinite(texture).any() else None


class Faces:
    """The triangles of all meshes of a file, one after another, with their texture and the names of parts."""

    def __init__(self) -> None:
        self._triangles: list[Indices] = [np.zeros((0, 3), np.int32)]
        self._texture: list[Array] = [np.zeros((0, 3, 2))]
        self._parts: dict[tuple[int, Hashable], tuple[str, list[NDArray[np.intp]]]] = {}
        self.count = 0

    def add(self, triangles: Indices, texture: Array, turned: bool) -> None:
        """Add triangles (T, 3) and texture coordinates (T, 3, 2) of their corners, in the other order if `turned`."""
        self._triangles.append(triangles[:, ::-1] if turned else triangles)
        self._texture.append(texture[:, ::-1] if turned else texture)
        self.count += len(triangles)

    def name(self, name: str, own: NDArray[np.intp], rank: int = 0, key: Hashable = None) -> None:
        """Name a part of these triangles; those of the same `key` are one, those of a higher `rank` come later."""
        self._parts.setdefault((rank, len(self._parts) if key is None else key), (name, []))[1].append(own)

    def found(self) -> dict[str, Any]:
        """The fields of an animation that have them."""
        triangles, ranked = np.concatenate(self._triangles), sorted(self._parts, key=lambda key: key[0])
        parts = ((name, np.concatenate(own)) for name, own in map(self._parts.__getitem__, ranked))
        return {
            "triangles": triangles if len(triangles) else None,
            "texture": known(np.concatenate(self._texture)),
            "parts": parts_of(parts, triangles),
        }
