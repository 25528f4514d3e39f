"""Meshes in .ply: text or binary of either byte order, polygons of any number of corners, which become fans.

A header names elements, how many there are of each and which properties each of them has, in the order in which the
body gives them: numbers, or lists that begin with their length. The reader uses `vertex` with x, y, z and `face` with
`vertex_indices` (or `vertex_index`), texture coordinates of either (at vertices s, t or u, v, at faces `texcoord`), and
skips the rest. G. Turk, The PLY polygon file format, 1994.
"""

from __future__ import annotations

import os
import warnings
from dataclasses import replace
from typing import Any, NamedTuple

import numpy as np

from clothfit.base import memory
from clothfit.base.arrays import Array, Indices
from clothfit.base.errors import InvalidMotion
from clothfit.formats.animation import Animation, OtherPoints, check_finite, fans, known, of_scan
from clothfit.formats.axes import RIGHT
from clothfit.formats.files import check_room, content, name_of
from clothfit.formats.obj import frames_of, scanned

NUMBER_DTYPES = {
    "char": "i1", "int8": "i1", "uchar": "u1", "uint8": "u1", "short": "i2", "int16": "i2", "ushort": "u2",
    "uint16": "u2", "int": "i4", "int32": "i4", "uint": "u4", "uint32": "u4", "float": "f4", "float32": "f4",
    "double": "f8", "float64": "f8",
}  # fmt: skip
ORDERS = {"ascii": "", "binary_little_endian": "<", "binary_big_endian": ">"}
INDICES = ("vertex_indices", "vertex_index")
TEXTURES = (("s", "t"), ("u", "v"), ("texture_u", "texture_v"), ("texture_s", "texture_t"))  # of vertices

MOST_HEADER = 1 << 16
"""Bytes of a header."""

PLY_COPIES = 12
"""Memory that reading a file takes at most, as a multiple of its size: text becomes numbers of 8 bytes, which become
triangles.
"""

PROPERTY_BYTES = 500
"""Bytes that a property of a row takes, roughly, when rows are read one by one."""


class Property(NamedTuple):
    """A property of an element."""

    name: str
    number: str  # of a value, as in NumPy
    length: str | None  # the type of its length, where it is a list


class Element(NamedTuple):
    """One kind of element, as the header declares it."""

    name: str
    rows: int  # how many there are
    properties: list[Property]


def read(path: str | os.PathLike[str]) -> Animation:
    """Read a mesh, its vertices in the file's order, as an animation of one frame, or a sequence, as of OBJ files.
    Raises InvalidMotion.
    """
    files = frames_of(path)
    if len(files) == 1:
        return _mesh(files[0])
    animation = scan(path)
    if np.isnan(animation.positions).any():
        raise OtherPoints(f"{name_of(path)}: its frames have different numbers of vertices, or one is missing")
    return replace(animation, normals=None, triangles=_mesh(files[0]).triangles)


def scan(path: str | os.PathLike[str]) -> Animation:
    """A sequence whose frames have other points. Raises InvalidMotion."""
    return of_scan([*scanned(path, lambda each: ((mesh := _mesh(each)).positions[0], mesh.triangles))], RIGHT)


def _mesh(path: str | os.PathLike[str]) -> Animation:
    data = content(path)
    check_room(PLY_COPIES * len(data), path)
    try:
        elements, order, begin = _header(data)
        animation = _animation(_body(data[begin:], elements, order))
    except (ValueError, OverflowError) as error:
        raise InvalidMotion(f"{name_of(path)}: cannot be read as .ply: {error}; export it again") from None
    check_finite(name_of(path), animation.positions)
    return animation


def _header(data: bytes) -> tuple[list[Element], str, int]:
    """The elements, the byte order and where the body begins."""
    end = data.find(b"end_header", 0, MOST_HEADER)
    begin = data.find(b"\n", max(end, 0)) + 1
    lines = [line.split() for line in data[: max(end, 0)].decode("ascii", "replace").splitlines()]
    if not lines or lines[0] != ["ply"] or not begin:
        raise ValueError("it has no header")
    order, elements = None, []
    for line in lines[1:]:
        match line:
            case [] | ["comment" | "obj_info", *_]:
                pass
            case ["format", kind, _] if kind in ORDERS:
                order = ORDERS[kind]
            case ["element", name, count] if count.isdigit() and len(count) < 19:
                elements.append(Element(name, int(count), []))
            case ["property", number, name] if elements and number in NUMBER_DTYPES:
                elements[-1].properties.append(Property(name, NUMBER_DTYPES[number], None))
            case ["property", "list", count, number, name] if elements and {count, number} <= NUMBER_DTYPES.keys():
                elements[-1].properties.append(Property(name, NUMBER_DTYPES[number], NUMBER_DTYPES[count]))
            case _:
                raise ValueError(f"its header has a line that is not understood: {' '.join(line)[:40]!r}")
    if order is None:
        raise ValueError("its header does not name the format")
    return elements, order, begin


def _body(data: bytes, elements: list[Element], order: str) -> dict[tuple[str, str], Any]:
    """The columns by names of element and property; for a list a pair (lengths, values)."""
    sizes = {each: np.dtype(each).itemsize if order else 2 for each in NUMBER_DTYPES.values()}  # in text two at least
    least = sum(each.rows * sum(sizes[item.length or item.number] for item in each.properties) for each in elements)
    if least > len(data) + 1:  # text may lack its last space
        raise ValueError(f"it has {len(data)} bytes where its header asks for {least} or more")
    cursor = _Cursor(data, order)
    found: dict[tuple[str, str], Any] = {}
    for each in elements:
        if each.rows and each.properties:
            columns = _uniform(cursor, each) or _walked(cursor, each)
            found.update({(each.name, name): column for name, column in columns.items()})
    return found


class _Cursor:
    """Takes numbers from the body, one after another."""

    def __init__(self, data: bytes, order: str) -> None:
        self.order, self.at = order, 0
        self.data = data if order else _numbers(data).tobytes()

    def type(self, number: str) -> np.dtype[Any]:
        """The type of a number in this body."""
        return np.dtype(self.order + number if self.order else "f8")

    def has(self, kind: np.dtype[Any], count: int) -> bool:
        """Whether `count` numbers are left."""
        return 0 <= count * kind.itemsize <= len(self.data) - self.at

    def take(self, kind: np.dtype[Any], count: int) -> Any:
        """The next `count` numbers. Raises ValueError."""
        if not self.has(kind, count):
            raise ValueError("it ends early")
        values = np.frombuffer(self.data, kind, count, self.at)
        self.at += count * kind.itemsize
        return values


def _numbers(data: bytes) -> Array:
    with warnings.catch_warnings():
        warnings.simplefilter("error", DeprecationWarning)  # NumPy's way to say that a word is not a number
        try:
            return np.fromstring(data, sep=" ")
        except (DeprecationWarning, ValueError):  # which of them depends on the version of NumPy
            raise ValueError("a word in it is not a number") from None


def _uniform(cursor: _Cursor, each: Element) -> dict[str, Any] | None:
    """The columns, if all lists of a property are as long as its first; else None."""
    begin, fields = cursor.at, []
    for item in each.properties:
        length = 1
        if item.length is not None:
            length = int(cursor.take(cursor.type(item.length), 1)[0])
            fields.append((f"{item.name} count", cursor.type(item.length)))
        cursor.take(cursor.type(item.number), length)
        fields.append((item.name, cursor.type(item.number), (length,)))  # type: ignore[arg-type]  # a shape may follow
    cursor.at, row = begin, np.dtype(fields)
    if not cursor.has(row, each.rows):
        return None
    rows, found = cursor.take(row, each.rows), {}
    for item in each.properties:
        found[item.name] = values = rows[item.name].reshape(-1)
        if item.length is not None:
            lengths = rows[f"{item.name} count"]
            if (lengths != lengths[0]).any():
                cursor.at = begin
                return None
            found[item.name] = (lengths.astype(np.int64), values)
    return found


def _walked(cursor: _Cursor, each: Element) -> dict[str, Any]:
    """The columns, read row by row."""
    if memory.missing(PROPERTY_BYTES * each.rows * len(each.properties)) is not None:
        raise ValueError("so many lists of different lengths take more memory than is free")
    columns: dict[str, list[Any]] = {item.name: [] for item in each.properties}
    for _ in range(each.rows):
        for item in each.properties:
            length = 1 if item.length is None else int(cursor.take(cursor.type(item.length), 1)[0])
            columns[item.name].append(cursor.take(cursor.type(item.number), length))
    found: dict[str, Any] = {}
    for item in each.properties:
        lengths, values = [len(row) for row in columns[item.name]], np.concatenate(columns[item.name])
        found[item.name] = values if item.length is None else (np.array(lengths, np.int64), values)
    return found


def _animation(content: dict[tuple[str, str], Any]) -> Animation:
    missing = [axis for axis in "xyz" if ("vertex", axis) not in content]
    if missing:
        raise ValueError(f"it has no vertices with {missing[0]}")
    positions = np.stack([np.asarray(content["vertex", axis], np.float64) for axis in "xyz"], axis=-1)
    faces = next((content["face", name] for name in INDICES if ("face", name) in content), None)
    if faces is None:
        return Animation(positions[None], RIGHT)
    if not isinstance(faces, tuple):
        raise ValueError("its faces are not lists of vertices")
    lengths, corners = faces
    wrong = np.flatnonzero(~((corners >= 0) & (corners < len(positions)) & (corners == np.floor(corners))))
    if len(wrong):
        raise ValueError(f"a face names vertex {corners[wrong[0]]:g}; there are {len(positions)}")
    triangles = fans(lengths, corners.astype(np.int32))
    return Animation(positions[None], RIGHT, triangles=triangles, texture=_texture(content, lengths, triangles))


def _texture(content: dict[tuple[str, str], Any], lengths: Any, triangles: Indices) -> Array | None:
    """Texture coordinates (T, 3, 2) of the corners of the triangles; None where there are none."""
    sizes, values = content.get(("face", "texcoord"), (None, None))
    if sizes is not None and np.array_equal(sizes, 2 * lengths):
        every = np.asarray(values, np.float64).reshape(-1, 2)
        return known(every[fans(lengths, np.arange(len(every)))])
    for names in TEXTURES:
        columns = [content.get(("vertex", name)) for name in names]
        if all(isinstance(column, np.ndarray) for column in columns):
            return known(np.stack([np.asarray(column, np.float64) for column in columns], axis=-1)[triangles])
    return None
