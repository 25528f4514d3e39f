"""C3D files made by hand for any processor, and tables of markers."""

import struct
from typing import Any

import numpy as np

from clothfit.formats.animation import Animation
from clothfit.formats.axes import RIGHT, Axes

INTEL, DEC, MIPS = 84, 85, 86


class Processor:
    """How numbers are laid down on a processor."""

    def __init__(self, number: int) -> None:
        self.number = number
        self.order = ">" if number == MIPS else "<"

    def words(self, values: Any) -> bytes:
        return np.asarray(values).astype(f"{self.order}u2").tobytes()

    def reals(self, values: Any) -> bytes:
        """IEEE floats; on a VAX four times the value, with the 16 bits of the exponent first."""
        array = np.asarray(values, np.float32).reshape(-1)
        if self.number != DEC:
            return array.astype(f"{self.order}f4").tobytes()
        halves = (4 * array).astype("<f4").view("<u2").reshape(-1, 2)
        return np.ascontiguousarray(halves[:, ::-1]).tobytes()


def parameter(processor: Processor, group: int, name: str, kind: int, sizes: list[int], data: bytes) -> bytes:
    """A record of the section of parameters."""
    rest = struct.pack("bB", kind, len(sizes)) + bytes(sizes) + data + b"\0"
    return struct.pack("bb", len(name), group) + name.encode() + processor.words([len(rest) + 2]) + rest


def group(processor: Processor, number: int, name: str) -> bytes:
    return struct.pack("bb", len(name), -number) + name.encode() + processor.words([3]) + b"\0"


def texts(processor: Processor, number: int, name: str, *values: str) -> bytes:
    width = max(map(len, values))
    data = "".join(value.ljust(width) for value in values).encode()
    return parameter(processor, number, name, -1, [width, len(values)], data)


def facts(processor: Processor, points: int, frames: int, scale: float) -> bytes:
    """What the header tells, as parameters."""
    whole = {"USED": points, "FRAMES": frames, "DATA_START": 3}
    records = [parameter(processor, 1, name, 2, [], processor.words([value])) for name, value in whole.items()]
    return b"".join(records) + parameter(processor, 1, "SCALE", 4, [], processor.reals([scale]))


def c3d(
    positions: Any,
    number: int = INTEL,
    scale: float = -1.0,
    analog: int = 0,
    rate: float = 100.0,
    more: Any = lambda processor: b"",
) -> bytes:
    """Positions (frames, points, 3), NaN for gaps; as integers where the scale is above 0. `more` gives parameters."""
    processor = Processor(number)
    table = np.asarray(positions, float)
    frames, points = table.shape[:2]
    hidden = np.isnan(table).any(axis=2)
    rows = np.zeros((frames, 4 * points + analog))
    rows[:, 4 * points :] = 7
    rows[:, : 4 * points] = np.dstack([np.nan_to_num(table / abs(scale)), -1.0 * hidden]).reshape(frames, -1)
    body = group(processor, 1, "POINT") + more(processor)
    section = bytes([1, 0x50, 1, number]) + body + b"\0\0"
    header = bytes([2, 0x50]) + processor.words([points, analog, 1, frames, 10]) + processor.reals([scale])
    header += processor.words([3, 1]) + processor.reals([rate])
    data = processor.reals(rows) if scale < 0 else processor.words(np.round(rows).astype(np.int16).view(np.uint16))
    return header.ljust(512, b"\0") + section.ljust(512, b"\0") + data


def motion(axes: Axes = RIGHT, frames: int = 7, points: int = 5, names: Any = None, gaps: bool = True) -> Animation:
    """Positions that are not round in any base, some of them gaps."""
    positions = np.random.default_rng(0).normal(size=(frames, points, 3))
    if gaps:
        positions[2, 3] = positions[-1, 0] = np.nan
    return Animation(positions, axes, np.arange(frames) / 90, None, None, names)


TWO = np.array([[[1, 2, 3], [4, 5, 6]], [[1.5, 2, 3], [np.nan, np.nan, np.nan]]])
"""Positions of two markers in two frames, with a gap."""


def check(found: Animation) -> None:
    """Whether it is what the files below say."""
    np.testing.assert_array_equal(found.positions, TWO)
    np.testing.assert_allclose(found.times, [0, 0.01], rtol=2e-16)
    np.testing.assert_array_equal(found.observed, [[True, True], [True, False]])
    assert found.names == ("hem", "cuff")


TRC = (
    "PathFileType\t4\t(X/Y/Z)\ta.trc\n"
    "DataRate\tCameraRate\tNumFrames\tNumMarkers\tUnits\tOrigDataRate\tOrigDataStartFrame\tOrigNumFrames\n"
    "100\t100\t2\t2\tmm\t100\t1\t2\n"
    "Frame#\tTime\them\t\t\tcuff\t\t\n"
    "\t\tX1\tY1\tZ1\tX2\tY2\tZ2\n"
    "\n"
    "1\t0.0\t1\t2\t3\t4\t5\t6\n"
    "2\t0.01\t1.5\t2\t3\n"
)

LONG = "time,marker,x,y,z\n0.01,hem,1.5,2,3\n0,hem,1,2,3\n0,cuff,4,5,6\n"

MOTIVE = (
    "Format Version,1.23,Take Name,x,Export Frame Rate,100.000,Length Units,Millimeters,Coordinate Space,Global\n"
    "\n"
    ",,Rigid Body,Rigid Body,Rigid Body,Rigid Body,Marker,Marker,Marker,Marker,Marker,Marker\n"
    ",,b,b,b,b,hem,hem,hem,cuff,cuff,cuff\n"
    ",,1,1,1,1,2,2,2,3,3,3\n"
    ",,Rotation,Rotation,Rotation,Rotation,Position,Position,Position,Position,Position,Position\n"
    "Frame,Time (Seconds),X,Y,Z,W,X,Y,Z,X,Y,Z\n"
    "0,0.0,9,9,9,9,1,2,3,4,5,6\n"
    "1,0.01,9,9,9,9,1.5,2,3,,,\n"
)
