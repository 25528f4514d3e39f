"""The trajectories in the CSV files that Vicon Nexus exports ("Export ASCII").

Such a file has sections with blank lines between them: Devices, Joints, Model Outputs, Trajectories. Each has a line
with its title, the rate, the names (each over the first of its columns, as subject:marker), the kinds of columns
(Frame, Sub Frame, X, Y, Z, …), their units, and then a line for each frame. Only Trajectories are read, and of them
positions only: X', mm/s, is a velocity. Nexus has z up and right-handed axes, unless a laboratory has set others.
"""

from __future__ import annotations

import csv
import io
import re
from collections.abc import Iterator

import numpy as np

from clothfit.base.arrays import Array
from clothfit.base.errors import InvalidMotion
from clothfit.base.messages import shown
from clothfit.formats.animation import Animation
from clothfit.formats.axes import Axes
from clothfit.formats.markers import EMPTY, marker_animation, number, number_table, scale_of

TITLE = re.compile(r'^"?(Trajectories|Devices|Joints|Segments|Model Outputs)"?[,;\t ]*\n', re.MULTILINE)
"""The title of a section, alone in its line."""

WANTED = "Trajectories"


def is_vicon(text: str) -> bool:
    """Whether a text begins with a section of Nexus."""
    return TITLE.match(text) is not None


def animation(text: str, name: str) -> Animation:
    """The markers of the trajectories in a text. Raises InvalidMotion, with the line."""
    titles = list(TITLE.finditer(text))
    begin = next((each.start() for each in titles if each[1] == WANTED), None)
    if begin is None:
        there = ", ".join(dict.fromkeys(each[1] for each in titles))
        raise InvalidMotion(f"{name}: it has no {WANTED}, only {there}; export the trajectories from Nexus")
    above, stream = text.count("\n", 0, begin), io.StringIO(text[begin:])
    next(stream)
    rate_line, names, kinds, units = (next(stream, "").rstrip("\n") for _ in range(4))
    separator = next((each for each in "\t;" if each in kinds), ",")
    rate = number(_cells(rate_line, separator)[0], f"{name}: line {above + 2}")
    if not rate > 0:
        raise InvalidMotion(f"{name}: line {above + 2}: the rate must be above 0; {rate:g} was given")
    columns = _triples(_cells(names, separator), _cells(kinds, separator))
    wanted = [0, *(first + axis for first in columns.values() for axis in range(3))]
    table = number_table(_rows(stream, separator, wanted, name, above + 5), len(wanted))
    notes: list[str] = []
    unit = _cells(units, separator)
    first = next(iter(columns.values()), 0)
    axes = Axes("z", "right", scale_of(unit[first] if first < len(unit) else "", notes))
    positions = table[:, 1:].reshape(len(table), len(columns), 3)
    return marker_animation(positions, axes, _times(table[:, 0], rate), list(columns), notes, name)


def _times(frames: Array, rate: float) -> Array:
    """Times, s, of frame numbers, which begin at any."""
    return (frames - frames[0]) / rate if len(frames) else frames


def _cells(line: str, separator: str) -> list[str]:
    return [each.strip() for each in next(csv.reader([line], delimiter=separator), [])] or [""]


def _triples(names: list[str], kinds: list[str]) -> dict[str, int]:
    """The first column of each marker's position, by its name."""
    found: dict[str, int] = {}
    label = ""
    for i in range(2, len(kinds) - 2):
        label = names[i] if i < len(names) and names[i] else label
        if [each.upper() for each in kinds[i : i + 3]] == ["X", "Y", "Z"]:
            found.setdefault(label or f"column {i + 1}", i)
    return found


def _rows(stream: io.StringIO, separator: str, wanted: list[int], name: str, above: int) -> Iterator[list[float]]:
    """The wanted numbers of each line up to the end of the section. Raises InvalidMotion."""
    reader = csv.reader(stream, delimiter=separator)
    try:
        for cells in reader:
            if not any(cells):
                return
            place = f"{name}: line {above + reader.line_num}"
            row = [_value(cells[i], separator, place) if i < len(cells) else np.nan for i in wanted]
            if row[0] != row[0]:
                raise InvalidMotion(f"{place}: {shown(cells[0])} is no frame number")
            yield row
    except csv.Error as error:
        raise InvalidMotion(f"{name}: it is not a table of cells ({error})") from None


def _value(cell: str, separator: str, place: str) -> float:
    if cell.strip().lower() in EMPTY:
        return np.nan
    return number(cell if separator == "," else cell.replace(",", "."), place)
