"""Markers in text files: CSV tables with a line of names, wide or long, and those that Motive and Nexus export; TRC.

    wide    time,hem_x,hem_y,hem_z,…      a line for each frame
    long    time,marker,x,y,z             a line for each marker and frame, in any order

A column `frame` may replace `time`; with both, the time counts. Names of coordinates end in x, y, z, after `_`, `.`,
`:`, `-`, a space or nothing, and may have the unit in brackets. Commas, semicolons or tabs separate the cells, as in
the line of names; where they are not commas, a comma in a number is the decimal one. Lines that begin with # are
comments; `# unit: mm`, `# up: z`, `# handedness: left` and `# rate: 100` replace the defaults metres, y, right, and an
unknown rate. An empty cell, or NaN, is a gap. Numbers are written in full.

In the files that OptiTrack's Motive exports the first line has facts, name and value in turn, among them the unit and
the rate. The lines above the table give each column's kind (`Marker`, `Rigid Body`, …), its name, its identity, and
whether it is a position or a rotation; then come Frame, Time (Seconds), X, Y, Z, …. y is up and the axes are
right-handed. Only markers are read.

In those of Vicon Nexus ("Export ASCII") there are sections with blank lines between them: Devices, Joints, Model
Outputs, Trajectories. Each has a line with its title, the rate, the names (each over the first of its columns, as
subject:marker), the kinds of columns (Frame, Sub Frame, X, Y, Z, …), their units, and then a line for each frame. Only
Trajectories are read, and of them positions only: X', mm/s, is a velocity. Nexus has z up and right-handed axes, unless
a laboratory has set others.

In TRC files, the text format of Motion Analysis and OpenSim, tabs separate the cells, or, as some programs write it,
commas. The lines are: the file's type, the names of its facts (rate, unit, counts), the facts, the markers' names,
X1 Y1 Z1 …, mostly an empty one, and then one for each frame: its number, its time in s, and the coordinates, which are
empty where a marker was not seen. y is up and the axes are right-handed, as in OpenSim; the unit is among the facts.
Numbers are written in full. Of a file that ends early, as one whose recording was cut, the frames that are there are
read, with a note; a last line without its end is none.

What all formats of markers share, C3D as well, is here too: labels, units, text, empty cells, and gaps.
"""

from __future__ import annotations

import codecs
import csv
import io
import math
import os
import re
from array import array
from collections.abc import Iterable, Iterator, Sequence
from typing import NamedTuple, TypeAlias

import numpy as np
from numpy.typing import NDArray

from clothfit.base.arrays import Array, Flags
from clothfit.base.errors import InvalidMotion
from clothfit.base.messages import spelt
from clothfit.base.reading import MOST_TEXT
from clothfit.base.writing import Data
from clothfit.formats.animation import Animation, check_times, rate_of, times_of, unused, with_gaps
from clothfit.formats.axes import HANDS, RIGHT, UPS, Axes
from clothfit.formats.files import check_room, content, name_of

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

MOTIVE_FIRST_CELL = "Format Version"
MARKER_KINDS = ("marker", "unlabeled marker")
"""The kinds of columns to read."""

TIME_COLUMNS = ("time", "t", "times", "seconds", "time_s", "timestamp")
FRAME_COLUMNS = ("frame", "frames", "frame#", "frame number", "frame_number")
MARKER_COLUMNS = ("marker", "name", "label", "point", "id")

TITLE = re.compile(r'^"?(Trajectories|Devices|Joints|Segments|Model Outputs)"?[,;\t ]*\n', re.MULTILINE)
"""The title of a section of Nexus, alone in its line."""

WANTED = "Trajectories"

TRC = "PathFileType"
TRC_FACTS = ("DataRate", "CameraRate", "NumFrames", "NumMarkers", "Units", "OrigDataRate", "OrigDataStartFrame",
             "OrigNumFrames")  # fmt: skip
"""How a TRC file begins, and the names of its facts."""

Lines: TypeAlias = Iterator[tuple[int, list[str]]]
"""Number and cells of each line."""

COORDINATE = re.compile(r"(.*?)[\s_.:\-]?([xyzXYZ])\s*(?:[(\[]\s*([A-Za-z]+)\s*[)\]])?")
"""The name of a column: marker, axis, and the unit in brackets."""


def read(path: str | os.PathLike[str]) -> Animation:
    """The markers of a file, NaN where they were not seen. Raises InvalidMotion, with the line."""
    name, text = name_of(path), text_of(path)
    if _is_trc(path):
        return _trc(text, name)
    if text.startswith(MOTIVE_FIRST_CELL):
        return _motive(text, name)
    if TITLE.match(text) is not None:
        return _vicon(text, name)
    table = table_of(text, name)
    marker, coordinates = table.column(MARKER_COLUMNS), [table.column((axis,)) for axis in "xyz"]
    time, frame = table.column(TIME_COLUMNS), table.column(FRAME_COLUMNS)
    if marker is None or None in coordinates:
        return _wide(table, time, frame)
    key = frame if time is None else time
    if key is None:
        raise InvalidMotion(f"{name}: a table with a line for each marker needs a column time or frame")
    return _long(table, key, time is not None, marker, [i for i in coordinates if i is not None])


def _wide(table: Table, time: int | None, frame: int | None) -> Animation:
    """A table with a line for each frame."""
    columns, unit = _columns(table, (time, frame))
    leading = [i for i in (time, frame) if i is not None]
    order = leading + [axes[axis] for axes in columns.values() for axis in "xyz"]
    rows = ((table.number(cells[i], line) for i in order) for line, cells in table.rows)
    numbers = number_table(rows, len(order))
    positions = numbers[:, len(leading) :].reshape(len(numbers), len(columns), 3)
    times, frames = (None if i is None else numbers[:, leading.index(i)] for i in (time, frame))
    return animation_of(table, times, frames, positions, list(columns), unit)


def _columns(table: Table, others: tuple[int | None, ...]) -> tuple[dict[str, dict[str, int]], str | None]:
    """The columns of each marker by its axes, and the unit that the first of them names."""
    columns: dict[str, dict[str, int]] = {}
    unit = None
    for i, each in enumerate(table.header):
        match = COORDINATE.fullmatch(each)
        if i in others or not each:
            continue
        if match is not None and match[2].lower() in columns.get(match[1], {}):
            raise InvalidMotion(f"{table.name}: column {i + 1}, {spelt(each)}, is there twice")
        if match is None:
            raise InvalidMotion(
                f"{table.name}: column {i + 1}, {spelt(each)}, is not time, frame or a coordinate such as hem_x"
            )
        columns.setdefault(match[1], {})[match[2].lower()] = i
        if (match[3] or "").lower() in METRES_PER_UNIT:
            unit = unit or match[3].lower()
    if not columns:
        raise InvalidMotion(f"{table.name}: its first line names no markers, as in time,hem_x,hem_y,hem_z")
    for marker, axes in columns.items():
        if len(axes) < 3:
            raise InvalidMotion(f"{table.name}: the marker {spelt(marker)} needs columns for x, y and z")
    return columns, unit


def _long(table: Table, key: int, timed: bool, marker: int, coordinates: list[int]) -> Animation:
    """A table with a line for each marker and frame."""
    keys, which, values, names = array("d"), array("q"), array("d"), dict[str, int]()
    lines = array("q")
    for line, cells in table.rows:
        keys.append(table.number(cells[key], line))
        which.append(names.setdefault(cells[marker].strip(), len(names)))
        values.extend(table.number(cells[i], line) for i in coordinates)
        lines.append(line)
    frames, row = np.unique(np.frombuffer(keys, np.float64), return_inverse=True)
    check_room(len(frames) * len(names) * 3 * 8 * 2, table.name)
    places = row * len(names) + np.frombuffer(which, np.int64)
    order = np.argsort(places, kind="stable")
    again = np.flatnonzero(np.diff(places[order]) == 0)
    if len(again):
        line, label = lines[int(order[again[0] + 1])], list(names)[which[int(order[again[0] + 1])]]
        raise InvalidMotion(f"{table.name}: line {line}: {spelt(label)} is there twice in one frame; keep one")
    positions = np.full((len(frames), len(names), 3), np.nan)
    positions.reshape(-1, 3)[places] = np.frombuffer(values, np.float64).reshape(-1, 3)
    return animation_of(table, frames if timed else None, None if timed else frames, positions, list(names))


def encoded(path: str | os.PathLike[str], animation: Animation) -> dict[str, Data]:
    """The file: TRC, or a wide table with comments before it on what is not metres, y up and right-handed. Each frame
    has its time; the rate in a TRC file is the mean where it is not even.
    """
    unit, factor = unit_of(animation.axes)
    positions, times, names = factor * with_gaps(animation), times_of(animation), labels_of(animation)
    rows = zip(times.tolist(), positions.reshape(len(positions), -1).tolist(), strict=True)
    cells = ([repr(time), *("" if each != each else repr(each) for each in row)] for time, row in rows)
    if _is_trc(path):
        frames, rate = len(positions), rate_of(animation) or (len(positions) - 1) / float(times[-1] - times[0])
        facts = (repr(rate), repr(rate), frames, len(names), unit, repr(rate), 1, frames)
        head = [
            [TRC, "4", "(X/Y/Z)", name_of(path)],
            TRC_FACTS,
            map(str, facts),
            ["Frame#", "Time", *(cell for each in names for cell in (each, "", ""))],
            ["", "", *(f"{axis}{i}" for i in range(1, len(names) + 1) for axis in "XYZ")],
            [],
        ]
        lines = [*head, *([str(frame), *row] for frame, row in enumerate(cells, 1))]
        return {os.fspath(path): "".join("\t".join(line) + "\n" for line in lines).encode()}
    text = io.StringIO()
    own = {"unit": unit, "up": animation.axes.up, "handedness": animation.axes.handedness}
    usual = {"unit": "m", "up": RIGHT.up, "handedness": RIGHT.handedness}
    text.writelines(f"# {key}: {value}\n" for key, value in own.items() if value != usual[key])
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow(["time", *(f"{each}_{axis}" for each in names for axis in "xyz")])
    writer.writerows(cells)
    return {os.fspath(path): text.getvalue().encode()}


def _is_trc(path: str | os.PathLike[str]) -> bool:
    return os.fspath(path).lower().endswith(".trc")


def _trc(text: str, name: str) -> Animation:
    """The markers of a TRC file. Raises InvalidMotion, with the line."""
    lines = io.StringIO(text)
    first = next(lines, "")
    separator = "," if first.strip().startswith(f"{TRC},") else "\t"
    head = [line.rstrip("\r\n").split(separator) for line in [first, *(next(lines, "") for _ in range(4))]]
    if not head[0][0].strip().startswith(TRC) or len(head[3]) < 3:
        raise InvalidMotion(f"{name}: it is not a TRC file, which begins with {TRC} and has the names in line 4")
    facts = {key.strip().lower(): value.strip() for key, value in zip(head[1], head[2], strict=False)}
    names = [each.strip() for each in head[3][2:] if each.strip()]
    width = 2 + 3 * len(names)
    split = ((f"{name}: line {i}", line.rstrip("\r\n").split(separator)) for i, line in enumerate(lines, 6))
    rows = (_trc_row(cells, place, width) for place, cells in split if any(map(str.strip, cells)))
    table = number_table(rows, width - 1)
    promised, notes = number(facts.get("numframes", ""), f"{name}: line 3"), list[str]()
    if len(table) < promised:  # never true for NaN, where the file promises nothing
        table = table if text.endswith("\n") else table[:-1]  # its last number may be cut as well
        notes.append(ends_early(promised, len(table)))
    frames = len(table)
    axes = Axes("y", "right", scale_of(facts.get("units", ""), notes))
    return marker_animation(table[:, 1:].reshape(frames, len(names), 3), axes, table[:, 0], names, notes, name)


def _trc_row(cells: list[str], place: str, width: int) -> list[float]:
    """The numbers of a line but the first, NaN for missing cells. Raises InvalidMotion where there are too many."""
    while len(cells) > width and not cells[-1].strip():
        cells.pop()
    if len(cells) > width:
        raise InvalidMotion(f"{place}: it has {len(cells)} cells, {width} are named")
    row = [number(cell, place) for cell in cells[1:]]
    return row + [np.nan] * (width - 1 - len(row))


def _motive(text: str, name: str) -> Animation:
    """The markers of a text that Motive exported. Raises InvalidMotion, with the line."""
    lines = _lines(io.StringIO(text), name)
    _, facts = next(lines)
    above: list[list[str]] = []
    for _, cells in lines:
        if cells and cells[0].strip().lower() == "frame":
            break
        if any(cells):
            above.append([each.strip() for each in cells])
    triples = _motive_triples(above)
    wanted = [1, *(first + axis for first in triples.values() for axis in range(3))]
    rows = _wanted(((line, cells) for line, cells in lines if any(cells)), wanted, False, name)
    table, notes = number_table(rows, len(wanted)), list[str]()
    unit = dict(zip(facts[::2], facts[1::2], strict=False)).get("Length Units", "")
    axes = Axes("y", "right", scale_of(unit, notes, "m"))
    positions = table[:, 1:].reshape(len(table), len(triples), 3)
    return marker_animation(positions, axes, table[:, 0], list(triples), notes, name)


def _motive_triples(above: list[list[str]]) -> dict[str, int]:
    """The first column of each marker's position, by its name, from the lines above the table."""
    if len(above) < 3:
        return {}
    kinds, names, what = above[0], above[1], above[-1]
    found: dict[str, int] = {}
    for i in range(2, min(map(len, (kinds, names, what)))):
        if kinds[i].lower() in MARKER_KINDS and what[i].lower() == "position":
            found.setdefault(names[i], i)
    return found


def _vicon(text: str, name: str) -> Animation:
    """The markers of the trajectories in a text that Nexus exported. Raises InvalidMotion, with the line."""
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
    columns = _vicon_triples(_cells(names, separator), _cells(kinds, separator))
    wanted = [0, *(first + axis for first in columns.values() for axis in range(3))]

    def section() -> Lines:
        for line, cells in _lines(stream, name, separator, above + 5):
            if not any(cells):
                return
            if cells[0].strip().lower() in EMPTY:
                raise InvalidMotion(f"{name}: line {line}: {spelt(cells[0])} is no frame number")
            yield line, cells

    table = number_table(_wanted(section(), wanted, separator != ",", name), len(wanted))
    times = (table[:, 0] - table[:1, 0]) / rate  # frame numbers begin at any
    notes: list[str] = []
    unit = _cells(units, separator)
    first = next(iter(columns.values()), 0)
    axes = Axes("z", "right", scale_of(unit[first] if first < len(unit) else "", notes))
    positions = table[:, 1:].reshape(len(table), len(columns), 3)
    return marker_animation(positions, axes, times, list(columns), notes, name)


def _cells(line: str, separator: str) -> list[str]:
    return [each.strip() for each in next(csv.reader([line], delimiter=separator), [])] or [""]


def _vicon_triples(names: list[str], kinds: list[str]) -> dict[str, int]:
    """The first column of each marker's position, by its name."""
    found: dict[str, int] = {}
    label = ""
    for i in range(2, len(kinds) - 2):
        label = names[i] if i < len(names) and names[i] else label
        if [each.upper() for each in kinds[i : i + 3]] == ["X", "Y", "Z"]:
            found.setdefault(label or f"column {i + 1}", i)
    return found


def _wanted(lines: Lines, wanted: list[int], commas: bool, name: str) -> Iterator[list[float]]:
    """The wanted numbers of each line; decimal `commas`. Raises InvalidMotion."""
    for line, cells in lines:
        texts = [cells[i] if i < len(cells) else "" for i in wanted]
        yield [number(text.replace(",", ".") if commas else text, f"{name}: line {line}") for text in texts]


def _lines(stream: io.StringIO, name: str, separator: str = ",", above: int = 0) -> Lines:
    """The lines of a table, so many lines below its top: number and cells. Raises InvalidMotion."""
    reader = csv.reader(stream, delimiter=separator)
    try:
        for cells in reader:
            yield above + reader.line_num, cells
    except csv.Error as error:
        raise InvalidMotion(f"{name}: it is not a table of cells ({error})") from None


UNIT_NAMES = ("m", "cm", "mm", "in", "ft")
"""The units that messages list."""

LEAP = 10_000
"""More frames missing in a row than this are a slip of the pen, and would fill the memory with gaps."""

COMMENT = re.compile(r"#\s*(unit|up|handedness|rate)s?\s*[:=]\s*(\S+)\s*", re.IGNORECASE)


class Table(NamedTuple):
    """A table whose line of names has been read."""

    name: str  # of the file
    header: list[str]
    rows: Lines  # with at least as many cells as names
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
    header = [each.strip() for _, cells in _lines(io.StringIO(line), name, separator) for each in cells]
    while header and not header[-1]:
        header.pop()
    return Table(name, header, _rows(stream, separator, before, len(header), name), separator != ",", comments)


def _rows(stream: io.StringIO, separator: str, before: int, width: int, name: str) -> Lines:
    for line, cells in _lines(stream, name, separator, before):
        if not any(cells) or cells[0].startswith("#"):
            continue
        if len(cells) > width and any(cells[width:]):
            raise InvalidMotion(f"{name}: line {line}: it has {len(cells)} cells, {width} are named")
        yield line, cells + [""] * (width - len(cells))


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
            raise InvalidMotion(f"{table.name}: rate must be above 0 and finite; {rate:g} was given")
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
            raise InvalidMotion(f"{table.name}: {key}: {spelt(given[key])} is not one of {', '.join(known)}")
    return Axes(given.get("up", "y"), given.get("handedness", "right"), METRES_PER_UNIT[given.get("unit", "m")])


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
    """The names of the points, no two the same; `v0`, `v1`, … of those that have none."""
    names = animation.names or ("",) * animation.positions.shape[1]
    found: dict[str, None] = {}
    for point, given in enumerate(names):
        name = label(given) or f"v{point}"
        found[unused(name, found) if name in found else name] = None
    return list(found)


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
    raise InvalidMotion(f"{place}: {spelt(cell)} is not a number")


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
    strange = f"its unit is {spelt(unit)}, taken for {default}"
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
