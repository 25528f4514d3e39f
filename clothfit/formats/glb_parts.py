"""What glTF files are written from: numbers, with the views and accessors that describe them; and GLB around both."""

from __future__ import annotations

import json
import os
import struct
from typing import Any

import numpy as np
from numpy.typing import NDArray

from clothfit.base.errors import InvalidMotion
from clothfit.base.memory import human
from clothfit.formats.files import name_of
from clothfit.formats.gltf import BIN_CHUNK, GLB_MAGIC, JSON_CHUNK

MOST_GLB_BYTES = 2**32 - 1
"""Bytes of a GLB file, whose length has 32 bits."""

FLOAT, UINT = 5126, 5125  # types of components


class Parts:
    """The numbers for the second chunk, with the views and accessors that describe them."""

    def __init__(self) -> None:
        self.pieces: list[bytes] = []
        self.views: list[dict[str, Any]] = []
        self.accessors: list[dict[str, Any]] = []
        self._length = 0  # a multiple of 4, as all numbers have 4 bytes

    def add(self, values: NDArray[Any], kind: str, bounds: bool = False, **view: int) -> int:
        """Append an array; returns the index of its accessor."""
        data = values.tobytes()
        self.views.append({"buffer": 0, "byteOffset": self._length, "byteLength": len(data), **view})
        self.pieces.append(data)
        self._length += len(data)
        described: dict[str, Any] = {
            "bufferView": len(self.views) - 1,
            "componentType": FLOAT if values.dtype == np.float32 else UINT,
            "count": values.size if kind == "SCALAR" else len(values),
            "type": kind,
        }
        if bounds:
            table = values.reshape(described["count"], -1)
            described |= {"min": table.min(axis=0).tolist(), "max": table.max(axis=0).tolist()}
        self.accessors.append(described)
        return len(self.accessors) - 1


def glb(document: dict[str, Any], parts: Parts, path: str | os.PathLike[str]) -> bytes:
    """A GLB file; the document gets its buffer. Raises InvalidMotion where it gets too long."""
    numbers = b"".join(parts.pieces)
    document["buffers"] = [{"byteLength": len(numbers)}]
    text = json.dumps(document, separators=(",", ":")).encode()
    text += b" " * (-len(text) % 4)
    length = 12 + 8 + len(text) + 8 + len(numbers)
    if length > MOST_GLB_BYTES:
        raise InvalidMotion(f"{name_of(path)}: {human(length)} are more than a GLB file can have; keep fewer frames")
    header = struct.pack("<4sII", GLB_MAGIC, 2, length)
    chunks = struct.pack("<I4s", len(text), JSON_CHUNK), text, struct.pack("<I4s", len(numbers), BIN_CHUNK), numbers
    return b"".join([header, *chunks])
