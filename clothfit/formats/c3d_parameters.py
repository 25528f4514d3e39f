"""The header and the parameters of a C3D file, which describe the numbers that follow.

The C3D file format: user guide, Motion Lab Systems 2008. The file consists of blocks of 512 bytes. The first byte is
the block of the parameters, the second is 0x50; the words after them hold counts and rates. Parameters are in groups,
one record after another, each with the distance to the next. Numbers have the form of the processor that the section
names: Intel, DEC (integers as Intel's, floats as on a VAX), or MIPS.
"""

from __future__ import annotations

import struct
from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from clothfit.base.errors import InvalidMotion

BLOCK_BYTES, KEY = 512, 0x50
INTEL, DEC, MIPS = 84, 85, 86

TEXT, BYTE, INTEGER, REAL = -1, 1, 2, 4  # types of parameters; their sizes in bytes

Values = list[str] | NDArray[Any]


class Parameters:
    """The header and the parameters in the bytes of a file. Raises InvalidMotion where they are damaged."""

    def __init__(self, data: bytes, name: str) -> None:
        self.data, self._name = data, name
        if len(data) < 2 or data[1] != KEY:
            raise InvalidMotion(f"{name}: it is not a C3D file, whose second byte is 0x50")
        start = (data[0] - 1) * BLOCK_BYTES
        self.insist(0 <= start <= len(data) - 4)
        self.processor = data[start + 3]
        if self.processor not in (INTEL, DEC, MIPS):
            raise InvalidMotion(f"{name}: {self.processor} is not a type of processor that C3D knows (84, 85, 86)")
        self.order = ">" if self.processor == MIPS else "<"
        self._found = self._read(start + 4)

    def insist(self, right: bool) -> None:
        """Raise InvalidMotion unless a condition on the file holds."""
        if not right:
            raise InvalidMotion(f"{self._name}: it is cut off or damaged; export it again")

    def word(self, number: int) -> int:
        """A 16-bit word of the header, counted from 1."""
        self.insist(2 * number <= len(self.data))
        found: int = struct.unpack_from(f"{self.order}H", self.data, 2 * (number - 1))[0]
        return found

    def real(self, number: int) -> float:
        """The float of the header that begins at a word."""
        self.insist(2 * number + 2 <= len(self.data))
        return float(self.reals(2 * (number - 1), 1)[0])

    def reals(self, start: int, count: int) -> NDArray[np.float32]:
        """`count` floats from a place of the file, in the form of its processor."""
        if self.processor != DEC:
            return np.frombuffer(self.data, f"{self.order}f4", count, start).astype(np.float32)
        halves = np.frombuffer(self.data, "<u2", 2 * count, start).reshape(-1, 2).astype(np.uint32)
        bits = (halves[:, 0] << 16) | halves[:, 1]  # the first half has the exponent, whose bias is larger by 2
        return np.where(bits & 0x7F800000, bits.view(np.float32) / 4, np.float32(0.0)).astype(np.float32)

    def texts(self, group: str, name: str) -> list[str]:
        """The strings of a parameter; none when it is missing."""
        found = self._found.get((group, name), [])
        return found if isinstance(found, list) else []

    def values(self, group: str, name: str) -> Sequence[float]:
        """The numbers of a parameter; none when it is missing."""
        found = self._found.get((group, name), [])
        return [] if isinstance(found, list) else found.tolist()

    def _read(self, place: int) -> dict[tuple[str, str], Values]:
        """All parameters, by the names of group and parameter in upper case."""
        groups: dict[int, str] = {}
        found: dict[tuple[int, str], Values] = {}
        data = self.data
        while place + 2 <= len(data) and data[place]:
            length, number = abs(struct.unpack_from("b", data, place)[0]), struct.unpack_from("b", data, place + 1)[0]
            after = place + 2 + length
            self.insist(after + 3 <= len(data))
            name = data[place + 2 : after].decode("latin-1").upper()
            distance: int = struct.unpack_from(f"{self.order}H", data, after)[0]
            if number < 0:
                groups[-number] = name
            else:
                found[number, name] = self._values(after + 2)
            if not distance:
                break
            place = after + distance
        return {(groups.get(number, ""), name): values for (number, name), values in found.items()}

    def _values(self, place: int) -> Values:
        """The value of the parameter whose type stands at a place."""
        data = self.data
        kind, count = struct.unpack_from("b", data, place)[0], data[place + 1] if place + 1 < len(data) else 0
        sizes = list(data[place + 2 : place + 2 + count])
        start, items = place + 2 + count, int(np.prod(sizes, dtype=object))
        self.insist(kind in (TEXT, BYTE, INTEGER, REAL) and start + items * abs(kind) <= len(data))
        if kind == TEXT:
            width = sizes[0] if sizes else 1
            texts = [data[start + i : start + i + width] for i in range(0, items, max(width, 1))]
            return [text.decode("utf-8", "replace").strip(" \0") for text in texts]
        if kind == REAL:
            return self.reals(start, items)
        return np.frombuffer(data, "u1" if kind == BYTE else f"{self.order}u2", items, start)
