"""OBJ files, and sequences of them: a file for each frame, `name_0000.obj`, `name_0001.obj`, …, as `name_*.obj`.

The reader takes the lines `v x y z` and `f a b c …`, with corners as `v`, `v/vt`, `v//vn` or `v/vt/vn`, counted from 1
or backwards from the last vertex before the line; of a single file it also reads texture coordinates and names of
parts: `vt u v` lines give the coordinates that corners such as `7/12` name, from 1 or backwards; `g`, `o` and `usemtl`
hold for the faces after them, until the next line of their kind; a `g` line may name several groups. The rest is
skipped. Vertices keep the order of the file, through all its objects and groups; polygons become fans of triangles. OBJ
has neither axes nor unit nor time: y up, right-handed and metres are what most programs write. Numbers are written in
full, so that float64 survives unchanged.
"""

from __future__ import annotations

import os
import re
from array import array
from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace
from functools import partial
from itertools import chain, pairwise
from typing import IO

import numpy as np

from clothfit.base.arrays import Array, Indices
from clothfit.base.errors import InvalidInput, InvalidMotion
from clothfit.base.messages import counted, unreadable
from clothfit.base.writing import Data
from clothfit.formats.animation import Animation, OtherPoints, Parts, fans, known, of_scan, parts_of
from clothfit.formats.axes import RIGHT
from clothfit.formats.files import check_room, content, name_of

ANY = "*"
"""The place of the frame number in the name of a sequence."""

DIGITS = 4
"""The fewest digits of a frame number."""

# Possessive quantifiers: no line, however long, is searched more than once.
VERTEX = re.compile(rb"^[ \t]*+v[ \t]++(\S++)[ \t]++(\S++)[ \t]++(\S++)", re.MULTILINE)
VERTEX_LINE = re.compile(rb"^[ \t]*+v(?=[ \t\n]|\Z)", re.MULTILINE)
FACE_LINE = re.compile(rb"^[ \t]*+f(?=[ \t\n]|\Z)([^\n]*+)", re.MULTILINE)

COORDINATES = re.compile(rb"^[ \t]*+vt(?=[ \t\n]|\Z)([^\n]*+)", re.MULTILINE)
LABELLED = re.compile(rb"^[ \t]*+(f|g|o|usemtl)(?=[ \t\n]|\Z)([^\n]*+)", re.MULTILINE)
KINDS = (b"g", b"o", b"usemtl")  # in the order of the parts
MOST_GROUPS = 8  # of a face

OBJ_COPIES = 10
"""Memory that reading a file takes at most, as a multiple of its size: three copies of the text, and three numbers from
the 8 bytes of `v 0 0 0`, or a triangle from 2 bytes of `f 1 1 1 1 1 …`.
"""

LONGEST_FACE = 1_000_000
"""Bytes of a line with a face."""


def read(path: str | os.PathLike[str]) -> Animation:
    """A file, as an animation of one frame, or a sequence, with the faces of its first frame; frames that are missing
    in it were not seen. Raises InvalidMotion.
    """
    places = frames_at(path)
    read, there = read_frames(list(places.values()), path), list(places)
    if (missing := there[-1] + 1 - len(there)) == 0:
        return read
    positions = np.full((there[-1] + 1, *read.positions.shape[1:]), np.nan)
    positions[there] = read.positions
    note = f"{counted(missing, 'frame is missing and counts', 'frames are missing and count')} as not seen"
    return replace(read, positions=positions, notes=(*read.notes, note))


def scan(path: str | os.PathLike[str]) -> Animation:
    """A sequence whose frames have other points. Raises InvalidMotion."""
    return of_scan([*scanned(path, lambda each: ((text := _Text(each)).points(), text.triangles()))], RIGHT)


def scanned(
    path: str | os.PathLike[str], read: Callable[[str], tuple[Array, Indices | None]]
) -> Iterator[tuple[Array, Indices | None]]:
    """The points and triangles of the frames of a sequence as they are `read`; none of those that are missing."""
    places = frames_at(path)
    for frame in range(max(places) + 1):
        yield read(places[frame]) if frame in places else (np.zeros((0, 3)), None)


def read_frames(paths: Sequence[str], path: str | os.PathLike[str]) -> Animation:
    """The files of a sequence, in their order; `path` names it in messages. Raises InvalidMotion."""
    first = _Text(paths[0])
    points, triangles = first.points(), first.triangles()
    check_room(len(paths) * points.nbytes, path)
    positions = np.empty((len(paths), *points.shape))
    positions[0] = points
    for frame, each in enumerate(paths[1:], 1):
        later = _Text(each)
        points = later.points()
        if points.shape != positions.shape[1:]:
            first_has = f"{name_of(paths[0])} has {positions.shape[1]}"
            raise OtherPoints(f"{name_of(each)}: has {len(points)} vertices, {first_has}, as all frames need")
        if later.faces() not in (0, first.faces()):
            raise InvalidMotion(f"{name_of(each)}: has other faces than {name_of(paths[0])}; is it of another mesh?")
        positions[frame] = points
    texture, parts = labels(first.data, triangles)
    faces = triangles if len(triangles) else None
    return Animation(positions, RIGHT, triangles=faces, texture=texture, parts=parts)


def frames_of(path: str | os.PathLike[str]) -> list[str]:
    """The files of a sequence in the order of their numbers, or the one file. Raises InvalidMotion."""
    return list(frames_at(path).values())


def frames_at(path: str | os.PathLike[str]) -> dict[int, str]:
    """The same by their places, from 0, of which some may be missing, but less than there are. Raises InvalidMotion."""
    text = os.fspath(path)
    if ANY not in text:
        return {0: text}
    found: dict[int, str] = {}
    for number, each in sorted(numbered(text)):
        if number in found:
            twice = f"{name_of(found[number])} and {name_of(each)}"
            raise InvalidMotion(f"{name_of(text)}: {twice} are both frame {number}; remove one")
        found[number] = each
    if not found:
        raise InvalidMotion(f"{name_of(text)}: there is no file of that name with a number in place of {ANY}")
    first, *others = numbers = list(found)
    step = min((b - a for a, b in pairwise(numbers)), default=1)
    odd = next((number for number in others if (number - first) % step), None)
    if odd is not None:
        raise InvalidMotion(f"{name_of(text)}: number {odd} is none of {first}, {first + step}, {first + 2 * step} …")
    if (places := 1 + (numbers[-1] - first) // step) >= 2 * len(numbers):
        raise InvalidMotion(f"{name_of(text)}: only {len(numbers)} of {places} frames are there")
    return {(number - first) // step: each for number, each in found.items()}


def numbered(path: str) -> list[tuple[int, str]]:
    """The files whose names have a number in place of the *, as pairs of number and path.

    Raises InvalidMotion where the name has no such place, or the folder cannot be read.
    """
    folder, name = os.path.split(path)
    if ANY in folder or name.count(ANY) != 1:
        raise InvalidMotion(f"{path}: a sequence has one {ANY}, in the name of its files, in place of their numbers")
    pattern = re.compile(re.escape(name).replace(re.escape(ANY), "([0-9]{1,18})"))
    try:
        there = os.listdir(folder or ".")
    except (OSError, ValueError) as error:
        raise InvalidMotion(f"{path}: {unreadable(error)}") from None
    found = ((pattern.fullmatch(each), each) for each in there)
    return [(int(match[1]), os.path.join(folder, each)) for match, each in found if match]


def check_name(path: str, frames: int) -> None:
    """Raise InvalidInput where several frames are to be written to one file."""
    if ANY not in path and frames != 1:
        root, suffix = os.path.splitext(path)
        raise InvalidInput(f"{path}: holds one frame, there are {frames}; write {root}_{ANY}{suffix}")


def encoded(path: str | os.PathLike[str], animation: Animation) -> dict[str, Data]:
    """The files of a sequence, numbered from 0, or of one frame. Raises InvalidInput where several need a * in `path`.
    """
    text, frames = os.fspath(path), animation.positions
    check_name(text, len(frames))
    rows = [] if animation.triangles is None else (animation.triangles + 1).tolist()
    faces = "".join([f"f {a} {b} {c}\n" for a, b, c in rows]).encode()
    names = (numbered_name(text, frame) for frame in range(len(frames)))
    return {name: partial(_write, points=points, faces=faces) for name, points in zip(names, frames, strict=True)}


def numbered_name(path: str, frame: int) -> str:
    """The name of a frame's file."""
    return path.replace(ANY, f"{frame:0{DIGITS}d}")


def _write(file: IO[bytes], points: Array, faces: bytes) -> None:
    for first in range(0, len(points), 10_000):  # the text of a large mesh need not be in memory
        rows = points[first : first + 10_000].tolist()
        file.write("".join([f"v {x!r} {y!r} {z!r}\n" for x, y, z in rows]).encode())
    file.write(faces)


class _Text:
    """The text of one file, its bytes at their places, so that a place gives the number of its line."""

    def __init__(self, path: str) -> None:
        self.name = name_of(path)
        data = content(path)
        check_room(OBJ_COPIES * len(data), path)
        data = data.removeprefix(b"\xef\xbb\xbf").replace(b"\r\n", b"\n").replace(b"\r", b"\n")
        self.lines = data  # as an editor counts them
        self.data = data.replace(b"\\\n", b"  ")  # with continued lines in one

    def points(self) -> Array:
        """Positions (n, 3) of its vertices. Raises InvalidMotion."""
        coordinates = (match.groups() for match in VERTEX.finditer(self.data))
        try:
            numbers = np.fromiter(map(float, chain.from_iterable(coordinates)), np.float64)
        except ValueError:
            numbers = np.zeros(0)
        count = len(VERTEX_LINE.findall(self.data))
        if not count:
            raise InvalidMotion(f"{self.name}: has no vertices (lines v x y z); is it an OBJ file?")
        if len(numbers) != 3 * count or np.isinf(numbers).any():
            raise InvalidMotion(f"{self.name}: line {self._wrong()}: a vertex needs three finite numbers")
        return numbers.reshape(count, 3)

    def faces(self) -> int:
        """Roughly the number of lines with faces: those that begin as programs write them."""
        return self.data.count(b"\nf ")

    def triangles(self) -> Indices:
        """Triangles (T, 3) of its faces, vertices from 0. Raises InvalidMotion."""
        starts = np.array([match.start() for match in VERTEX_LINE.finditer(self.data)])
        flat = array("i")
        for face in FACE_LINE.finditer(self.data):
            before = int(np.searchsorted(starts, face.start())) if b"-" in face[1] else 0
            corners = [_corner(word, before) for word in face[1][:LONGEST_FACE].split(b"#", 1)[0].split()]
            valid = all(0 <= corner < len(starts) for corner in corners)
            if not valid or len(corners) < 3 or len(face[1]) > LONGEST_FACE:
                place = f"{self.name}: line {self._line(face.start())}"
                raise InvalidMotion(f"{place}: a face needs three corners or more, each one of {len(starts)} vertices")
            for b, c in pairwise(corners[1:]):
                flat.extend((corners[0], b, c))
        return np.array(flat, np.int32).reshape(-1, 3)

    def _line(self, at: int) -> int:
        return self.lines.count(b"\n", 0, at) + 1

    def _wrong(self) -> int:
        """The line of the first invalid vertex."""
        for begin in VERTEX_LINE.finditer(self.data):
            match = VERTEX.match(self.data, begin.start())
            try:
                good = match is not None and not any(np.isinf(float(word)) for word in match.groups())
            except ValueError:
                good = False
            if not good:
                break
        return self._line(begin.start())


def _corner(word: bytes, before: int, part: int = 0) -> int:
    """The vertex, from 0, that a corner names, or the texture coordinate with `part` 1; −1 where it names none.
    `before`: how many of them are above its line.
    """
    try:
        number = int(word.split(b"/", part + 1)[part])
    except (ValueError, IndexError):
        return -1
    made = number - 1 if number > 0 else before + number if number < 0 else -1
    return made if -1 <= made < 2**31 else -1


def labels(data: bytes, triangles: Indices) -> tuple[Array | None, Parts]:
    """Texture coordinates (T, 3, 2), NaN where unknown, and parts, of a text whose faces make `triangles` (T, 3)."""
    has = re.search(rb"^[ \t]*+(vt|g|o|usemtl)[ \t]", data, re.MULTILINE)
    if has is None or not len(triangles):
        return None, ()
    starts = np.array([match.start() for match in COORDINATES.finditer(data)])
    lengths, corners = array("i"), array("i")
    current: dict[bytes, list[bytes]] = {kind: [] for kind in KINDS}
    members: dict[tuple[bytes, bytes], list[int]] = {}
    for line in LABELLED.finditer(data):
        kind, text = line[1], line[2].split(b"#", 1)[0] if line[1] == b"f" else line[2]
        if kind != b"f":
            current[kind] = text.split()[:MOST_GROUPS] if kind == b"g" else [text.strip()]
            continue
        words = text.split()
        before = int(np.searchsorted(starts, line.start())) if b"-" in text else 0
        for key in [(each, name) for each in KINDS for name in current[each]]:
            members.setdefault(key, []).append(len(lengths))
        lengths.append(len(words))
        corners.extend([_corner(word, before, 1) for word in words])
    count = np.array(lengths, np.int64)
    face = np.repeat(np.arange(len(count)), np.maximum(count - 2, 0))  # of each triangle
    own = [(name.decode(errors="replace"), np.flatnonzero(np.isin(face, members[kind, name])))
           for wanted in KINDS for kind, name in members if kind == wanted]
    number = np.array(corners, np.int64)[fans(count, np.arange(len(corners)))]
    table = np.array([*(_pair(line[1]) for line in COORDINATES.finditer(data)), (np.nan, np.nan)], np.float64)
    there = (number >= 0) & (number < len(table) - 1)  # the last row is for corners that name none
    return known(table[np.where(there, number, -1)]), parts_of(own, triangles)


def _pair(text: bytes) -> tuple[float, float]:
    try:
        u, v = (float(word) for word in text.split()[:2])
    except ValueError:
        return np.nan, np.nan
    return u, v
