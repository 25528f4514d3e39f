"""What point caches have in common: a header, and the positions of all points in all frames as float32.

They have neither axes nor unit: they move the vertices of a mesh in another file, mostly an OBJ, and use the axes of
that file. A header can promise any size, so it is compared with the size of the file before memory is taken.
"""

from __future__ import annotations

import os
from collections.abc import Iterator
from contextlib import contextmanager
from struct import Struct
from typing import IO, Any

import numpy as np

from clothfit.base.arrays import Array
from clothfit.base.errors import InvalidMotion
from clothfit.base.reading import unchanged
from clothfit.base.writing import Data
from clothfit.formats.files import POSITION_COPIES, check_room, name_of, refused


class Cache:
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
        check_room(POSITION_COPIES * 24 * frames * points, self.path)

    def numbers(self, count: int) -> Array:
        """The next numbers, as float64."""
        return np.fromfile(self.file, self.dtype, count).astype(np.float64)

    def positions(self, frames: int, points: int) -> Array:
        """The positions (frames, points, 3) that follow. Raises InvalidMotion where one is not finite."""
        positions = np.empty((frames, points, 3))
        for frame, room in enumerate(positions):  # one by one: no second array as large as `positions`
            room.reshape(-1)[:] = self.numbers(3 * points)
            if not np.isfinite(room).all():
                point = int(np.argmin(np.isfinite(room).all(axis=1)))
                raise InvalidMotion(f"{self.name}: frame {frame}, point {point}: its position is not finite")
        return positions


@contextmanager
def opened(path: str | os.PathLike[str], dtype: str) -> Iterator[Cache]:
    """Open a cache to read it in the block. Raises InvalidMotion on whatever goes wrong with the file."""
    with refused(path), unchanged(path) as file:
        yield Cache(file, path, dtype)


def encoded(path: str | os.PathLike[str], header: bytes, positions: Array, dtype: str) -> dict[str, Data]:
    """The file of a header and all positions."""

    def write(file: IO[bytes]) -> None:
        file.write(header)
        for points in positions:
            file.write(points.astype(dtype).tobytes())

    return {os.fspath(path): write}
