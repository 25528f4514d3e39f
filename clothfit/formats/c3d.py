"""Markers in C3D files, as motion-capture systems write them.

Each frame has four numbers for each point, either integers or float32: its position, and a residual, below 0 where the
point was not seen; the analog samples after them are skipped. The file names its rate, its unit (default: millimetres),
the labels of the points, and the axis that is up on the screen (default: z); it is right-handed. Points that it lists
as angles, forces and the like are not positions, and are left out. Files are written with float32.

The C3D file format: user guide, Motion Lab Systems 2008. The file consists of blocks of 512 bytes. The first byte is
the block of the parameters, the second is 0x50; the words after them hold counts and rates. Parameters are in groups,
one record after another, each with the distance to the next. Numbers have the form of the processor that the section
names: Intel, DEC (integers as Intel's, floats as on a VAX), or MIPS.
"""

from __future__ import annotations

import os
import struct
from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from clothfit.base.arrays import Array
from clothfit.base.errors import InvalidMotion
from clothfit.base.writing import Data
from clothfit.formats.animation import Animation, rated, with_gaps
from clothfit.formats.axes import UPS, Axes
from clothfit.formats.files import check_room, content, name_of
from clothfit.formats.markers import ends_early, label, labels_of, marker_animation, scale_of, unit_of

BLOCK_BYTES, KEY = 512, 0x50
INTEL, DEC, MIPS = 84, 85, 86

TEXT, BYTE, INTEGER, REAL = -1, 1, 2, 4  # types of parameters; their sizes in bytes

Values = list[str] | NDArray[Any]

LARGEST_WORD = 65535
"""The largest 16-bit number: of points, and of frames unless the group TRIAL counts them."""

OTHERS = ("ANGLES", "FORCES", "MOMENTS", "POWERS", "SCALARS", "REACTIONS")
"""Parameters of the group POINT that list the labels of points that are not positions."""


def read(path: str | os.PathLike[str]) -> Animation:
    """The markers of a file, NaN where they were not seen. Raises InvalidMotion."""
    name = name_of(path)
    found = Parameters(content(path), name)
    notes: list[str] = []
    with np.errstate(all="ignore"):  # what is not a finite number is a gap
        positions = _positions(found, path, notes)
    count, labels = positions.shape[1], list[str]()
    for more in ("", *map(str, range(2, 2 + count // 255))):  # those beyond 255 are in LABELS2, LABELS3 and so on
        labels += [label(each) for each in found.texts("POINT", f"LABELS{more}")]
    names = [labels[i] if i < len(labels) and labels[i] else f"marker {i + 1}" for i in range(count)]
    others = {label(each) for kind in OTHERS for each in found.texts("POINT", kind)}
    kept = [i for i, each in enumerate(names) if each not in others]
    if len(kept) < len(names):
        notes.append(f"{len(names) - len(kept)} of its points are angles, forces or the like and are left out")
    rate = found.value("RATE", found.real(11))
    times = np.arange(len(positions)) / rate if 0 < rate < np.inf else None
    up = found.text("Y_SCREEN").lower().removeprefix("+")
    if up not in UPS:
        notes.append("it does not say which axis is up, so it is z")
        up = "z"
    axes = Axes(up, "right", scale_of(found.text("UNITS"), notes))
    return marker_animation(positions[:, kept], axes, times, [names[i] for i in kept], notes, name)


def _positions(found: Parameters, path: str | os.PathLike[str], notes: list[str]) -> Array:
    """Positions (frames, points, 3), NaN where a point was not seen: of the frames that are whole, with a note where
    these are fewer than the file promises.
    """
    points, scale = int(found.value("USED", found.word(2))), found.value("SCALE", found.real(7))
    width = REAL if scale < 0 else INTEGER  # bytes of a number
    row = 4 * points + found.word(3)
    start = (found.word(9) - 1) * BLOCK_BYTES
    there = max(len(found.data) - start, 0) // (width * row) if row and start > 0 else 0
    frames = _frames(found, there)
    if frames > there:
        notes.append(ends_early(frames, there))
        frames = there
    if not points or frames < 1 or start <= 0:
        raise InvalidMotion(f"{name_of(path)}: there are no markers in it")
    check_room(frames * row * 8 * 4, path)
    numbers = (found.reals if scale < 0 else found.integers)(start, frames * row).astype(np.float64)
    table = numbers.reshape(frames, row)[:, : 4 * points].reshape(frames, points, 4)
    return np.where(table[..., 3:] < 0, np.nan, table[..., :3] * (1.0 if scale < 0 else scale))


def _frames(found: Parameters, there: int) -> int:
    """How many frames the file promises; beyond 65535 only the group TRIAL can, else all that are `there` count."""
    limits = [found.values("TRIAL", f"ACTUAL_{end}_FIELD") for end in ("START", "END")]
    if all(len(each) == 2 for each in limits):
        first, last = (int(low) + 65536 * int(high) for low, high in limits)
        return last - first + 1
    count = found.word(5) - found.word(4) + 1
    return there if found.word(5) == LARGEST_WORD and there > count else count


def encoded(path: str | os.PathLike[str], animation: Animation) -> dict[str, Data]:
    """The file: float32 as on Intel's processors. Raises InvalidMotion where the rate is not even, or there are more
    points than the format can number.
    """
    unit, factor = unit_of(animation.axes)
    positions = with_gaps(animation) * factor
    rate = rated(path, animation)
    if not rate <= float(np.finfo(np.float32).max):
        raise InvalidMotion(f"{name_of(path)}: {rate:g} frames a second do not fit into single precision; use .trc")
    frames, points = positions.shape[:2]
    table = np.zeros((frames, points, 4), "<f4")
    known = np.isfinite(positions).all(axis=2)
    table[known, :3] = positions[known]
    table[~known, 3] = -1
    data_start = 2 + len(_parameters(animation, rate, unit, 0)) // BLOCK_BYTES  # to know how long they are
    parameters = _parameters(animation, rate, unit, data_start)
    if points > LARGEST_WORD or len(parameters) > 255 * BLOCK_BYTES:
        raise InvalidMotion(f"{name_of(path)}: {points} points are more than C3D can name; write another format")
    last = min(frames, LARGEST_WORD)
    header = struct.pack("<BBHHHHHfHHf", 2, KEY, points, 0, 1, last, 0, -1.0, data_start, 0, rate)
    return {os.fspath(path): header.ljust(BLOCK_BYTES, b"\0") + parameters + _padded(table.tobytes())}


def _parameters(animation: Animation, rate: float, unit: str, data_start: int) -> bytes:
    """The section of parameters, in whole blocks."""
    frames, points = animation.positions.shape[:2]
    names, labels = labels_of(animation), dict[str, list[str]]()
    for first in range(0, max(points, 1), 255):
        more, own = "" if first == 0 else str(first // 255 + 1), names[first : first + 255]
        labels |= {f"LABELS{more}": own, f"DESCRIPTIONS{more}": [""] * len(own)}
    groups: dict[str, dict[str, Any]] = {
        "POINT": {
            "USED": points, "SCALE": -1.0, "RATE": rate, "DATA_START": data_start, "FRAMES": min(frames, LARGEST_WORD),
            "UNITS": unit, "X_SCREEN": "+X", "Y_SCREEN": f"+{animation.axes.up.upper()}", **labels,
        },
        "ANALOG": {"USED": 0, "RATE": rate, "GEN_SCALE": 1.0},
        "TRIAL": {"ACTUAL_START_FIELD": (1, 0), "ACTUAL_END_FIELD": (frames % 65536, frames // 65536)},
    }  # fmt: skip
    body = b""
    for number, (group, parameters) in enumerate(groups.items(), 1):
        body += struct.pack("bb", len(group), -number) + group.encode() + struct.pack("<HB", 3, 0)
        for name, value in parameters.items():
            rest = _value(value) + b"\0"  # the distance to the next one counts from the place of that distance
            body += struct.pack("bb", len(name), number) + name.encode() + struct.pack("<H", len(rest) + 2) + rest
    body += b"\0\0"
    blocks = -(-(len(body) + 4) // BLOCK_BYTES)
    return _padded(bytes([1, KEY, min(blocks, 255), INTEL]) + body)


def _value(value: float | str | tuple[int, ...] | list[str]) -> bytes:
    """The type, sizes and value of a parameter; strings of a list have one width and are filled with spaces."""
    if isinstance(value, float):
        return struct.pack("<bBf", REAL, 0, value)
    if isinstance(value, int):
        return struct.pack("<bBH", INTEGER, 0, value)
    if isinstance(value, tuple):
        return struct.pack(f"<bBB{len(value)}H", INTEGER, 1, len(value), *value)
    coded = [text.encode()[:127] for text in (value if isinstance(value, list) else [value])]
    width = max(1, *map(len, coded)) if coded else 1
    sizes = [width, len(coded)] if isinstance(value, list) else [width]
    return struct.pack("bB", TEXT, len(sizes)) + bytes(sizes) + b"".join(each.ljust(width) for each in coded)


def _padded(data: bytes) -> bytes:
    return data + bytes(-len(data) % BLOCK_BYTES)


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
        return int(struct.unpack_from(f"{self.order}H", self.data, 2 * (number - 1))[0])

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

    def integers(self, start: int, count: int) -> NDArray[np.int16]:
        """`count` integers of 16 bits from a place of the file."""
        return np.frombuffer(self.data, f"{self.order}i2", count, start)

    def texts(self, group: str, name: str) -> list[str]:
        """The strings of a parameter; none when it is missing."""
        found = self._found.get((group, name), [])
        return found if isinstance(found, list) else []

    def values(self, group: str, name: str) -> Sequence[float]:
        """The numbers of a parameter; none when it is missing."""
        found = self._found.get((group, name), [])
        return [] if isinstance(found, list) else found.tolist()

    def text(self, name: str) -> str:
        """The first string of a parameter of the group POINT; empty when it is missing."""
        return next(iter(self.texts("POINT", name)), "")

    def value(self, name: str, default: float) -> float:
        """The first number of a parameter of the group POINT."""
        return next(iter(self.values("POINT", name)), default)

    def _read(self, place: int) -> dict[tuple[str, str], Values]:
        """All parameters, by the names of group and parameter in upper case."""
        groups: dict[int, str] = {}
        found: dict[tuple[int, str], Values] = {}
        data = self.data
        while place + 2 <= len(data) and data[place]:
            length, number = struct.unpack_from("bb", data, place)
            after = place + 2 + abs(length)
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
