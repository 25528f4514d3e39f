"""Motions in Alembic files (.abc): meshes whose points have samples over time, below transforms.

Alembic is right-handed and usually y up, as Blender and Maya write it; it names no unit. No Python library that reads
it is maintained on PyPI, so this module reads its container itself: meshes (PolyMesh, SubD) with points, faces, texture
coordinates, and the transforms above them. Of several meshes those whose points move are the cloth; where none does,
the times are those of the transforms. Faces go clockwise there, so their corners are reversed. Files in the older HDF5
container are refused.

The container, Ogawa, is a tree of groups and data; numbers are little-endian. A file begins with `Ogawa`, a byte that
is 0xff once it is complete, a version of two bytes, and the place of the root group. A group is the number of its
children and their places; the highest bit marks data, which are a length and the bytes. Children of the root: two
versions, the top object, its metadata, the samplings of time, and the metadata that headers name by index. An object is
a group of its properties, its child objects, and their headers; a compound property is a group of properties and their
headers; an array property has two children for each sample that differs from the one before, values (after a digest of
16 bytes) and dimensions; a scalar property has one.

Each place and count is checked against the file before it is used. Format: the sources of Alembic 1.8, AbcCoreOgawa.
"""

from __future__ import annotations

import os
import struct
from collections.abc import Callable, Iterator, Sequence
from contextlib import suppress
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from clothfit.base.arrays import Array
from clothfit.base.errors import InvalidMotion
from clothfit.base.messages import named
from clothfit.formats import animation
from clothfit.formats.axes import RIGHT
from clothfit.formats.files import check_room, content, name_of
from clothfit.formats.joints import baked

MESH_SCHEMAS = ("AbcGeom_PolyMesh_v1", "AbcGeom_SubD_v1")
XFORM_SCHEMA = "AbcGeom_Xform_v3"

LEVELS, MOST_OBJECTS = 100, 100_000
"""The most levels of objects, and objects in all."""

CHANNELS = {0: 3, 1: 3, 2: 4, 3: 16, 4: 1, 5: 1, 6: 1}
"""Numbers of each operation of a transform: scale, translate, rotate about an axis, matrix, rotate about x, y, z."""


DATA, DAMAGED = 1 << 63, "it is cut off or damaged; export it again"
"""What marks the place of data; what a file that contradicts itself is."""

DTYPES = ("?", "<u1", "<i1", "<u2", "<i2", "<u4", "<i4", "<u8", "<i8", "<f2", "<f4", "<f8")
"""Types of numbers, by their code; those after them are strings."""

ARRAY_PAIR = 2
"""Children for each sample of an array property; a scalar has one. Codes from this on are arrays."""

DIGEST, HASHES = 16, 32
"""Bytes before each sample, and after the headers of child objects."""

ACYCLIC = 1e300
"""s: a time per cycle that large means that all times are listed."""

OWN_METADATA = 0xFF
"""The index of metadata that follow the header."""


class Property(NamedTuple):
    """A property of an object, by its header."""

    place: int  # of its group
    width: int  # children for each sample; 0: it has properties of its own
    dtype: str | None  # of a number; None: text
    extent: int  # numbers of an item
    samples: int
    first: int  # the first sample that differs from the one before
    last: int  # the last
    sampling: int  # index of its times

    @property
    def moves(self) -> bool:
        """Whether its samples differ."""
        return self.samples > 1 and not self.first == self.last == 0


class Object(NamedTuple):
    """An object, by its header."""

    name: str
    schema: str
    place: int  # of its group


class Ogawa:
    """The bytes of a file. All methods raise ValueError where the file contradicts itself."""

    def __init__(self, data: bytes) -> None:
        self.data = data
        if data[5] != 0xFF:
            raise ValueError("it was not written to its end; export it again")
        root = self.children(self._one("<Q", 8))
        if len(root) < 6:
            raise ValueError("its root is not that of an Alembic archive")
        self.top = Object("", "", root[2])
        self._samplings = list(self._read_samplings(self.block(root[4])))
        header = _Header(self.block(root[5]))
        self._metadata = [b""]
        while header.left:
            self._metadata.append(header.take(header.number("B")))

    def _one(self, form: str, place: int) -> Any:
        if place < 0 or place + struct.calcsize(form) > len(self.data):
            raise ValueError(DAMAGED)
        return struct.unpack_from(form, self.data, place)[0]

    def children(self, place: int) -> list[int]:
        """The places of the children of a group; that at 0 has none."""
        if place == 0 or place & DATA:
            return []
        count = self._one("<Q", place)
        self._one("B", place + 8 * count + 7)
        return list(struct.unpack_from(f"<{count}Q", self.data, place + 8))

    def block(self, place: int) -> bytes:
        """The bytes of data."""
        if not place & DATA:
            raise ValueError(DAMAGED)
        place &= DATA - 1
        if place == 0:
            return b""
        size = self._one("<Q", place)
        if size:
            self._one("B", place + 8 + size - 1)
        return self.data[place + 8 : place + 8 + size]

    def objects(self, parent: Object) -> Iterator[Object]:
        """The children of an object."""
        places = self.children(parent.place)
        if not places or not places[-1] & DATA:
            return
        header = _Header(self.block(places[-1])[:-HASHES])
        for place in places[1:-1]:
            name, index = header.text(header.number("<I")), header.number("B")
            known = self._metadata[index] if index < len(self._metadata) else b""
            metadata = header.take(header.number("<I")) if index == OWN_METADATA else known
            pairs = (each.partition("=") for each in metadata.decode("utf-8", "replace").split(";"))
            yield Object(name, next((value for key, _, value in pairs if key == "schema"), ""), place)

    def properties(self, group: int) -> dict[str, Property]:
        """The properties in a group, by their names."""
        places = self.children(group)
        if not places or not places[-1] & DATA:
            return {}
        header = _Header(self.block(places[-1]))
        return dict(self._property(header, place) for place in places[:-1])

    @staticmethod
    def _property(header: _Header, place: int) -> tuple[str, Property]:
        info = header.number("<I")
        form, kind, code = ("<B", "<H", "<I", "<I")[info >> 2 & 3], info & 3, info >> 4 & 15
        count = first = last = sampling = 0
        if kind:
            count = header.number(form)
            if info & 0x200:
                first, last = header.number(form), header.number(form)
            elif not info & 0x800:
                first, last = 1, count - 1
            sampling = header.number(form) if info & 0x100 else 0
        name = header.text(header.number(form))
        if info >> 20 & 255 == OWN_METADATA:
            header.take(header.number(form))
        dtype = DTYPES[code] if code < len(DTYPES) else None
        return name, Property(place, min(kind, ARRAY_PAIR), dtype, info >> 12 & 255, count, first, last, sampling)

    def sample(self, own: Property, index: int) -> Array:
        """A sample (items, extent) of a property, as float64."""
        stored = 0 if not own.moves or index < own.first else min(index, own.last) - own.first + 1
        places = self.children(own.place)
        if own.dtype is None or not own.width or stored * own.width >= len(places):
            raise ValueError("a sample is missing; it is cut off or damaged, export it again")
        values = np.frombuffer(memoryview(self.block(places[stored * own.width]))[DIGEST:], own.dtype)
        return values.astype(np.float64).reshape(-1, max(own.extent, 1))

    def times(self, own: Property) -> Array:
        """Times, s, of the samples of a property."""
        if not own.sampling < len(self._samplings):
            raise ValueError("the times of a property are missing; it is damaged, export it again")
        cycle, listed = self._samplings[own.sampling]
        if own.samples > len(self.data) or (cycle >= ACYCLIC and own.samples > len(listed)):
            raise ValueError("it has more samples than times; it is damaged, export it again")
        if cycle >= ACYCLIC:
            return listed[: own.samples]
        which = np.arange(own.samples)
        return np.asarray(listed[which % len(listed)] + cycle * (which // len(listed)))

    @staticmethod
    def _read_samplings(data: bytes) -> Iterator[tuple[float, Array]]:
        """Time per cycle and times within it, of each sampling."""
        header = _Header(data)
        while header.left:
            header.number("<I")
            cycle, count = header.number("<d"), header.number("<I")
            listed = np.frombuffer(header.take(8 * count), "<f8")
            if not count or not np.isfinite(listed).all():
                raise ValueError("its times are no numbers; it is damaged, export it again")
            yield cycle, listed


class _Header:
    """Takes numbers and texts from bytes, one after another."""

    def __init__(self, data: bytes) -> None:
        self._data, self._at = data, 0

    @property
    def left(self) -> bool:
        return self._at < len(self._data)

    def take(self, count: int) -> bytes:
        if count > len(self._data) - self._at:
            raise ValueError("a header in it ends early; it is damaged, export it again")
        self._at += count
        return self._data[self._at - count : self._at]

    def number(self, form: str) -> Any:
        return struct.unpack(form, self.take(struct.calcsize(form)))[0]

    def text(self, count: int) -> str:
        return self.take(count).decode("utf-8", "replace")


class Shape(NamedTuple):
    """A mesh, and the transforms above it."""

    name: str
    properties: dict[str, Property]
    above: tuple[dict[str, Property], ...]  # of the transforms, from the top
    path: str  # its name and those of what is above it, with / between

    @property
    def points(self) -> Property:
        """The positions of its vertices."""
        return self.properties["P"]


def read(path: str | os.PathLike[str], wanted: str = "") -> animation.Animation:
    """The meshes of a file, or those that are `wanted`; one frame where nothing moves. Raises InvalidMotion."""
    found: animation.Animation = _opened(path, lambda file, name: _animation(file, name, wanted))
    return found


def paths(path: str | os.PathLike[str]) -> list[str]:
    """The paths of all meshes of a file. Raises InvalidMotion."""
    found: list[str] = _opened(path, lambda file, _: [shape.path for shape in _shapes(file)])
    return found


def _opened(path: str | os.PathLike[str], use: Callable[[Ogawa, str], Any]) -> Any:
    """What is made of a file and its name. Raises InvalidMotion."""
    name, data = name_of(path), content(path)
    if data.startswith(b"\x89HDF"):
        advice = f"convert it with: abcconvert -toOgawa {name} new.abc"
        raise InvalidMotion(f"{name}: it is in Alembic's older container, HDF5; {advice}")
    if not data.startswith(b"Ogawa") or len(data) < 16:
        raise InvalidMotion(f"{name}: it is not an Alembic file, which begins with Ogawa")
    try:
        with np.errstate(all="ignore"):  # what overflows is reported below
            return use(Ogawa(data), name)
    except InvalidMotion:
        raise
    except ValueError as error:
        raise InvalidMotion(f"{name}: cannot be read as Alembic: {error}") from None


def _animation(file: Ogawa, name: str, wanted: str) -> animation.Animation:
    notes: list[str] = []
    every = list(_shapes(file))
    shapes, moves = animation.moving(every, lambda each: each.points.moves, notes)
    if not shapes:
        raise InvalidMotion(f"{name}: there is no mesh in it")
    if wanted:
        shapes, notes = animation.chosen(every, [each.path for each in every], wanted, name), []
        moves = any(each.points.moves for each in shapes)
    if moves:
        changing = [each for each in shapes if each.points.moves]
        times = animation.common_times(name, [(each.name, file.times(each.points)) for each in changing])
    else:
        times = _transform_times(file, shapes)
        if wanted and len(times):  # between the keys it turns
            others = [file.times(each.points) for each in every if each.points.moves]
            times = baked(np.unique(np.concatenate([_transform_times(file, every), *others])))
        times = times if len(times) else np.zeros(1)
    animation.check_times(times, name)
    counts, start, faces = [len(file.sample(shape.points, 0)) for shape in shapes], 0, animation.Faces()
    check_room(len(times) * sum(counts) * 3 * 8 * 2, name)
    positions = np.empty((len(times), sum(counts), 3))
    for shape, count in zip(shapes, counts, strict=True):
        place, matrices = f"{name}: {named(shape.name)}", _matrices(file, shape, times)
        for frame, matrix in enumerate(matrices):
            points = file.sample(shape.points, frame if shape.points.moves else 0)
            if points.shape != (count, 3):
                raise InvalidMotion(f"{place}: its number of points changes over time; it must stay the same")
            positions[frame, start : start + count] = points @ matrix[:3, :3] + matrix[3, :3]
        lengths, corners = (_constant(file, shape, key, place) for key in (".faceCounts", ".faceIndices"))
        animation.check_polygons(lengths, corners, count, place)
        triangles = start + animation.fans(lengths, corners)
        texture = _texture(file, shape, len(corners))[animation.fans(lengths, np.arange(len(corners)))]
        faces.name(shape.name, np.arange(faces.count, faces.count + len(triangles)))
        faces.add(triangles, texture, turned=not np.linalg.det(matrices[0, :3, :3]) < 0)
        start += count
    animation.check_finite(name, positions)
    own_times = times if len(times) > 1 else None
    pins = _pins(file, shapes, counts).found(notes)
    return animation.Animation(positions, RIGHT, own_times, notes=tuple(notes), pins=pins, **faces.found())


def _transform_times(file: Ogawa, shapes: Sequence[Shape]) -> Array:
    """The times at which what is above some meshes has samples that differ."""
    values = (place[".vals"] for shape in shapes for place in shape.above if ".vals" in place)
    return np.unique(np.concatenate([np.zeros(0), *(file.times(own) for own in values if own.moves)]))


def _pins(file: Ogawa, shapes: Sequence[Shape], counts: Sequence[int]) -> animation.Pins:
    """The vertices, of all meshes one after another, that a parameter of their own marks as held."""
    found = animation.Pins()
    for shape, count in zip(shapes, counts, strict=True):
        own, weights = shape.properties.get(".arbGeomParams"), []
        for key, each in (file.properties(own.place) if own else {}).items():
            if animation.is_pin(key):
                with suppress(ValueError, KeyError, IndexError):  # of no numbers
                    weights.append((key, _values(file, each)))
        found.add(count, weights)
    return found


def _values(file: Ogawa, own: Property) -> Array:
    """The values (items, extent) of a parameter at its first sample, which may have indices of its own."""
    parts = file.properties(own.place) if not own.width else {".vals": own}
    values = file.sample(parts[".vals"], 0)
    return values[file.sample(parts[".indices"], 0).reshape(-1).astype(np.int64)] if ".indices" in parts else values


def _shapes(file: Ogawa) -> Iterator[Shape]:
    """The meshes of a file, in its order."""
    waiting: list[tuple[Object, tuple[dict[str, Property], ...], str]] = [(file.top, (), "")]
    met = 0
    while waiting:
        own, above, path = waiting.pop()
        path = f"{path}/{own.name}" if own.name else ""
        met += 1
        if len(above) > LEVELS or met > MOST_OBJECTS:
            raise ValueError(f"its objects are not a tree of at most {LEVELS} levels; it is damaged, export it again")
        groups = file.children(own.place)
        properties = file.properties(groups[0]) if groups else {}
        if own.schema in MESH_SCHEMAS and ".geom" in properties:
            mesh = file.properties(properties[".geom"].place)
            if "P" in mesh and mesh["P"].samples:
                yield Shape(own.name, mesh, above, path)
        inner = above
        if own.schema == XFORM_SCHEMA and ".xform" in properties:
            inner = (*above, file.properties(properties[".xform"].place))
        elif own is not file.top:
            inner = (*above, {})
        waiting += [(each, inner, path) for each in reversed(list(file.objects(own)))]


def _matrices(file: Ogawa, shape: Shape, times: Array) -> Array:
    """Matrices (frames, 4, 4) for row vectors, from the axes of a shape to those of the file."""
    product = np.broadcast_to(np.eye(4), (len(times), 4, 4))
    for place in shape.above:
        if ".inherits" in place and place[".inherits"].samples and not file.sample(place[".inherits"], 0).any():
            product = np.broadcast_to(np.eye(4), product.shape)
        if ".ops" in place and ".vals" in place and place[".ops"].samples:
            product = _local(file, place[".ops"], place[".vals"], times) @ product
    return product


def _local(file: Ogawa, ops: Property, values: Property, times: Array) -> Array:
    """Matrices (frames, 4, 4) of one transform, with a straight line between its samples."""
    codes = file.sample(ops, 0).reshape(-1).astype(int) >> 4
    own = file.times(values)
    count = len(own) if values.moves else 1
    made = np.array([_product(codes, file.sample(values, i).reshape(-1)) for i in range(count)])
    if count == 1:
        return np.broadcast_to(made[0], (len(times), 4, 4))
    after = np.clip(np.searchsorted(own, times), 1, count - 1)
    u = np.clip((times - own[after - 1]) / (own[after] - own[after - 1]), 0.0, 1.0)[:, None, None]
    return np.asarray((1 - u) * made[after - 1] + u * made[after])


def _product(codes: NDArray[np.int_], values: Array) -> Array:
    """The matrix of operations for row vectors, of which the first is applied last."""
    product, at = np.eye(4), 0
    for code in codes:
        if code not in CHANNELS or at + CHANNELS[code] > len(values):
            raise ValueError("a transform in it is not understood; it is damaged, export it again")
        own, matrix = values[at : at + CHANNELS[code]], np.eye(4)
        at += CHANNELS[code]
        if code == 0:
            matrix[[0, 1, 2], [0, 1, 2]] = own
        elif code == 1:
            matrix[3, :3] = own
        elif code == 3:
            matrix = own.reshape(4, 4)
        else:  # a turn (Rodrigues' formula) about an axis of any length
            axis, angle = (own[:3] if code == 2 else np.eye(3)[code - 4]), np.radians(own[-1])
            length = np.linalg.norm(axis)
            x, y, z = axis / length if length > 0 else np.zeros(3)
            cross = np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]])
            turn = np.eye(3) + np.sin(angle) * cross + (1 - np.cos(angle)) * cross @ cross
            matrix[:3, :3] = turn.T
        product = matrix @ product
    return product


def _constant(file: Ogawa, shape: Shape, key: str, place: str) -> NDArray[np.int64]:
    """Whole numbers that must not change. Raises InvalidMotion where they do."""
    own = shape.properties.get(key)
    if own is None or not own.samples:
        return np.zeros(0, np.int64)
    first = file.sample(own, 0).reshape(-1)
    changing = range(own.first, own.last + 1) if own.moves else ()
    if any(not np.array_equal(file.sample(own, index).reshape(-1), first) for index in changing):
        raise InvalidMotion(f"{place}: its faces change over time; export it without triangulating each frame")
    return first.astype(np.int64)


def _texture(file: Ogawa, shape: Shape, corners: int) -> Array:
    """Texture coordinates (corners, 2), NaN where there are none for each corner."""
    nothing = np.full((corners, 2), np.nan)
    own = shape.properties.get("uv")
    if own is None:
        return nothing
    try:
        values = _values(file, own)
    except (ValueError, KeyError, IndexError):
        return nothing
    return values if values.shape == nothing.shape else nothing
