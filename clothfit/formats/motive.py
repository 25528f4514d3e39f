"""Markers in the CSV files that OptiTrack's Motive exports.

The first line has facts, name and value in turn, among them the unit and the rate. The lines above the table give each
column's kind (`Marker`, `Rigid Body`, …), its name, its identity, and whether it is a position or a rotation; then come
Frame, Time (Seconds), X, Y, Z, …. y is up and the axes are right-handed. Only markers are read.
"""

from __future__ import annotations

import csv
import io

from clothfit.base.errors import InvalidMotion
from clothfit.formats.animation import Animation
from clothfit.formats.axes import Axes
from clothfit.formats.markers import marker_animation, number, number_table, scale_of

FIRST_CELL = "Format Version"

OURS = ("marker", "unlabeled marker")
"""The kinds of columns to read."""


def parsed(text: str, name: str) -> Animation:
    """The markers of a text. Raises InvalidMotion, with the line."""
    reader = csv.reader(io.StringIO(text))
    try:
        facts = next(reader)
        above: list[list[str]] = []
        for cells in reader:
            if cells and cells[0].strip().lower() == "frame":
                break
            if any(cells):
                above.append([each.strip() for each in cells])
        triples = _triples(above)
        wanted = [1, *(first + axis for first in triples.values() for axis in range(3))]
        rows = (
            [number(cells[i] if i < len(cells) else "", f"{name}: line {reader.line_num}") for i in wanted]
            for cells in reader
            if any(cells)
        )
        table = number_table(rows, len(wanted))
    except csv.Error as error:
        raise InvalidMotion(f"{name}: it is not a table of cells ({error})") from None
    notes: list[str] = []
    unit = dict(zip(facts[::2], facts[1::2], strict=False)).get("Length Units", "")
    axes = Axes("y", "right", scale_of(unit, notes, "m"))
    positions = table[:, 1:].reshape(len(table), len(triples), 3)
    return marker_animation(positions, axes, table[:, 0], list(triples), notes, name)


def _triples(above: list[list[str]]) -> dict[str, int]:
    """The first column of each marker's position, by its name, from the lines above the table."""
    if len(above) < 3:
        return {}
    kinds, names, what = above[0], above[1], above[-1]
    found: dict[str, int] = {}
    for i in range(2, min(map(len, (kinds, names, what)))):
        if kinds[i].lower() in OURS and what[i].lower() == "position":
            found.setdefault(names[i], i)
    return found
