"""Point caches, PC2 and MDD: the positions of all vertices of a mesh, frame by frame, as float32 behind a header.

    PC2, little-endian    char[12] "POINTCACHE2\\0"   int32 version, 1   int32 points   float32 first frame
                          float32 frames per sample   int32 samples     float32 positions (samples, points, 3)
    MDD, big-endian       int32 frames   int32 points   float32 times (frames,), s
                          float32 positions (frames, points, 3)

PC2 counts times in frames of an unknown rate, so there are none here. Caches have neither axes nor unit: they move the
vertices of a mesh in another file, mostly an OBJ, and use the axes of that file. A header can promise any size, so it
is compared with the size of the file before memory is taken.
"""

from __future__ import annotations

import math
import os
from struct import Struct
from typing import IO, Any

import numpy as np

from clothfit.base.arrays import Array
from clothfit.base.errors import InvalidMotion
from clothfit.base.reading import unchanged
from clothfit.base.writing import Data
from clothfit.formats.animation import Animation, increasing
from clothfit.formats.axes import RIGHT
from clothfit.formats.files import check_room, name_of, refused

PC2_MAGIC = b"POINTCACHE2\0"
PC2_HEADER, MDD_HEADER = Struct("<iiffi"), Struct(">ii")  # behind the magic bytes
PC2_FLOAT, MDD_FLOAT = "<f4", ">f4"


def read(path: str | os.PathLike[str]) -> Animation:
    """A point cache, of the kind that its suffix says. Raises InvalidMotion."""
    with refused(path), unchanged(path) as file:
        return _read_mdd(_Cache(file, path, MDD_FLOAT)) if _is_mdd(path) else _read_pc2(_Cache(file, path, PC2_FLOAT))


def encoded(path: str | os.PathLike[str], animation: Animation) -> dict[str, Data]:
    """The file: PC2 from frame 0 on, one sample per frame; MDD with times of 0 where there are none."""
    frames, points, _ = animation.positions.shape
    if _is_mdd(path):
        times = np.zeros(frames) if animation.times is None else animation.times
        header, dtype = MDD_HEADER.pack(frames, points) + times.astype(MDD_FLOAT).tobytes(), MDD_FLOAT
    else:
        header, dtype = PC2_MAGIC + PC2_HEADER.pack(1, points, 0.0, 1.0, frames), PC2_FLOAT

    def write(file: IO[bytes]) -> None:
        file.write(header)
        for each in animation.positions:
            file.write(each.astype(dtype).tobytes())

    return {os.fspath(path): write}


def _is_mdd(path: str | os.PathLike[str]) -> bool:
    return os.fspath(path).lower().endswith(".mdd")


class _Cache:
    """An open point cache, whose numbers have the type `dtype`."""

    def __init__(self, file: IO[bytes], path: str | os.PathLike[str], dtype: str) -> None:
        self.file, self.path, self.name, self.dtype = file, path, name_of(path), dtype
        self.size = file.seek(0, os.SEEK_END)  # bytes
        file.seek(0)

    def header(self, layout: Struct) -> tuple[Any, ...]:
        """The fields of the header. Raises InvalidMotion where the file is shorter."""
        data = self.file.read(layout.size)
        if len(data) < layout.size:
            raise InvalidMotion(f"{self.name}: ends within its header; is it complete?")
        return layout.unpack(data)

    def check(self, frames: int, points: int, each: int = 0) -> None:
        """Raise InvalidMotion unless the file is as long as its header says, with `each` bytes per frame besides the
        positions.
        """
        count = f"{frames} frames of {points} points"
        if frames < 1 or points < 1:
            raise InvalidMotion(f"{self.name}: its header has {count}; at least one of each is needed")
        needed = self.file.tell() + frames * (12 * points + each)
        if self.size != needed:
            raise InvalidMotion(f"{self.name}: {count} take {needed} bytes, it has {self.size}; is it complete?")
        check_room(24 * frames * points, self.path)

    def numbers(self, count: int) -> Array:
        """The next numbers, as float64."""
        with np.errstate(invalid="ignore"):  # some NaN signal
            return np.fromfile(self.file, self.dtype, count).astype(np.float64)

    def positions(self, frames: int, points: int) -> Array:
        """The positions (frames, points, 3) that follow. Raises InvalidMotion where one is infinite."""
        positions = np.empty((frames, points, 3))
        for frame, room in enumerate(positions):  # one by one: no second array as large as `positions`
            room.reshape(-1)[:] = self.numbers(3 * points)
            if np.isinf(room).any():
                point = int(np.argmax(np.isinf(room).any(axis=1)))
                raise InvalidMotion(f"{self.name}: frame {frame}, point {point}: its position is infinite")
        return positions


def _read_pc2(cache: _Cache) -> Animation:
    if cache.file.read(len(PC2_MAGIC)) != PC2_MAGIC:
        raise InvalidMotion(f"{cache.name}: does not begin as a PC2 point cache does (POINTCACHE2)")
    version, points, _, spacing, samples = cache.header(PC2_HEADER)
    if version != 1:
        raise InvalidMotion(f"{cache.name}: is of version {version} of PC2, 1 can be read")
    cache.check(samples, points)
    positions = cache.positions(samples, points)
    if math.isfinite(spacing) and spacing > 0 and spacing != 1:
        return Animation(positions, RIGHT, notes=(f"its samples are {spacing:g} frames apart",), spacing=spacing)
    return Animation(positions, RIGHT)


def _read_mdd(cache: _Cache) -> Animation:
    frames, points = cache.header(MDD_HEADER)
    cache.check(frames, points, 4)
    times = cache.numbers(frames)
    known = frames == 1 or times.any()  # some programs leave them 0
    if known and not increasing(times):
        raise InvalidMotion(f"{cache.name}: its times are not finite and increasing")
    return Animation(cache.positions(frames, points), RIGHT, times if known else None)
