"""What point caches have in common: a header, and the positions of all points in all frames as float32.

They know neither axes nor unit: they move the vertices of a mesh that is kept in another file, mostly an OBJ, and are
taken to be in the axes of that. A header can promise any size: it is compared with the size of the file before memory
is taken.
"""

from __future__ import annotations

import os
from collections.abc import Iterator
from contextlib import contextmanager
from typing import IO

import numpy as np

from clothfit.base.arrays import Array
from clothfit.base.errors import InvalidMotion
from clothfit.base.reading import unchanged
from clothfit.formats.files import POSITION_COPIES, check_room, name_of, refused


class Cache:
    """An open point cache."""

    def __init__(self, file: IO[bytes], path: str | os.PathLike[str]) -> None:
        self.file, self.path, self.name = file, path, name_of(path)
        self.size = file.seek(0, os.SEEK_END)  # bytes
        file.seek(0)

    def check(self, frames: int, points: int, start: int, each: int) -> None:
        """Raise InvalidMotion unless the file has so many bytes as it says: `start` before its frames, `each` in a
        frame besides the positions.
        """
        if frames < 1 or points < 1:
            count = f"{frames} frames of {points} points"
            raise InvalidMotion(f"{self.name}: its header tells of {count}, at least one of each is needed")
        needed = start + frames * (12 * points + each)
        if self.size != needed:
            size = f"take {needed} bytes, it has {self.size}"
            raise InvalidMotion(f"{self.name}: {frames} frames of {points} points {size}; is it complete?")
        check_room(POSITION_COPIES * 24 * frames * points, self.path)

    def numbers(self, count: int, dtype: str) -> Array:
        """The next numbers, as float64."""
        return np.fromfile(self.file, dtype, count).astype(np.float64)

    def positions(self, frames: int, points: int, dtype: str) -> Array:
        """The positions (frames, points, 3) that follow. Raises InvalidMotion where one is not finite."""
        positions = np.empty((frames, points, 3))
        for frame, room in enumerate(positions):  # one by one: no second array as large as `positions`
            room.reshape(-1)[:] = np.fromfile(self.file, dtype, 3 * points)
            if not np.isfinite(room).all():
                point = int(np.argmin(np.isfinite(room).all(axis=1)))
                raise InvalidMotion(f"{self.name}: frame {frame}, point {point}: its position is not finite")
        return positions


@contextmanager
def opened(path: str | os.PathLike[str]) -> Iterator[Cache]:
    """A cache to read in the block. Raises InvalidMotion on whatever goes wrong with the file."""
    with refused(path), unchanged(path) as file:
        yield Cache(file, path)


def put(file: IO[bytes], header: bytes, positions: Array, dtype: str) -> None:
    """Write a header and all positions."""
    file.write(header)
    for points in positions:
        file.write(points.astype(dtype).tobytes())
