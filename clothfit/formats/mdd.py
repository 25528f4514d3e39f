"""MDD point caches: the vertices of a mesh at some times. A file is big-endian.

    int32 frames   int32 points   float32 times (frames,), s   float32 positions (frames, points, 3)

Numbers are rounded to float32.
"""

from __future__ import annotations

import os
import struct

import numpy as np

from clothfit.base.errors import InvalidMotion
from clothfit.base.writing import Data
from clothfit.formats import point_cache
from clothfit.formats.animation import Animation, increasing
from clothfit.formats.axes import RIGHT

MDD_HEADER = struct.Struct(">ii")
MDD_FLOAT = ">f4"


def read(path: str | os.PathLike[str]) -> Animation:
    """A point cache; it has no times where all of them are 0. Raises InvalidMotion."""
    with point_cache.opened(path, MDD_FLOAT) as cache:
        frames, points = cache.header(MDD_HEADER)
        cache.check(frames, points, 4)
        times = cache.numbers(frames)
        known = frames == 1 or times.any()  # some programs leave them 0
        if known and not increasing(times):
            raise InvalidMotion(f"{cache.name}: its times are not finite and increasing")
        return Animation(cache.positions(frames, points), RIGHT, times if known else None)


def encoded(path: str | os.PathLike[str], animation: Animation) -> dict[str, Data]:
    """The file of a point cache; its times are 0 where there are none."""
    frames, points, _ = animation.positions.shape
    times = np.zeros(frames) if animation.times is None else animation.times
    header = MDD_HEADER.pack(frames, points) + times.astype(MDD_FLOAT).tobytes()
    return point_cache.encoded(path, header, animation.positions, MDD_FLOAT)
