"""PC2 point caches: the vertices of a mesh at some frames. A file is little-endian.

    char[12] "POINTCACHE2\\0"   int32 version, 1   int32 points   float32 first frame   float32 frames per sample
    int32 samples               float32 positions (samples, points, 3)

Times are counted in frames of an unknown rate, so there are none here. Numbers are rounded to float32.
"""

from __future__ import annotations

import math
import os
import struct

from clothfit.base.errors import InvalidMotion
from clothfit.base.writing import Data
from clothfit.formats import point_cache
from clothfit.formats.animation import Animation
from clothfit.formats.axes import RIGHT

PC2_MAGIC = b"POINTCACHE2\0"
PC2_HEADER = struct.Struct("<iiffi")  # behind the magic bytes
PC2_FLOAT = "<f4"


def read(path: str | os.PathLike[str]) -> Animation:
    """A point cache. Raises InvalidMotion."""
    with point_cache.opened(path, PC2_FLOAT) as cache:
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


def encoded(path: str | os.PathLike[str], animation: Animation) -> dict[str, Data]:
    """The file of a point cache that begins at frame 0, one sample per frame."""
    samples, points, _ = animation.positions.shape
    header = PC2_MAGIC + PC2_HEADER.pack(1, points, 0.0, 1.0, samples)
    return point_cache.encoded(path, header, animation.positions, PC2_FLOAT)
