"""A table of text, as in CSV files: cells between commas, semicolons or tabs, and axes and unit in comments."""

from __future__ import annotations

import csv
import io
import re
from collections.abc import Iterator, Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from clothfit.base.arrays import Array
from clothfit.base.errors import InvalidMotion
from clothfit.base.messages import shown
from clothfit.formats.animation import Animation
from clothfit.formats.axes import HANDS, UPS, Axes
from clothfit.formats.files import check_room
from clothfit.formats.markers import METRES_PER_UNIT, marker_animation, number

UNIT_NAMES = ("m", "cm", "mm", "in", "ft")
"""The units that messages list."""

LEAP = 10_000
"""More frames missing in a row than this are a slip of the pen, and would fill the memory with gaps."""

COMMENT = re.compile(r"#\s*(unit|up|handedness|rate)s?\s*[:=]\s*(\S+)\s*", re.IGNORECASE)


class Table(NamedTuple):
    """A table whose line of names has been read."""

    name: str  # of the file
    header: list[str]
    rows: Iterator[tuple[int, list[str]]]  # line number, and at least as many cells as names
    decimal_comma: bool
    comments: dict[str, str]  # unit, up, handedness and rate, as far as given

    def number(self, cell: str, line: int) -> float:
        """A cell as a number, NaN for a gap. Raises InvalidMotion."""
        text = cell.replace(",", ".") if self.decimal_comma else cell
        return number(text, f"{self.name}: line {line}")

    def column(self, names: Sequence[str]) -> int | None:
        """The first column with one of the names (in lower case), whatever its unit; None when there is none."""
        plain = [re.sub(r"[(\[].*", "", each).strip().lower() for each in self.header]
        return next((i for i, each in enumerate(plain) if each in names), None)


def table_of(text: str, name: str) -> Table:
    """Find the line of names and the separator of cells. Raises InvalidMotion, also while the rows are read."""
    stream, comments, before, line = io.StringIO(text), {}, 0, ""
    for line in stream:
        before += 1
        if match := COMMENT.fullmatch(line.strip()):
            comments[match[1].lower()] = match[2].lower()
        if line.strip() and not line.startswith("#"):
            break
    separator = next((each for each in "\t;" if each in line), ",")
    try:
        header = [each.strip() for each in next(csv.reader([line], delimiter=separator), [])]
    except csv.Error as error:
        raise InvalidMotion(f"{name}: it is not a table of cells ({error})") from None
    while header and not header[-1]:
        header.pop()
    return Table(name, header, _rows(stream, separator, before, len(header), name), separator != ",", comments)


def _rows(stream: io.StringIO, separator: str, before: int, width: int, name: str) -> Iterator[tuple[int, list[str]]]:
    reader = csv.reader(stream, delimiter=separator)
    try:
        for cells in reader:
            if not any(cells) or cells[0].startswith("#"):
                continue
            line = before + reader.line_num
            if len(cells) > width and any(cells[width:]):
                raise InvalidMotion(f"{name}: line {line}: it has {len(cells)} cells, {width} are named")
            yield line, cells + [""] * (width - len(cells))
    except csv.Error as error:
        raise InvalidMotion(f"{name}: it is not a table of cells ({error})") from None


def animation_of(
    table: Table,
    times: Array | None,
    frames: Array | None,
    positions: Array,
    names: Sequence[str],
    unit: str | None = None,
) -> Animation:
    """The animation of a table: positions (rows, markers, 3) at times, s, or at frame numbers, or one after the other;
    `unit` is the one in the names of its columns. Raises InvalidMotion.
    """
    notes: list[str] = []
    if times is None and frames is not None:
        positions = _in_place(table, frames, positions)
    if times is None and "rate" in table.comments:
        rate = number(table.comments["rate"], f"{table.name}: rate")
        if not rate > 0:
            where = f"{table.name}: rate"
            raise InvalidMotion(f"{where} must be above 0 and finite; {rate:g} was given")
        times = np.arange(len(positions)) / rate
    return marker_animation(positions, _axes(table, unit, notes), times, names, notes, table.name)


def _in_place(table: Table, frames: Array, positions: Array) -> Array:
    """The rows at the places of their frame numbers; missing frames are gaps."""
    steps = np.diff(frames)
    if not (np.isfinite(frames).all() and (frames == np.round(frames)).all() and ((steps > 0) & (steps < LEAP)).all()):
        raise InvalidMotion(f"{table.name}: frame numbers must be whole and increasing, by less than {LEAP}")
    if not len(frames):
        return positions
    count = frames[-1] - frames[0] + 1
    check_room(int(count) * positions[0].nbytes, table.name)
    placed = np.full((int(count), *positions.shape[1:]), np.nan)
    index: NDArray[np.int64] = (frames - frames[0]).astype(np.int64)
    placed[index] = positions
    return placed


def _axes(table: Table, unit: str | None, notes: list[str]) -> Axes:
    """Axes and unit from the comments, or the unit from the names of the columns; else metres, y up, right-handed."""
    given = ({} if unit is None else {"unit": unit}) | table.comments
    choices = {"unit": ("m", UNIT_NAMES), "up": ("y", UPS), "handedness": ("right", HANDS)}
    missing = ", ".join(f"{key} {default}" for key, (default, _) in choices.items() if key not in given)
    if missing:
        notes.append(f"it does not say, so these are assumed: {missing}")
    for key, (default, known) in choices.items():
        if given.get(key, default) not in (*known, *(METRES_PER_UNIT if key == "unit" else ())):
            where = f"{table.name}: {key}"
            raise InvalidMotion(f"{where}: {shown(given[key])} is not one of {', '.join(known)}")
    return Axes(given.get("up", "y"), given.get("handedness", "right"), METRES_PER_UNIT[given.get("unit", "m")])
