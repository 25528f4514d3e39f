"""Ogawa, the container of Alembic files: a tree of groups and data, and Alembic's objects and properties in it.

Numbers are little-endian. A file begins with `Ogawa`, a byte that is 0xff once it is complete, a version of two bytes,
and the place of the root group. A group is the number of its children and their places; the highest bit marks data,
which are a length and the bytes. Children of the root: two versions, the top object, its metadata, the samplings of
time, and the metadata that headers name by index. An object is a group of its properties, its child objects, and their
headers; a compound property is a group of properties and their headers; an array property has two children for each
sample that differs from the one before, values (after a digest of 16 bytes) and dimensions; a scalar property has one.

Each place and count is checked against the file before it is used. Format: the sources of Alembic 1.8, AbcCoreOgawa.
"""

from __future__ import annotations

import struct
from collections.abc import Iterator
from typing import Any, NamedTuple

import numpy as np

from clothfit.base.arrays import Array

DATA = 1 << 63
"""Marks the place of data."""

DTYPES = ("?", "<u1", "<i1", "<u2", "<i2", "<u4", "<i4", "<u8", "<i8", "<f2", "<f4", "<f8")
"""Types of numbers, by their code; those after them are strings."""

SINGLE, ARRAY_PAIR = 1, 2
"""Children for each sample of a scalar and of an array property, which are also their codes."""

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
            raise ValueError("it is cut off or damaged; export it again")
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
            raise ValueError("it is cut off or damaged; export it again")
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
        header, found = _Header(self.block(places[-1])), {}
        for place in places[:-1]:
            name, made = self._property(header, place)
            found[name] = made
        return found

    def _property(self, header: _Header, place: int) -> tuple[str, Property]:
        info = header.number("<I")
        form = {0: "<B", 1: "<H", 2: "<I"}.get(info >> 2 & 3, "<I")
        kind, code = info & 3, info >> 4 & 15
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
        width = 0 if not kind else SINGLE if kind == SINGLE else ARRAY_PAIR
        return name, Property(place, width, dtype, info >> 12 & 255, count, first, last, sampling)

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
        which = np.arange(own.samples)
        if cycle >= ACYCLIC:
            return listed[: own.samples]
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
