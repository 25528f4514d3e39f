"""What the formats of markers share: labels, units, text, empty cells, and gaps."""

from __future__ import annotations

import codecs
import math
import os
from array import array
from collections.abc import Iterable, Sequence

import numpy as np

from clothfit.base.arrays import Array, Flags
from clothfit.base.errors import InvalidMotion
from clothfit.base.messages import shown
from clothfit.base.reading import MOST_TEXT
from clothfit.formats.animation import Animation, check_times
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
"""The units for writing, by m per unit."""

EMPTY = ("", "nan", "na", "n/a", "null", "none", "-")
"""Cells of a table, in lower case, that mean a gap."""

LONGEST_LABEL = 60
"""Characters of a label."""

TABLE_COPIES = 12
"""Memory that reading a table takes, as a multiple of its size: a cell may be one comma, a number has 8 bytes."""


def text_of(path: str | os.PathLike[str], most: int = MOST_TEXT) -> str:
    """The text of a file of at most `most` bytes, in UTF-8, in UTF-16 with a byte order mark, or else in Latin-1; line
    ends become newlines. Raises InvalidMotion.
    """
    data = content(path, most)
    check_room(TABLE_COPIES * len(data), path)
    if data.startswith((codecs.BOM_UTF16_LE, codecs.BOM_UTF16_BE)):
        text = data.decode("utf-16", "replace")
    else:
        try:
            text = data.decode("utf-8-sig")
        except UnicodeDecodeError:
            text = data.decode("latin-1")
    return text.replace("\r\n", "\n").replace("\r", "\n") if "\r" in text else text


def label(text: str) -> str:
    """The name of a marker for messages and other files: one line, with ? for what a terminal would act upon."""
    plain = "".join(each if each.isprintable() else "?" for each in text.strip())
    return plain if len(plain) <= LONGEST_LABEL else f"{plain[: LONGEST_LABEL - 1]}…"


def labels_of(animation: Animation) -> list[str]:
    """The names of the points; `v0`, `v1`, … where there are none."""
    if animation.names is None:
        return [f"v{point}" for point in range(animation.positions.shape[1])]
    return [label(name) for name in animation.names]


def number(cell: str, place: str) -> float:
    """A cell of a table, NaN where it is empty. Raises InvalidMotion, naming the place."""
    try:
        value = float(cell)
        if math.isfinite(value) and "_" not in cell:  # Python allows it within numbers
            return value
    except ValueError:
        pass
    if cell.strip().lower() in EMPTY:
        return math.nan
    raise InvalidMotion(f"{place}: {shown(cell)} is not a number")


def number_table(rows: Iterable[Iterable[float]], width: int) -> Array:
    """Numbers that come row by row as a table (rows, width), in little more memory than they take."""
    values = array("d")
    for row in rows:
        values.extend(row)
    return np.frombuffer(values, np.float64).reshape(-1, width).copy()


def marker_animation(
    positions: Array, axes: Axes, times: Array | None, names: Sequence[str], notes: Sequence[str], name: str
) -> Animation:
    """An animation from positions (frames, markers, 3), where any NaN makes a gap. Raises InvalidMotion where there are
    no positions, or the times do not increase.
    """
    if not positions.size:
        raise InvalidMotion(f"{name}: there are no markers in it")
    if times is not None:
        check_times(times, name)
    observed: Flags = np.asarray(np.isfinite(positions).all(axis=2))
    positions[~observed] = np.nan
    seen = None if observed.all() else observed
    return Animation(positions, axes, times, None, seen, tuple(map(label, names)), tuple(notes))


def ends_early(promised: float, there: int) -> str:
    """The note on a file that has fewer frames than it says."""
    return f"it ends early: {promised:.0f} frames are promised, {there} are there"


def scale_of(unit: str, notes: list[str], default: str = "mm") -> float:
    """m per unit, by the name that a file gives; where that is missing or unknown, `default` and a note on it."""
    if unit.lower() in METRES_PER_UNIT:
        return METRES_PER_UNIT[unit.lower()]
    strange = f"its unit is {shown(unit)}, taken for {default}"
    notes.append(strange if unit else f"it does not name its unit, so it is {default}")
    return METRES_PER_UNIT[default]


def named(axes: Axes) -> Axes:
    """The axes that a file of markers gets: in metres where their unit has no name, as these files name theirs."""
    return axes._replace(scale=axes.scale / unit_of(axes)[1])


def unit_of(axes: Axes) -> tuple[str, float]:
    """The name of the unit to write in, and the factor for positions: metres for a unit without a name."""
    for scale, name in WRITTEN.items():
        if math.isclose(axes.scale, scale, rel_tol=1e-12):
            return name, 1.0
    return "m", axes.scale
