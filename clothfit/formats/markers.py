"""What the formats of markers share: labels, units, text, cells that may be empty, and gaps."""

from __future__ import annotations

import codecs
import math
import os
from collections.abc import Sequence

import numpy as np

from clothfit.base.arrays import Array, Flags
from clothfit.base.errors import InvalidMotion
from clothfit.base.messages import shown
from clothfit.formats.animation import Animation
from clothfit.formats.axes import Axes
from clothfit.formats.files import check_room, content

METRES_PER_UNIT = {
    **dict.fromkeys(("m", "meter", "meters", "metre", "metres"), 1.0),
    **dict.fromkeys(("cm", "centimeter", "centimeters", "centimetre", "centimetres"), 0.01),
    **dict.fromkeys(("mm", "millimeter", "millimeters", "millimetre", "millimetres"), 0.001),
    **dict.fromkeys(("in", "inch", "inches"), 0.0254),
    **dict.fromkeys(("ft", "foot", "feet"), 0.3048),
}
"""m per unit, by its name in lower case."""

WRITTEN = {1.0: "m", 0.01: "cm", 0.001: "mm"}
"""Units that files are written in, by m per unit."""

EMPTY = ("", "nan", "na", "n/a", "null", "none", "-")
"""Cells of a table, in lower case, that stand for a gap."""

LONGEST_LABEL = 60
"""Characters of a label."""

TABLE_COPIES = 12
"""Memory that reading a table takes, as a multiple of its size: a cell may be one comma, a number is 8 bytes."""


def text_of(path: str | os.PathLike[str]) -> str:
    """A text file, in UTF-8, in UTF-16 where it begins so, or else as older programs write it, with line ends
    of any kind. Raises InvalidMotion.
    """
    data = content(path)
    check_room(TABLE_COPIES * len(data), path)
    text = _decoded(data)
    return text.replace("\r\n", "\n").replace("\r", "\n") if "\r" in text else text


def _decoded(data: bytes) -> str:
    if data.startswith((codecs.BOM_UTF16_LE, codecs.BOM_UTF16_BE)):
        return data.decode("utf-16", "replace")
    try:
        return data.decode("utf-8-sig")
    except UnicodeDecodeError:
        return data.decode("latin-1")


def label(text: str) -> str:
    """The name of a marker for messages and other files: one line of it, with nothing that a terminal acts upon."""
    plain = "".join(each if each.isprintable() else "?" for each in text.strip())
    return plain if len(plain) <= LONGEST_LABEL else f"{plain[: LONGEST_LABEL - 1]}…"


def labels_of(animation: Animation) -> list[str]:
    """The names of its points; `v0`, `v1`, … where it has none."""
    if animation.names is None:
        return [f"v{point}" for point in range(animation.positions.shape[1])]
    return [label(name) for name in animation.names]


def number(cell: str, place: str) -> float:
    """A cell of a table, NaN where it is empty. Raises InvalidMotion, naming the place."""
    try:
        value = float(cell)
        if math.isfinite(value) and "_" not in cell:  # which Python allows within numbers
            return value
    except ValueError:
        pass
    if cell.strip().lower() in EMPTY:
        return math.nan
    raise InvalidMotion(f"{place}: {shown(cell)} is not a number")


def seen_by(
    positions: Array, axes: Axes, times: Array | None, names: Sequence[str], notes: Sequence[str], name: str
) -> Animation:
    """An animation of markers from positions (frames, markers, 3), NaN in any coordinate of a gap. Raises
    InvalidMotion where there are none, or the times do not increase.
    """
    if not positions.size:
        raise InvalidMotion(f"{name}: there are no markers in it")
    if times is not None and not (np.isfinite(times).all() and (np.diff(times) > 0).all()):
        where = f"{name}: times"
        raise InvalidMotion(f"{where}: must be finite and increasing")
    observed: Flags = np.asarray(np.isfinite(positions).all(axis=2))
    positions[~observed] = np.nan
    gaps = not observed.all()
    return Animation(positions, axes, times, None, observed if gaps else None, tuple(map(label, names)), tuple(notes))


def unit_of(axes: Axes) -> tuple[str, float]:
    """The unit to write in, by its name, and what positions are multiplied by for it: metres where it has no name."""
    for scale, name in WRITTEN.items():
        if math.isclose(axes.scale, scale, rel_tol=1e-12):
            return name, 1.0
    return "m", axes.scale
