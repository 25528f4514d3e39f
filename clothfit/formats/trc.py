"""Markers in TRC files, the text format of Motion Analysis and OpenSim.

Tabs separate the cells, or, as some programs write it, commas. The lines are: the file's type, the names of its facts
(rate, unit, counts), the facts, the markers' names, X1 Y1 Z1 …, mostly an empty one, and then one for each frame: its
number, its time in s, and the coordinates, which are empty where a marker was not seen. y is up and the axes are
right-handed, as in OpenSim; the unit is among the facts. Numbers are written in full. Of a file that ends early, as one
whose recording was cut, the frames that are there are read, with a note; a last line without its end is none.
"""

from __future__ import annotations

import io
import os

import numpy as np

from clothfit.base.errors import InvalidMotion
from clothfit.base.writing import Data
from clothfit.formats.animation import Animation, rate_of, times_of, with_gaps
from clothfit.formats.axes import Axes
from clothfit.formats.files import name_of
from clothfit.formats.markers import (
    ends_early,
    labels_of,
    marker_animation,
    number,
    number_table,
    scale_of,
    text_of,
    unit_of,
)

FILE_TYPE = "PathFileType"
FACTS = ("DataRate", "CameraRate", "NumFrames", "NumMarkers", "Units", "OrigDataRate", "OrigDataStartFrame",
         "OrigNumFrames")  # fmt: skip


def read(path: str | os.PathLike[str]) -> Animation:
    """The markers of a file, NaN where they were not seen. Raises InvalidMotion, with the line."""
    name, text = name_of(path), text_of(path)
    lines = io.StringIO(text)
    first = next(lines, "")
    separator = "," if first.strip().startswith(f"{FILE_TYPE},") else "\t"
    head = [line.rstrip("\r\n").split(separator) for line in [first, *(next(lines, "") for _ in range(4))]]
    if not head[0][0].strip().startswith(FILE_TYPE) or len(head[3]) < 3:
        raise InvalidMotion(f"{name}: it is not a TRC file, which begins with {FILE_TYPE} and has the names in line 4")
    facts = {key.strip().lower(): value.strip() for key, value in zip(head[1], head[2], strict=False)}
    names = [each.strip() for each in head[3][2:] if each.strip()]
    width = 2 + 3 * len(names)
    split = ((f"{name}: line {i}", line.rstrip("\r\n").split(separator)) for i, line in enumerate(lines, 6))
    rows = (_row(cells, place, width) for place, cells in split if any(map(str.strip, cells)))
    table = number_table(rows, width - 1)
    promised, notes = number(facts.get("numframes", ""), f"{name}: line 3"), list[str]()
    if len(table) < promised:  # never true for NaN, where the file promises nothing
        table = table if text.endswith("\n") else table[:-1]  # its last number may be cut as well
        notes.append(ends_early(promised, len(table)))
    frames = len(table)
    axes = Axes("y", "right", scale_of(facts.get("units", ""), notes))
    return marker_animation(table[:, 1:].reshape(frames, len(names), 3), axes, table[:, 0], names, notes, name)


def _row(cells: list[str], place: str, width: int) -> list[float]:
    """The numbers of a line but the first, NaN for missing cells. Raises InvalidMotion where there are too many."""
    while len(cells) > width and not cells[-1].strip():
        cells.pop()
    if len(cells) > width:
        raise InvalidMotion(f"{place}: it has {len(cells)} cells, {width} are named")
    row = [number(cell, place) for cell in cells[1:]]
    return row + [np.nan] * (width - 1 - len(row))


def encoded(path: str | os.PathLike[str], animation: Animation) -> dict[str, Data]:
    """The file. Each frame has its time; the rate is the mean where it is not even."""
    unit, factor = unit_of(animation.axes)
    positions, times, names = factor * with_gaps(animation), times_of(animation), labels_of(animation)
    frames = len(positions)
    rate = rate_of(animation) or (frames - 1) / float(times[-1] - times[0])
    facts = (repr(rate), repr(rate), frames, len(names), unit, repr(rate), 1, frames)
    lines = [
        f"{FILE_TYPE}\t4\t(X/Y/Z)\t{name_of(path)}",
        "\t".join(FACTS),
        "\t".join(map(str, facts)),
        "\t".join(["Frame#", "Time", *(cell for each in names for cell in (each, "", ""))]),
        "\t".join(["", "", *(f"{axis}{i}" for i in range(1, len(names) + 1) for axis in "XYZ")]),
        "",
    ]
    for frame, (time, row) in enumerate(zip(times.tolist(), positions.reshape(frames, -1).tolist(), strict=True), 1):
        lines.append("\t".join([str(frame), repr(time), *("" if each != each else repr(each) for each in row)]))
    return {os.fspath(path): ("\n".join(lines) + "\n").encode()}
