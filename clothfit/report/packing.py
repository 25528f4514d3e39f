"""Arrays as text for a page: small, and quick to read in a browser.

An array is deflated (zlib) and written in base64, in a record with its type and shape, which `web/unpack.js` reads.

Positions of a motion are whole numbers of 16 bits on a grid in their box: q = round((x − low) / step), where the box
has 65,535 steps along each axis. So each coordinate is within half a step of the true one. Along time only the change
of the change is kept, which is near 0 where a motion is smooth, as (d << 1) ^ (d >> 15), so that small numbers of both
signs have a high byte of 0; low and high bytes stand apart. All of it is exact: the grid is the only loss.
"""

from __future__ import annotations

import base64
import zlib
from typing import Any, TypeAlias

import numpy as np
from numpy.typing import NDArray

from clothfit.base.arrays import Array, Flags

Record: TypeAlias = dict[str, Any]

GRID_STEPS = 2**16 - 1
"""Steps of the grid along each axis."""

ERROR_GRADES = 2**8 - 1
"""Largest grade of an error: its square root is kept in 8 bits, so that small errors differ as well."""

BROWSERS = {"f": "float32", "u": "uint32", "i": "int32", "b": "uint8"}
"""The types of records, by NumPy's kinds of type."""


def deflated(data: bytes) -> str:
    """Bytes, deflated and in base64."""
    return base64.b64encode(zlib.compress(data, 6)).decode()


def packed(array: NDArray[Any]) -> Record:
    """The record of an array: numbers in 32 bits, flags in 8."""
    kind = BROWSERS[array.dtype.kind]
    data = array.astype(np.dtype(kind).newbyteorder("<")).tobytes()
    return {"type": kind, "shape": list(array.shape), "data": deflated(data)}


def box(*motions: Array) -> tuple[Array, Array]:
    """The lowest corner (3,) of motions (frames, vertices, 3), m, and the steps (3,) of a grid over them."""
    points = [motion.reshape(-1, 3) for motion in motions]
    low = np.nanmin([np.nanmin(each, axis=0) for each in points], axis=0)
    high = np.nanmax([np.nanmax(each, axis=0) for each in points], axis=0)
    return low, np.maximum((high - low) / GRID_STEPS, np.finfo(np.float32).tiny)


def packed_positions(positions: Array, low: Array, step: Array) -> Record:
    """The record of positions (frames, vertices, 3), m, within the box; NaN is replaced by the position before."""
    grid = np.zeros(positions.shape, np.uint16)
    held = np.zeros(positions.shape[1:], np.uint16)
    for frame, x in enumerate(positions):
        seen = ~np.isnan(x)
        held[seen] = np.rint(((x - low) / step)[seen])
        grid[frame] = held
    change = grid.copy()
    for _ in range(2):  # overflows of 16 bits cancel when the changes are summed
        change[1:] = np.diff(change, axis=0)
    signed = change.view(np.int16)
    folded = ((signed << 1) ^ (signed >> 15)).view(np.uint16)
    planes = np.concatenate([(folded & 255).astype(np.uint8).ravel(), (folded >> 8).astype(np.uint8).ravel()])
    data = deflated(planes.tobytes())
    return {"shape": list(positions.shape), "low": low.tolist(), "step": step.tolist(), "data": data}


def packed_errors(errors: Array) -> Record:
    """The record of errors (frames, vertices), m; NaN becomes 0."""
    most = float(np.nanmax(errors, initial=0.0))
    share = np.nan_to_num(errors / most) if most > 0 else np.zeros(errors.shape)
    grades = np.rint(ERROR_GRADES * np.sqrt(share)).astype(np.uint8)
    return {"shape": list(errors.shape), "most": most, "data": deflated(grades.tobytes())}


def packed_flags(flags: Flags) -> Record:
    """The record of flags of any shape, 8 in a byte, the first in the lowest bit."""
    return {"shape": list(flags.shape), "data": deflated(np.packbits(flags, bitorder="little").tobytes())}


def packed_gaps(seen: Flags) -> Record | None:
    """The record of what was seen; None where all was."""
    return None if seen.all() else packed_flags(seen)
