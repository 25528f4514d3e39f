"""MDD point caches: the vertices of a mesh at some times. A file is big-endian.

    int32 frames   int32 points   float32 times (frames,), s   float32 positions (frames, points, 3)

Numbers are rounded to float32.
"""

from __future__ import annotations

import os
import struct
from functools import partial

import numpy as np

from clothfit.base.errors import InvalidMotion
from clothfit.base.writing import Data
from clothfit.formats.animation import Animation
from clothfit.formats.axes import RIGHT
from clothfit.formats.point_cache import opened, put

MDD_HEADER = struct.Struct(">ii")
MDD_FLOAT = ">f4"


def read(path: str | os.PathLike[str]) -> Animation:
    """A point cache; without times where all of them are 0. Raises InvalidMotion."""
    with opened(path) as cache:
        data = cache.file.read(MDD_HEADER.size)
        if len(data) < MDD_HEADER.size:
            raise InvalidMotion(f"{cache.name}: ends within its header; is it complete?")
        frames, points = MDD_HEADER.unpack(data)
        cache.check(frames, points, MDD_HEADER.size, 4)
        times = cache.numbers(frames, MDD_FLOAT)
        if frames > 1 and not times.any():  # some programs leave them
            return Animation(cache.positions(frames, points, MDD_FLOAT), RIGHT)
        if not (np.isfinite(times).all() and (np.diff(times) > 0).all()):
            raise InvalidMotion(f"{cache.name}: its times are not finite and increasing")
        return Animation(cache.positions(frames, points, MDD_FLOAT), RIGHT, times)


def encoded(path: str | os.PathLike[str], animation: Animation) -> dict[str, Data]:
    """The file of a point cache; with times of 0 where there are none."""
    frames, points, _ = animation.positions.shape
    times = np.zeros(frames) if animation.times is None else animation.times
    header = MDD_HEADER.pack(frames, points) + times.astype(MDD_FLOAT).tobytes()
    return {os.fspath(path): partial(put, header=header, positions=animation.positions, dtype=MDD_FLOAT)}
