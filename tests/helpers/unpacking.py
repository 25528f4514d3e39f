"""What the page of a report does to unpack its data, in Python."""

import base64
import json
import re
import zlib
from typing import Any

import numpy as np
from numpy.typing import NDArray

from clothfit.base.arrays import Array
from clothfit.report.packing import Record


def content_of(html: bytes) -> dict[str, Any]:
    """What a page tells, from its text."""
    (text,) = re.findall(r'<script type="application/json" id="content">(.*?)</script>', html.decode())
    found: dict[str, Any] = json.loads(text)
    return found


def inflated(text: str) -> bytes:
    """The bytes in a deflated text."""
    return zlib.decompress(base64.b64decode(text))


def unpacked(record: Record) -> NDArray[Any]:
    """The array of a record, as the page unpacks it."""
    return np.frombuffer(inflated(record["data"]), record["type"]).reshape(record["shape"])


def unpacked_positions(record: Record) -> Array:
    """The positions of a record, m, as the page unpacks them."""
    planes = np.frombuffer(inflated(record["data"]), np.uint8).reshape(2, *record["shape"]).astype(np.uint16)
    folded = planes[0] | planes[1] << 8
    grid = (folded >> 1) ^ -(folded & 1)
    for _ in range(2):
        grid = np.cumsum(grid, axis=0, dtype=np.uint16)
    positions: Array = np.asarray(record["low"]) + np.asarray(record["step"]) * grid
    return positions
