"""What a GLB file is made of: a JSON document, and beside it the numbers, which its accessors describe.

glTF 2.0 specification, Khronos Group 2021, chapters 3.6 and 4.4; GLB is 12 bytes of header and two chunks. Whatever the
document says of counts, offsets and indices is held against what is there before an array is made of it.
"""

from __future__ import annotations

import base64
import binascii
import json
import os
import struct
from typing import Any

import numpy as np

from clothfit.arrays import Array
from clothfit.errors import InvalidMotion
from clothfit.formats.files import check_room, content, name_of
from clothfit.words import named, shown

MAGIC, JSON_CHUNK, BIN_CHUNK = b"glTF", b"JSON", b"BIN\0"

COMPONENTS = {5120: "<i1", 5121: "<u1", 5122: "<i2", 5123: "<u2", 5125: "<u4", 5126: "<f4"}
WIDTHS = {"SCALAR": 1, "VEC3": 3, "VEC4": 4}

HARMLESS = ("KHR_mesh_quantization", "KHR_materials_", "KHR_texture_", "EXT_texture_", "KHR_lights_punctual")
"""Beginnings of the names of extensions that a file may require: they do not change where its vertices are."""


class Document:
    """A GLB file, of which the parts are asked for by kind and index. Everything in it raises InvalidMotion."""

    def __init__(self, path: str | os.PathLike[str]) -> None:
        self.path, self.name = path, name_of(path)
        text, self._binary = self._chunks(content(path))
        try:
            self._json = json.loads(text)
        except (ValueError, RecursionError) as error:
            reason = str(error) or "it is nested too deeply"
            raise InvalidMotion(f"{self.name}: its JSON cannot be read ({reason[:100]})") from None
        self._buffers: dict[int, bytes] = {}
        self._taken = 0  # bytes of all arrays together: many parts may name the same numbers
        self.root: dict[str, Any] = self.require(self._json, dict, "a JSON object", "")
        self._check_extensions()

    def _chunks(self, data: bytes) -> tuple[bytes, bytes]:
        """The two chunks; the second may be missing."""
        if data[:4] != MAGIC or len(data) < 20:
            raise InvalidMotion(f"{self.name}: it is not a GLB file, which begins with glTF; export as .glb")
        version, length = struct.unpack_from("<II", data, 4)
        if version != 2:
            raise InvalidMotion(f"{self.name}: it is of glTF version {version}; export version 2")
        found: dict[bytes, bytes] = {}
        place, end = 12, length
        while place + 8 <= end:
            size, kind = struct.unpack_from("<I4s", data, place) if place + 8 <= len(data) else (0, b"")
            if place + 8 + size > len(data):
                break
            found.setdefault(kind, data[place + 8 : place + 8 + size])
            place += 8 + size
        if length > len(data) or place < end or JSON_CHUNK not in found:
            raise InvalidMotion(f"{self.name}: it is cut off or damaged; export it again")
        return found[JSON_CHUNK], found.get(BIN_CHUNK, b"")

    def _check_extensions(self) -> None:
        for each in self.items(self.root, "extensionsRequired"):
            if not str(each).startswith(HARMLESS):
                told = f"it needs the extension {named(str(each))}; export without it, and without compression"
                raise InvalidMotion(f"{self.name}: {told}")

    def require(self, value: Any, kind: type, what: str, place: str) -> Any:
        """A value of the document, when it is of a type; true and false are no numbers."""
        if not isinstance(value, kind) or (isinstance(value, bool) and kind is not bool):
            where = f"{self.name}: {place}" if place else self.name
            raise InvalidMotion(f"{where}: {shown(value)} is not {what}")
        return value

    def items(self, owner: dict[str, Any], key: str) -> list[Any]:
        """The list under a key; empty when it is missing."""
        found: list[Any] = self.require(owner.get(key, []), list, "a list", key)
        return found

    def item(self, kind: str, index: Any) -> dict[str, Any]:
        """A part such as `nodes[2]`."""
        there = self.items(self.root, kind)
        if not isinstance(index, int) or isinstance(index, bool) or not 0 <= index < len(there):
            raise InvalidMotion(f"{self.name}: {kind}[{shown(index)}] does not exist")
        found: dict[str, Any] = self.require(there[index], dict, "an object", f"{kind}[{index}]")
        return found

    def whole(self, owner: dict[str, Any], key: str, default: int | None = 0) -> int:
        """A count or an offset."""
        value: int = self.require(owner.get(key, default), int, "a whole number", key)
        if not 0 <= value < 2**40:
            raise InvalidMotion(f"{self.name}: {key}: {shown(value)} is not a count of what is in a file")
        return value

    def numbers(self, owner: dict[str, Any], key: str, default: list[float]) -> Array:
        """A list of as many finite numbers as the default has."""
        found = owner.get(key, default)
        right = isinstance(found, list) and all(type(each) in (int, float) and abs(each) < 1e30 for each in found)
        if not right or len(found) != len(default):
            raise InvalidMotion(f"{self.name}: {key}: {shown(found)} is not a list of {len(default)} numbers")
        return np.array(found, np.float64)

    def accessor(self, index: Any, kind: str) -> Array:
        """The numbers (count, width) of an accessor of a type such as VEC3."""
        described, place = self.item("accessors", index), f"accessors[{shown(index)}]"
        if described.get("type") != kind:
            raise InvalidMotion(f"{self.name}: {place}: its type is {shown(described.get('type'))}, not {kind}")
        count, width = self.whole(described, "count", None), WIDTHS[kind]
        if count > len(self._binary) + len(self._json) and "bufferView" not in described:
            raise InvalidMotion(f"{self.name}: {place}: {count} items are promised, which cannot be in the file")
        self._taken += 4 * 8 * count * width  # with what is computed from them
        check_room(self._taken, self.path)
        values = np.zeros((count, width))
        if "bufferView" in described:
            values[:] = self._stored(described, described, count, width, place)
        if "sparse" in described:
            sparse = self.require(described["sparse"], dict, "an object", f"{place}.sparse")
            self._replace(values, sparse, described, place)
        return values

    def _replace(self, values: Array, sparse: dict[str, Any], owner: dict[str, Any], place: str) -> None:
        """Put the items of a sparse accessor that differ into `values`."""
        count = self.whole(sparse, "count", None)
        where = self.require(sparse.get("indices"), dict, "an object", f"{place}.sparse.indices")
        what = self.require(sparse.get("values"), dict, "an object", f"{place}.sparse.values")
        if count > len(values):
            raise InvalidMotion(f"{self.name}: {place}: {count} items are promised, which cannot be in the file")
        indices = self._stored(where, {"componentType": where.get("componentType")}, count, 1, place)[:, 0]
        if not (indices < len(values)).all():
            raise InvalidMotion(f"{self.name}: {place}: its sparse items lie beyond its end")
        values[indices.astype(np.int64)] = self._stored(what, owner, count, values.shape[1], place)

    def _stored(self, where: dict[str, Any], form: dict[str, Any], count: int, width: int, place: str) -> Array:
        """Numbers of a buffer view; integers that stand for fractions become those."""
        dtype = np.dtype(COMPONENTS.get(self.whole(form, "componentType"), "V1"))
        if dtype.kind == "V":
            raise InvalidMotion(f"{self.name}: {place}: componentType is not one of glTF's")
        view = self.item("bufferViews", where.get("bufferView"))
        buffer = self._buffer(view.get("buffer"))
        begin, length = self.whole(view, "byteOffset"), self.whole(view, "byteLength")
        size, offset = dtype.itemsize * width, self.whole(where, "byteOffset")
        stride = self.whole(view, "byteStride", size)
        last = offset + stride * (count - 1) + size if count else 0
        if begin + length > len(buffer) or last > length or stride < size:
            raise InvalidMotion(f"{self.name}: {place}: its numbers reach beyond what is there")
        if not count:
            return np.zeros((0, width))
        values = np.ndarray((count, width), dtype, buffer, begin + offset, (stride, dtype.itemsize)).astype(np.float64)
        if form.get("normalized") and dtype.kind in "iu":
            return np.maximum(values / np.iinfo(dtype).max, -1.0)
        return values

    def _buffer(self, index: Any) -> bytes:
        """The bytes of a buffer: the second chunk, or what is in the document itself. Other files are not opened."""
        described = self.item("buffers", index)
        if index not in self._buffers:
            uri = described.get("uri")
            if uri is None and index == 0:
                self._buffers[index] = self._binary
            elif isinstance(uri, str) and uri.startswith("data:") and ";base64," in uri[:100]:
                self._buffers[index] = self._decoded(uri.partition(",")[2])
            else:
                raise InvalidMotion(f"{self.name}: its numbers are in another file; export all into one .glb")
        return self._buffers[index]

    def _decoded(self, text: str) -> bytes:
        try:
            return base64.b64decode(text)
        except (ValueError, binascii.Error):
            raise InvalidMotion(f"{self.name}: it is cut off or damaged; export it again") from None
