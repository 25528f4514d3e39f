"""The parts of a glTF file: a JSON document, and the numbers that its accessors describe; and the contents of its
scene: the nodes with meshes, the tracks of its animation, and the meshes at some times.

glTF 2.0 specification, Khronos Group 2021, chapters 3.6 and 4.4, appendix C. GLB is 12 bytes of header and two chunks;
a .gltf file is the document alone. Its numbers stand in the document, as base64, or in files beside it, which must be
in its folder or below. The reader checks all counts, offsets and indices of the document against the numbers that are
there before it makes an array.

The nodes form a tree. The channels of an animation say which track drives which part of which node: values over time
between keys, by steps, straight lines, or cubic splines with given tangents. Rotations are unit quaternions
(x, y, z, w), on great arcs between their keys.

Meshes are triangles whose morph targets are added by their weights, on nodes that may move. Vertices are in the order
of the nodes, their meshes and primitives; primitives that share vertices give them once. A node that mirrors its mesh
reverses the corners of the triangles, so that their front stays outside.
"""

from __future__ import annotations

import base64
import binascii
import json
import os
import struct
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any, NamedTuple, TypeAlias
from urllib.parse import unquote

import numpy as np
from numpy.typing import NDArray

from clothfit.base.arrays import Array, Indices
from clothfit.base.errors import InvalidMotion
from clothfit.base.messages import named, spelt
from clothfit.formats.animation import Faces, Pins, check_times, is_pin
from clothfit.formats.files import check_room, content, name_of

GLB_MAGIC, JSON_CHUNK, BIN_CHUNK = b"glTF", b"JSON", b"BIN\0"

COMPONENTS = {5120: "<i1", 5121: "<u1", 5122: "<i2", 5123: "<u2", 5125: "<u4", 5126: "<f4"}
COMPONENT_COUNTS = {"SCALAR": 1, "VEC2": 2, "VEC3": 3, "VEC4": 4}

ANIMATED_TYPES = {"translation": "VEC3", "rotation": "VEC4", "scale": "VEC3", "weights": "SCALAR"}
INTERPOLATIONS = ("LINEAR", "STEP", "CUBICSPLINE")

LEVELS = 100
"""The most levels of nodes."""

NEARLY_PARALLEL = 0.9995
"""Two quaternions whose angle has a larger cosine are joined by a straight line, as the sine is near 0."""

AT_REST = {"translation": [0.0] * 3, "rotation": [0.0, 0.0, 0.0, 1.0], "scale": [1.0] * 3}

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
            raise InvalidMotion(f"{self.name}: {place}: {spelt(value)} is not {what}")

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
            raise InvalidMotion(f"{self.name}: {place}[{spelt(index)}] does not exist")
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
        described, place = self.item("accessors", index), f"accessors[{spelt(index)}]"
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
                self._buffers[index] = self._sibling(uri)
        return self._buffers[index]

    def _sibling(self, uri: Any) -> bytes:
        """The bytes of a file in the folder of this one or below. No other file is opened, and no network."""
        folder = Path(os.fsdecode(self.path)).resolve().parent
        part = unquote(uri) if isinstance(uri, str) else ""
        try:
            place = (folder / part).resolve()
            own = bool(part) and ":" not in part and "\\" not in part and place.is_relative_to(folder)
        except (OSError, ValueError, RuntimeError):  # a name that no file can have, or a circle of links
            own = False
        where = f"{self.name}: its numbers are in {spelt(part if own else uri)}, which is not"
        if not own:
            raise InvalidMotion(f"{where} a file in its folder; export as .glb")
        if not place.is_file():
            raise InvalidMotion(f"{where} there; copy it beside, or export as .glb")
        return content(place)



class Track(NamedTuple):
    """The keys of an animated quantity."""

    times: Array  # (keys,), s, increasing
    values: Array  # (keys, width); of splines (keys, 3, width): tangent before, value, tangent after
    kind: str  # STEP, LINEAR or CUBICSPLINE

    def at(self, times: Array, rotation: bool = False) -> Array:
        """Values (len(times), width); constant before the first key and after the last."""
        last = len(self.times) - 1
        index = np.clip(np.searchsorted(self.times, times, side="right") - 1, 0, last)
        after = np.minimum(index + 1, last)
        span = self.times[after] - self.times[index]
        u = np.clip((times - self.times[index]) / np.where(span > 0, span, 1.0), 0.0, 1.0)[:, None]
        if self.kind == "CUBICSPLINE":
            return self._spline(index, after, span[:, None], u)
        if self.kind == "STEP":
            return self.values[index]
        a, b = self.values[index], self.values[after]
        return _arc(a, b, u) if rotation else a + u * (b - a)

    def _spline(self, index: NDArray[Any], after: NDArray[Any], span: Array, u: Array) -> Array:
        """The cubic with the values and the tangents at both ends."""
        a, out = self.values[index, 1], span * self.values[index, 2]
        b, into = self.values[after, 1], span * self.values[after, 0]
        rise, bend = u * u * (3 - 2 * u), u * (u - 1)
        return np.asarray((1 - rise) * a + rise * b + bend * (u - 1) * out + bend * u * into)


Tracks: TypeAlias = dict[tuple[int, str], Track]
"""By node and what of it is animated, one of WIDTHS."""


class Placed(NamedTuple):
    """A node with a mesh."""

    node: int
    above: tuple[int, ...]  # its ancestors, the nearest last


def placed(doc: Document) -> Iterator[Placed]:
    """The nodes of the scene that have meshes, from the top."""
    waiting: list[tuple[Any, tuple[int, ...]]] = [(each, ()) for each in reversed(_tops(doc))]
    met: set[int] = set()
    found = False
    while waiting:
        index, above = waiting.pop()
        node = doc.item("nodes", index)
        if index in met or len(above) > LEVELS:
            raise InvalidMotion(f"{doc.name}: its nodes are not a tree of at most {LEVELS} levels")
        met.add(index)
        waiting += [(each, (*above, index)) for each in reversed(doc.items(node, "children"))]
        if "mesh" in node:
            found = True
            yield Placed(index, above)
    if not found:
        raise InvalidMotion(f"{doc.name}: there is no mesh in it")


def _tops(doc: Document) -> list[Any]:
    """The root nodes of the scene; without a scene, of all nodes."""
    if doc.items(doc.root, "scenes"):
        return doc.items(doc.item("scenes", doc.root.get("scene", 0)), "nodes")
    every = range(len(doc.items(doc.root, "nodes")))
    below = {each for index in every for each in doc.items(doc.item("nodes", index), "children") if type(each) is int}
    return [index for index in every if index not in below]


def animated(doc: Document, nodes: list[Placed]) -> tuple[Tracks, list[str]]:
    """The tracks of the first animation that changes shapes, else of the first, with those of all others that move none
    of the same: programs such as Blender write an animation for each object. And notes on it.
    """
    count = len(doc.items(doc.root, "animations"))
    skinned = any("skin" in doc.item("nodes", node.node) for node in nodes)
    if not count:
        return {}, ["its skeleton is left out, which does not move"] if skinned else []
    if skinned:
        raise InvalidMotion(f"{doc.name}: a skeleton moves its mesh; bake the motion into shape keys or a point cache")
    shapes = {node.node for node in nodes}
    each = [tracks_of(doc, index) for index in range(count)]
    changing = [i for i in range(count) if any(n in shapes and what == "weights" for n, what in each[i])]
    chosen = (changing or [0])[0]
    tracks, taken = dict(each[chosen]), [chosen]
    for other in range(count):
        if each[other] and not tracks.keys() & each[other].keys():
            tracks |= each[other]
            taken.append(other)
    numbers = ", ".join(str(i + 1) for i in sorted(taken))
    return tracks, [f"of its {count} animations number {numbers} is read"] if len(taken) < count else []


def tracks_of(doc: Document, index: int) -> Tracks:
    """The tracks of an animation."""
    animation = doc.item("animations", index)
    tracks: Tracks = {}
    for channel in doc.items(animation, "channels"):
        place = f"animations[{index}].channels"
        target = doc.typed(doc.typed(channel, dict, "an object", place).get("target"), dict, "an object", place)
        node, what = target.get("node"), target.get("path")
        if node is None or not isinstance(what, str) or what not in ANIMATED_TYPES:  # extensions animate other things
            continue
        doc.item("nodes", node)
        sampler = doc.member(animation, "samplers", channel.get("sampler"), f"animations[{index}].samplers")
        tracks[node, what] = _track(doc, sampler, what, f"animations[{index}].samplers")
    return tracks


def _track(doc: Document, sampler: dict[str, Any], what: str, place: str) -> Track:
    times = doc.accessor(sampler.get("input"), "SCALAR")[:, 0]
    check_times(times if len(times) else np.full(1, np.nan), f"{doc.name}: {place}")
    values = doc.accessor(sampler.get("output"), ANIMATED_TYPES[what])
    kind = sampler.get("interpolation", "LINEAR")
    doc.insist(kind in INTERPOLATIONS, kind, "a kind of interpolation that glTF has", place)
    items = len(times) * (3 if kind == "CUBICSPLINE" else 1)
    if not len(values) or len(values) % items or (what != "weights" and len(values) != items):
        raise InvalidMotion(f"{doc.name}: {len(values)} values of an animation do not match {len(times)} times")
    return Track(times, values.reshape((len(times), 3, -1) if kind == "CUBICSPLINE" else (len(times), -1)), kind)


def _arc(a: Array, b: Array, u: Array) -> Array:
    """The rotation between two others, along the shorter way: −b is the same rotation as b."""
    cosine = np.sum(a * b, axis=-1, keepdims=True)
    b, cosine = np.where(cosine < 0, -b, b), np.clip(np.abs(cosine), 0.0, 1.0)
    angle = np.arccos(np.minimum(cosine, NEARLY_PARALLEL))
    first, second = np.sin((1 - u) * angle) / np.sin(angle), np.sin(u * angle) / np.sin(angle)
    near = cosine > NEARLY_PARALLEL
    return np.asarray(np.where(near, 1 - u, first) * a + np.where(near, u, second) * b)


def transform(translation: Array, rotation: Array, scale: Array) -> Array:
    """Matrices (n, 4, 4) that scale, then turn, then move; rotations (n, 4) of any length above 0."""
    length = np.linalg.norm(rotation, axis=1, keepdims=True)
    x, y, z, w = (rotation / np.where(length > 0, length, 1.0)).T
    turn = np.empty((max(len(translation), len(rotation), len(scale)), 4, 4))
    turn[:] = np.eye(4)
    turn[:, 0, 0], turn[:, 0, 1], turn[:, 0, 2] = 1 - 2 * (y * y + z * z), 2 * (x * y - z * w), 2 * (x * z + y * w)
    turn[:, 1, 0], turn[:, 1, 1], turn[:, 1, 2] = 2 * (x * y + z * w), 1 - 2 * (x * x + z * z), 2 * (y * z - x * w)
    turn[:, 2, 0], turn[:, 2, 1], turn[:, 2, 2] = 2 * (x * z - y * w), 2 * (y * z + x * w), 1 - 2 * (x * x + y * y)
    turn[:, :3, :3] *= scale[:, None, :]
    turn[:, :3, 3] = translation
    return turn


def meshes_at(doc: Document, nodes: Sequence[Placed], tracks: Tracks, times: Array) -> tuple[Array, Faces]:
    """All meshes at the times: positions (frames, n, 3), and faces with parts by nodes, then by materials."""
    parts: list[Array] = []
    faces, start = Faces(), 0
    for node in nodes:
        matrix = matrix_of(doc, node, tracks, times)
        mirrored = bool(np.linalg.det(matrix[0, :3, :3]) < 0)
        shared: dict[tuple[Any, ...], tuple[int, int]] = {}
        for primitive in doc.items(doc.item("meshes", doc.item("nodes", node.node)["mesh"]), "primitives"):
            doc.typed(primitive, dict, "an object", "primitives")
            key = _sources(doc, primitive)
            if key not in shared:
                shape = _shape(doc, node.node, key, tracks, times)
                check_room((start + shape.shape[1]) * len(times) * 3 * 8 * 2, doc.path)
                parts.append(shape @ np.swapaxes(matrix[:, :3, :3], 1, 2) + matrix[:, None, :3, 3])
                shared[key] = start, shape.shape[1]
                start += shape.shape[1]
            first, count = shared[key]
            triangles = _triangles(doc, primitive, count)
            own = np.arange(faces.count, faces.count + len(triangles))
            for rank, (kind, index) in enumerate((("nodes", node.node), ("materials", primitive.get("material")))):
                name = _named(doc, kind, index)
                faces.name(name, own, rank, key=name)
            faces.add(first + triangles, _texture(doc, primitive, count)[triangles], mirrored)
    if not start:
        raise InvalidMotion(f"{doc.name}: there is no mesh in it")
    whole = np.empty((len(times), start, 3))
    for first, part in zip(np.cumsum([0, *(part.shape[1] for part in parts)]), parts, strict=False):
        whole[:, first : first + part.shape[1]] = part
    return whole, faces


def _named(doc: Document, kind: str, index: Any) -> str:
    """The name of a part such as `materials[2]`; empty where it has none."""
    try:
        name = "" if index is None else doc.item(kind, index).get("name", "")
    except InvalidMotion:
        return ""
    return name if isinstance(name, str) else ""


def path_of(doc: Document, node: Placed) -> str:
    """The names of a node with a mesh and of those above it, and that of the mesh, with / between."""
    names = [_named(doc, "nodes", index) for index in (*node.above, node.node)]
    mesh = _named(doc, "meshes", doc.item("nodes", node.node)["mesh"])
    return "/".join(filter(None, [*names, mesh if mesh != names[-1] else ""])) or f"node {node.node}"


def pins(doc: Document, nodes: Sequence[Placed]) -> Pins:
    """The vertices, of all meshes one after another, that an attribute such as _PIN marks as held."""
    found = Pins()
    for node in nodes:
        shared: set[Any] = set()
        for primitive in doc.items(doc.item("meshes", doc.item("nodes", node.node)["mesh"]), "primitives"):
            if (key := _sources(doc, primitive)) in shared:
                continue
            shared.add(key)
            there = [(name, index) for name, index in primitive.get("attributes", {}).items() if is_pin(name)]
            numbers = [pair for pair in there if doc.item("accessors", pair[1]).get("type") == "SCALAR"]
            weights = ((name, doc.accessor(index, "SCALAR")) for name, index in numbers)
            found.add(len(doc.accessor(key[0], "VEC3")), weights)
    return found


def _texture(doc: Document, primitive: dict[str, Any], count: int) -> Array:
    """Texture coordinates (count, 2) of the vertices of a primitive, NaN where there are none that can be read."""
    index = primitive.get("attributes", {}).get("TEXCOORD_0")
    nothing = np.full((count, 2), np.nan)
    try:
        found = nothing if index is None else doc.accessor(index, "VEC2")
    except InvalidMotion:
        return nothing
    return found if found.shape == nothing.shape else nothing


def matrix_of(doc: Document, node: Placed, tracks: Tracks, times: Array) -> Array:
    """The matrix of a node at the times: (frames or 1, 4, 4)."""
    product = np.eye(4)[None]
    for index in (*node.above, node.node):
        described = doc.item("nodes", index)
        if "matrix" in described:
            product = product @ doc.numbers(described, "matrix", [0.0] * 16).reshape(4, 4).T
            continue
        steps = [
            tracks[index, what].at(times, what == "rotation")
            if (index, what) in tracks
            else doc.numbers(described, what, default)[None]
            for what, default in AT_REST.items()
        ]
        product = product @ transform(*steps)
    return product


def _sources(doc: Document, primitive: dict[str, Any]) -> tuple[Any, ...]:
    """The accessors of the positions of a primitive and of its targets; None where a target has none."""
    owners = [primitive.get("attributes", {}), *doc.items(primitive, "targets")]
    for owner in owners:
        doc.typed(owner, dict, "an object", "attributes")
    return tuple(doc.typed(owner.get("POSITION", -1), int, "an index", "POSITION") for owner in owners)


def _shape(doc: Document, node: int, sources: tuple[int, ...], tracks: Tracks, times: Array) -> Array:
    """Positions (frames, n, 3) in the axes of the node."""
    base = doc.accessor(sources[0], "VEC3")
    described = doc.item("nodes", node)
    count = len(sources) - 1
    if (node, "weights") in tracks:
        weights = tracks[node, "weights"].at(times)
    else:
        owner = described if "weights" in described else doc.item("meshes", described["mesh"])
        weights = doc.numbers(owner, "weights", [0.0] * count)[None]
    if weights.shape[1] != count:
        raise InvalidMotion(f"{doc.name}: {weights.shape[1]} weights do not match the {count} targets of a mesh")
    check_room((count + 2 * len(weights)) * base.nbytes, doc.path)
    targets = np.zeros((count, base.size))
    for k, source in enumerate(sources[1:]):
        if source >= 0:
            target = doc.accessor(source, "VEC3")
            if target.shape != base.shape:
                raise InvalidMotion(f"{doc.name}: a target has {len(target)} vertices, its mesh {len(base)}")
            targets[k] = target.reshape(-1)
    return base + (weights @ targets).reshape(len(weights), *base.shape)


def _triangles(doc: Document, primitive: dict[str, Any], count: int) -> Indices:
    """Triangles (T, 3) of a primitive of `count` vertices; points and lines have none."""
    if "indices" in primitive:
        corners = doc.accessor(primitive["indices"], "SCALAR")[:, 0].astype(np.int64)
    else:
        corners = np.arange(count)
    if len(corners) and not 0 <= corners.min() <= corners.max() < count:
        raise InvalidMotion(f"{doc.name}: a triangle names a vertex beyond the {count} of its mesh")
    i = np.arange(max(len(corners) - 2, 0))
    orders = {
        4: np.arange(len(corners) // 3 * 3).reshape(-1, 3),  # separate triangles
        5: np.stack([i, i + 1 + i % 2, i + 2 - i % 2], axis=1),  # a strip
        6: np.stack([i + 1, i + 2, 0 * i], axis=1),  # a fan
    }
    mode = doc.whole(primitive, "mode", 4)
    return corners[orders[mode]].astype(np.int32) if mode in orders else np.zeros((0, 3), np.int32)
