"""GLB files made by hand, byte by byte, from what the specification says."""

import json
import struct
from typing import Any

import numpy as np

from clothfit.formats.animation import Animation
from clothfit.formats.axes import RIGHT

COMPONENTS = {"int8": 5120, "uint8": 5121, "int16": 5122, "uint16": 5123, "uint32": 5125, "float32": 5126}
KINDS = {1: "SCALAR", 2: "VEC2", 3: "VEC3", 4: "VEC4"}

CORNERS = np.array([[0, 0, 0], [1, 0, 0], [0, 2, 0], [0, 0, 3]], np.float32)
FACES = np.array([[0, 1, 2], [0, 2, 3]], np.uint8)


def container(document: Any, binary: bytes = b"", **lies: Any) -> bytes:
    """A GLB file of a document, or of the text of one; `lies` are the version and the length that the header tells."""
    text = document if isinstance(document, bytes) else json.dumps(document).encode()
    text += b" " * (-len(text) % 4)
    chunks = struct.pack("<I4s", len(text), b"JSON") + text
    if binary:
        chunks += struct.pack("<I4s", len(binary), b"BIN\0") + binary
    return struct.pack("<4sII", b"glTF", lies.get("version", 2), lies.get("length", 12 + len(chunks))) + chunks


class Numbers:
    """Arrays on their way into a file."""

    def __init__(self) -> None:
        self.data, self.views, self.accessors = b"", [], []

    def view(self, data: bytes, **more: Any) -> int:
        """Append bytes; the index of their view."""
        self.views.append({"buffer": 0, "byteOffset": len(self.data), "byteLength": len(data), **more})
        self.data += data + bytes(-len(data) % 4)
        return len(self.views) - 1

    def add(self, values: Any, dtype: str = "float32", **more: Any) -> int:
        """Append an array (n,) or (n, width); the index of its accessor."""
        array = np.asarray(values, dtype)
        width = 1 if array.ndim == 1 else array.shape[1]
        described = {"componentType": COMPONENTS[dtype], "count": len(array), "type": KINDS[width]}
        self.accessors.append({"bufferView": self.view(array.tobytes()), **described, **more})
        return len(self.accessors) - 1


def parts(nodes: Any = None, **primitive: Any) -> tuple[dict[str, Any], Numbers]:
    """The document of two triangles on the nodes that are given, and its numbers."""
    numbers = Numbers()
    shape = {"attributes": {"POSITION": numbers.add(CORNERS)}, "indices": numbers.add(FACES.reshape(-1), "uint8")}
    return {
        "asset": {"version": "2.0"},
        "scenes": [{"nodes": [0]}],
        "nodes": nodes or [{"mesh": 0}],
        "meshes": [{"primitives": [{**shape, **primitive}]}],
        "accessors": numbers.accessors,
        "bufferViews": numbers.views,
    }, numbers


def whole(document: dict[str, Any], numbers: Numbers, **changed: Any) -> bytes:
    """The file of both."""
    return container({**document, "buffers": [{"byteLength": len(numbers.data)}], **changed}, numbers.data)


def moved(what: str, times: Any, values: Any, kind: str = "LINEAR", nodes: Any = None, targets: Any = ()) -> bytes:
    """Two triangles of which one thing is animated, with targets (n, 4, 3) if any."""
    document, numbers = parts(nodes)
    if len(targets):
        added = [{"POSITION": numbers.add(each)} for each in targets]
        document["meshes"][0]["primitives"][0]["targets"] = added
    sampler = {"input": numbers.add(times), "output": numbers.add(values), "interpolation": kind}
    channel = {"sampler": 0, "target": {"node": 0, "path": what}}
    return whole(document, numbers, animations=[{"samplers": [sampler], "channels": [channel]}])


def wave(frames: int = 40, rank: int = 3, count: int = 30) -> Animation:
    """Smooth shapes that move by as many independent functions of time, metres."""
    shapes = np.random.default_rng(0).normal(size=(rank, count, 3))
    times = np.arange(frames) / 50
    weights = np.stack([np.sin(3 * (k + 1) * times) for k in range(rank)], axis=1)
    base = np.random.default_rng(1).normal(size=(count, 3))
    triangles = np.array([[i, i + 1, i + 2] for i in range(count - 2)], np.int32)
    return Animation(base + np.einsum("fk,knc->fnc", weights, shapes), RIGHT, times, triangles)
