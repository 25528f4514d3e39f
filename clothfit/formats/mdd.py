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

HEADER = struct.Struct(">ii")
FLOATS = ">f4"


def read(path: str | os.PathLike[str]) -> Animation:
    """A point cache; without times where all of them are 0. Raises InvalidMotion."""
    with opened(path) as cache:
        data = cache.file.read(HEADER.size)
        if len(data) < HEADER.size:
            raise InvalidMotion(f"{cache.name}: ends within its header; is it complete?")
        frames, points = HEADER.unpack(data)
        cache.check(frames, points, HEADER.size, 4)
        times = cache.numbers(frames, FLOATS)
        if frames > 1 and not times.any():  # some programs leave them
            return Animation(cache.positions(frames, points, FLOATS), RIGHT)
        if not (np.isfinite(times).all() and (np.diff(times) > 0).all()):
            raise InvalidMotion(f"{cache.name}: its times are not finite and increasing")
        return Animation(cache.positions(frames, points, FLOATS), RIGHT, times)


def encoded(path: str | os.PathLike[str], animation: Animation) -> dict[str, Data]:
    """The file of a point cache; with times of 0 where there are none."""
    frames, points, _ = animation.positions.shape
    times = np.zeros(frames) if animation.times is None else animation.times
    header = HEADER.pack(frames, points) + times.astype(FLOATS).tobytes()
    return {os.fspath(path): partial(put, header=header, positions=animation.positions, dtype=FLOATS)}
