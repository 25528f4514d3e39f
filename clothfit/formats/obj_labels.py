"""Texture coordinates, groups, objects and materials of an OBJ file.

`vt u v` lines give the coordinates that corners such as `7/12` name, from 1 or backwards. `g`, `o` and `usemtl` hold
for the faces after them, until the next line of their kind; a `g` line may name several groups.
"""

from __future__ import annotations

import re
from array import array

import numpy as np
import numpy.typing as npt

from clothfit.base.arrays import Array, Indices
from clothfit.formats.animation import fans
from clothfit.formats.labels import Parts, known, parts_of

COORDINATES = re.compile(rb"^[ \t]*+vt(?=[ \t\n]|\Z)([^\n]*+)", re.MULTILINE)
LABELLED = re.compile(rb"^[ \t]*+(f|g|o|usemtl)(?=[ \t\n]|\Z)([^\n]*+)", re.MULTILINE)
KINDS = (b"g", b"o", b"usemtl")  # in the order of the parts
MOST_GROUPS = 8  # of a face


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
        corners.extend([_coordinate(word, before) for word in words])
    count = np.array(lengths, np.int64)
    face = np.repeat(np.arange(len(count)), np.maximum(count - 2, 0))  # of each triangle
    own = [(name.decode(errors="replace"), _of_faces(members[kind, name], face))
           for wanted in KINDS for kind, name in members if kind == wanted]
    number = np.array(corners, np.int64)[fans(count, np.arange(len(corners)))]
    return _texture(data, number), parts_of(own, triangles)


def _of_faces(faces: list[int], face: npt.NDArray[np.intp]) -> npt.NDArray[np.intp]:
    """The triangles of some faces."""
    return np.flatnonzero(np.isin(face, faces))


def _coordinate(word: bytes, before: int) -> int:
    """The texture coordinate, from 0, that a corner names; −1 where it names none."""
    try:
        number = int(word.split(b"/", 2)[1])
    except (ValueError, IndexError):
        return -1
    made = number - 1 if number > 0 else before + number if number < 0 else -1
    return made if -1 <= made < 2**31 else -1


def _texture(data: bytes, number: npt.NDArray[np.int64]) -> Array | None:
    """The coordinates of the corners (T, 3) that name these numbers."""
    rows = [_pair(line[1]) for line in COORDINATES.finditer(data)]
    table = np.array([*rows, (np.nan, np.nan)], np.float64)
    there = (number >= 0) & (number < len(rows))
    return known(table[np.where(there, number, len(rows))])


def _pair(text: bytes) -> tuple[float, float]:
    try:
        u, v = (float(word) for word in text.split()[:2])
    except ValueError:
        return np.nan, np.nan
    return u, v
