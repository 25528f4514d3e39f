"""The parts of a glTF file: a JSON document, and the numbers that its accessors describe.

glTF 2.0 specification, Khronos Group 2021, chapters 3.6 and 4.4. GLB is 12 bytes of header and two chunks; a .gltf file
is the document alone. Its numbers stand in the document, as base64, or in files beside it, which must be in its folder
or below. The reader checks all counts, offsets and indices of the document against the numbers that are there before it
makes an array.
"""

from __future__ import annotations

import base64
import binascii
import json
import os
import struct
from pathlib import Path
from typing import Any
from urllib.parse import unquote

import numpy as np

from clothfit.base.arrays import Array
from clothfit.base.errors import InvalidMotion
from clothfit.base.messages import named, shown
from clothfit.formats.files import check_room, content, name_of

GLB_MAGIC, JSON_CHUNK, BIN_CHUNK = b"glTF", b"JSON", b"BIN\0"

COMPONENTS = {5120: "<i1", 5121: "<u1", 5122: "<i2", 5123: "<u2", 5125: "<u4", 5126: "<f4"}
COMPONENT_COUNTS = {"SCALAR": 1, "VEC2": 2, "VEC3": 3, "VEC4": 4}

HARMLESS = ("KHR_mesh_quantization", "KHR_materials_", "KHR_texture_", "EXT_texture_", "KHR_lights_punctual")
"""Beginnings of the names of extensions that a file may require, as they do not change where its vertices are."""


class Document:
    """A glTF file, whose parts are read by kind and index. All its methods raise InvalidMotion."""

    def __init__(self, path: str | os.PathLike[str]) -> None:
        self.path, self.name = path, name_of(path)
        data = content(path)
        self._size = len(data)
        text, self._binary = self._chunks(data)
        try:
            self._json = json.loads(text)
        except (ValueError, RecursionError) as error:
            reason = str(error) or "it is nested too deeply"
            cause = f"its JSON cannot be read ({reason[:100]}); it is cut off or damaged"
            raise InvalidMotion(f"{self.name}: {cause}") from None
        self._buffers: dict[int, bytes] = {}
        self._taken = 0  # bytes of all arrays together: many parts may name the same numbers
        self.root: dict[str, Any] = self.typed(self._json, dict, "an object", "its JSON")
        for each in self.items(self.root, "extensionsRequired"):
            if not str(each).startswith(HARMLESS):
                what = named(str(each))
                raise InvalidMotion(f"{self.name}: it needs the extension {what}; export without it, uncompressed")

    def _chunks(self, data: bytes) -> tuple[bytes, bytes]:
        """The document and the second chunk, which may be missing."""
        if data[:512].lstrip(b"\xef\xbb\xbf \t\r\n").startswith(b"{"):
            return data, b""
        if data[:4] != GLB_MAGIC or len(data) < 20:
            raise InvalidMotion(f"{self.name}: it is no glTF file, which begins with glTF, as .glb, or {{, as .gltf")
        version, length = struct.unpack_from("<II", data, 4)
        if version != 2:
            raise InvalidMotion(f"{self.name}: it is glTF version {version}; export version 2")
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

    def insist(self, right: bool, value: Any, what: str, place: str) -> None:
        """Raise InvalidMotion, with the value at a place and `what` it must be, unless it is right."""
        if not right:
            raise InvalidMotion(f"{self.name}: {place}: {shown(value)} is not {what}")

    def typed(self, value: Any, kind: type, what: str, place: str) -> Any:
        """A value of the document, which must have a type; true and false are not numbers."""
        self.insist(isinstance(value, kind) and not isinstance(value, bool), value, what, place)
        return value

    def items(self, owner: dict[str, Any], key: str) -> list[Any]:
        """The list under a key; empty when it is missing."""
        found: list[Any] = self.typed(owner.get(key, []), list, "a list", key)
        return found

    def item(self, kind: str, index: Any) -> dict[str, Any]:
        """A part such as `nodes[2]`."""
        return self.member(self.root, kind, index, kind)

    def member(self, owner: dict[str, Any], key: str, index: Any, place: str) -> dict[str, Any]:
        """An object in the list under a key."""
        there = self.items(owner, key)
        if type(index) is not int or not 0 <= index < len(there):
            raise InvalidMotion(f"{self.name}: {place}[{shown(index)}] does not exist")
        found: dict[str, Any] = self.typed(there[index], dict, "an object", f"{place}[{index}]")
        return found

    def whole(self, owner: dict[str, Any], key: str, default: int | None = 0) -> int:
        """A count or an offset."""
        value: int = self.typed(owner.get(key, default), int, "a whole number", key)
        self.insist(0 <= value < 2**40, value, "a count of what can be in a file", key)
        return value

    def numbers(self, owner: dict[str, Any], key: str, default: list[float]) -> Array:
        """A list of finite numbers, as many as in the default."""
        found = owner.get(key, default)
        right = isinstance(found, list) and all(type(each) in (int, float) and abs(each) < 1e30 for each in found)
        self.insist(right and len(found) == len(default), found, f"a list of {len(default)} numbers", key)
        return np.array(found, np.float64)

    def accessor(self, index: Any, kind: str) -> Array:
        """The numbers (count, width) of an accessor of a type such as VEC3."""
        described, place = self.item("accessors", index), f"accessors[{shown(index)}]"
        self.insist(described.get("type") == kind, described.get("type"), f"the type {kind}", place)
        count, width = self.whole(described, "count", None), COMPONENT_COUNTS[kind]
        self.insist("bufferView" in described or count <= self._size, count, "a count of what can be in a file", place)
        self._taken += 4 * 8 * count * width  # with what is computed from them
        check_room(self._taken, self.path)
        values = np.zeros((count, width))
        if "bufferView" in described:
            values[:] = self._stored(described, described, count, width, place)
        if "sparse" in described:
            sparse = self.typed(described["sparse"], dict, "an object", f"{place}.sparse")
            self._replace(values, sparse, described, place)
        return values

    def _replace(self, values: Array, sparse: dict[str, Any], owner: dict[str, Any], place: str) -> None:
        """Put the items that a sparse accessor changes into `values`."""
        count = self.whole(sparse, "count", None)
        where = self.typed(sparse.get("indices"), dict, "an object", f"{place}.sparse.indices")
        what = self.typed(sparse.get("values"), dict, "an object", f"{place}.sparse.values")
        self.insist(count <= len(values), count, "a count of what can be in a file", f"{place}.sparse")
        indices = self._stored(where, {"componentType": where.get("componentType")}, count, 1, place)[:, 0]
        self.insist(bool((indices < len(values)).all()), "indices", "within the accessor", f"{place}.sparse")
        values[indices.astype(np.int64)] = self._stored(what, owner, count, values.shape[1], place)

    def _stored(self, where: dict[str, Any], form: dict[str, Any], count: int, width: int, place: str) -> Array:
        """Numbers (count, width) of a buffer view; normalized integers become fractions."""
        component = self.whole(form, "componentType")
        self.insist(component in COMPONENTS, component, "a type of component that glTF has", place)
        dtype = np.dtype(COMPONENTS[component])
        view = self.item("bufferViews", where.get("bufferView"))
        buffer = self._buffer(view.get("buffer"))
        begin, length = self.whole(view, "byteOffset"), self.whole(view, "byteLength")
        size, offset = dtype.itemsize * width, self.whole(where, "byteOffset")
        stride = self.whole(view, "byteStride", size)
        last = offset + stride * (count - 1) + size if count else 0
        if begin + length > len(buffer) or last > length or stride < size:
            raise InvalidMotion(f"{self.name}: {place}: its numbers reach beyond the end of the buffer")
        if not count:
            return np.zeros((0, width))
        values = np.ndarray((count, width), dtype, buffer, begin + offset, (stride, dtype.itemsize)).astype(np.float64)
        if form.get("normalized") and dtype.kind in "iu":
            return np.maximum(values / np.iinfo(dtype).max, -1.0)
        return values

    def _buffer(self, index: Any) -> bytes:
        """The bytes of a buffer, from the second chunk, the document itself, or a file beside it."""
        described = self.item("buffers", index)
        if index not in self._buffers:
            uri = described.get("uri")
            if uri is None and index == 0:
                self._buffers[index] = self._binary
            elif isinstance(uri, str) and uri.startswith("data:") and ";base64," in uri[:100]:
                try:
                    self._buffers[index] = base64.b64decode(uri.partition(",")[2])
                except (ValueError, binascii.Error):
                    raise InvalidMotion(f"{self.name}: it is cut off or damaged; export it again") from None
            else:
                self._buffers[index] = self._beside(uri)
        return self._buffers[index]

    def _beside(self, uri: Any) -> bytes:
        """The bytes of a file in the folder of this one or below. No other file is opened, and no network."""
        folder = Path(os.fsdecode(self.path)).resolve().parent
        part = unquote(uri) if isinstance(uri, str) else ""
        try:
            place = (folder / part).resolve()
            own = bool(part) and ":" not in part and "\\" not in part and place.is_relative_to(folder)
        except (OSError, ValueError, RuntimeError):  # a name that no file can have, or a circle of links
            own = False
        where = f"{self.name}: its numbers are in {shown(part if own else uri)}, which is not"
        if not own:
            raise InvalidMotion(f"{where} a file in its folder; export as .glb")
        if not place.is_file():
            raise InvalidMotion(f"{where} there; copy it beside, or export as .glb")
        return content(place)
