"""Meshes in STL files, text or binary: a list of triangles, each with its own three corners.

A corner that several triangles share is there several times, with the same numbers: equal positions become one vertex,
in the order in which they first come. Corners that differ in the last digit stay apart, as `weld` may join them.
Triangles with two equal corners have no area and are left out. STL names neither axes nor unit; most programs write it
z up. A text begins with `solid`; so do some binary files, so the length decides: 84 bytes and 50 for each triangle.
"""

from __future__ import annotations

import os
import re
import struct

import numpy as np

from clothfit.base.arrays import Array
from clothfit.base.errors import InvalidMotion
from clothfit.base.messages import counted
from clothfit.formats.animation import Animation, check_finite
from clothfit.formats.axes import Z_UP
from clothfit.formats.files import check_room, content, name_of

HEADER, TRIANGLE = 84, np.dtype([("normal", "<f4", 3), ("corners", "<f4", (3, 3)), ("attribute", "<u2")])

STL_COPIES = 12
"""Memory that reading a file takes at most, as a multiple of its size: float32 become float64, which are sorted."""

VERTEX = re.compile(rb"^[ \t]*vertex[ \t]+(\S+)[ \t]+(\S+)[ \t]+(\S+)[ \t\r]*$", re.MULTILINE | re.IGNORECASE)
FACET, LOOP_END = (re.compile(rb"^[ \t]*" + word, re.MULTILINE | re.IGNORECASE) for word in (b"facet\\b", b"endloop"))


def read(path: str | os.PathLike[str]) -> Animation:
    """The mesh, as an animation of one frame. Raises InvalidMotion."""
    name, data = name_of(path), content(path)
    check_room(STL_COPIES * len(data), path)
    whole = len(data) >= HEADER and len(data) == HEADER + TRIANGLE.itemsize * struct.unpack_from("<I", data, 80)[0]
    text = not whole and data[:512].lstrip().lower().startswith(b"solid") and b"\0" not in data[:512]
    corners = _text(data, name) if text else _binary(data, name)
    if not len(corners):
        raise InvalidMotion(f"{name}: there is no triangle in it")
    check_finite(name, corners)
    found, first, back = np.unique(corners + 0.0, axis=0, return_index=True, return_inverse=True)  # −0 is 0
    order = np.argsort(first)
    rank = np.empty(len(order), np.int32)
    rank[order] = np.arange(len(order))
    triangles = rank[back.reshape(-1)].reshape(-1, 3)
    flat = (triangles == np.roll(triangles, 1, axis=1)).any(axis=1)
    notes = [f"its {len(corners)} corners are {len(found)} different points, which are its vertices"]
    if flat.any():
        notes.append(f"{counted(int(flat.sum()), 'triangle', 'triangles')} with two equal corners left out")
    return Animation(found[order][None], Z_UP, triangles=triangles[~flat], notes=tuple(notes))


def _binary(data: bytes, name: str) -> Array:
    """Corners (3 T, 3) of a binary file; what follows the triangles is ignored. Raises InvalidMotion."""
    if len(data) < HEADER:
        raise InvalidMotion(f"{name}: it is not an STL file: it has {counted(len(data), 'byte', 'bytes')}")
    count = struct.unpack_from("<I", data, 80)[0]
    there = (len(data) - HEADER) // TRIANGLE.itemsize
    if there < count:
        said = f"{count} triangles are promised, {there} are there; export it again"
        raise InvalidMotion(f"{name}: it is cut off, or no STL file: {said}")
    table = np.frombuffer(data, TRIANGLE, count, HEADER)
    return table["corners"].astype(np.float64).reshape(-1, 3)


def _text(data: bytes, name: str) -> Array:
    """Corners (3 T, 3) of a text. Raises InvalidMotion."""
    found = VERTEX.findall(data)
    facets, closed = (len(each.findall(data)) for each in (FACET, LOOP_END))
    if not facets == closed == len(found) / 3:
        raise InvalidMotion(
            f"{name}: it is cut off or damaged: {counted(facets, 'facet', 'facets')}, {closed} of them complete, with "
            f"{counted(len(found), 'vertex', 'vertices')}, of which each needs 3; export it again"
        )
    try:
        return np.array(found, dtype=bytes).astype(np.float64).reshape(-1, 3)
    except ValueError:
        raise InvalidMotion(f"{name}: a coordinate in it is not a number") from None
