"""How a fit went: its cost after each evaluation, and its summary with the intervals.

A log is a file of `clothfit estimate --log`: one JSON object a line, of which `evaluations`, `cost`, `rmse` and
`seconds` are read; the last has under `summary` what `clothfit estimate --json` prints. A log is not trusted and may
end early: lines that cannot be read are left out, and a warning counts them.
"""

from __future__ import annotations

import json
import os
import sys
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any, NamedTuple

from clothfit.base.errors import InvalidInput, InvalidScene
from clothfit.base.messages import counted, unreadable
from clothfit.base.reading import unchanged, whole
from clothfit.scene.fit_vector import parameters, with_parameters
from clothfit.scene.scene import Scene
from clothfit.scene.text import name_of

MOST_BYTES = 200_000_000
"""Largest log that is read."""

MOST_POINTS = 2000
"""Most points of the cost curve; of more, every k-th is kept."""

LARGEST_START = 1e30
"""In SI units: larger values are none that a fit began with, and their sums overflow."""


class Point(NamedTuple):
    """The state of a fit after some evaluations."""

    evaluations: int
    cost: float  # best so far, m² of positions
    rmse: float  # best so far, m
    seconds: float


@dataclass(frozen=True)
class Log:
    """What is known of a fit."""

    points: list[Point] = field(default_factory=list)  # in order
    summary: Mapping[str, Any] = field(default_factory=dict)  # as `clothfit estimate --json`, not checked
    warnings: list[str] = field(default_factory=list)
    start: Scene | None = None  # with the values with which the fit began


def read_log(path: str | os.PathLike[str]) -> Log:
    """Read a log. Raises InvalidInput when it cannot be read or no line of it is one of a fit."""
    name = name_of(path)
    try:
        with unchanged(path) as file:
            text = whole(file, MOST_BYTES).decode("utf-8-sig", errors="replace")
    except (OSError, ValueError) as error:
        raise InvalidInput(f"{name}: {unreadable(error)}") from None
    points, summary, lost = [], None, 0
    for line in text.splitlines():
        record = parsed(line)
        if record is None:
            lost += bool(line.strip())
            continue
        point = point_of(record)
        points += [] if point is None else [point]
        if isinstance(record.get("summary"), dict):
            summary = record["summary"]
    if not points and summary is None:
        raise InvalidInput(f"{name}: no line of it is the record of a fit; give a file that estimate --log has written")
    warnings = [f"{name}: {counted(lost, 'line', 'lines')} that cannot be read left out"] if lost else []
    if summary is None:
        warnings.append(f"{name}: ends early, without the fit's summary; there are no intervals")
    return Log(thinned(points), summary or {}, warnings)


def parsed(line: str) -> dict[str, Any] | None:
    """The JSON object of a line; None where there is none."""
    try:
        found = json.loads(line)
    except (ValueError, RecursionError):
        return None
    return found if isinstance(found, dict) else None


def point_of(record: Mapping[str, Any]) -> Point | None:
    """The point in the record of a line; None where there is none."""
    values = [number(record.get(key)) for key in Point._fields]
    if any(value is None or value < 0 for value in values):
        return None
    evaluations, *rest = values
    return Point(int(evaluations or 0), *(float(value or 0.0) for value in rest))


def number(value: object) -> float | None:
    """A value as a finite number; None where it is none."""
    known = isinstance(value, (int, float)) and not isinstance(value, bool) and abs(value) <= sys.float_info.max
    return float(value) if known else None  # type: ignore[arg-type]


def entry(summary: Any, *keys: str) -> Any:
    """What stands under nested keys of a summary, which is not checked; None where nothing does."""
    for key in keys:
        summary = summary.get(key) if isinstance(summary, Mapping) else None
    return summary


def records(summary: Any, *keys: str) -> list[Mapping[str, Any]]:
    """The list of records under nested keys, as far as it is one."""
    found = entry(summary, *keys)
    return [each for each in found if isinstance(each, Mapping)] if isinstance(found, list) else []


def thinned(points: list[Point]) -> list[Point]:
    """At most about `MOST_POINTS` of the points, evenly chosen, with the last one."""
    every = -(-len(points) // MOST_POINTS) or 1
    return [*points[:-1:every], *points[-1:]]


def intervals(summary: Mapping[str, Any], place: int | None, name: str, mode: str, count: int) -> list[Any] | None:
    """The 95 % intervals of a block of parameters, each [low, high] or None; None without such a block, or without the
    verdict on the model that they belong to.
    """
    for block in records(summary, "parameters") if isinstance(summary.get("verdict"), Mapping) else []:
        ends = block.get("interval")
        same = [block.get(key) for key in ("object", "name", "mode")] == [place, name, mode]
        if same and isinstance(ends, list) and len(ends) == count:
            return [pair(each) for each in ends]
    return None


def start_of(summary: Mapping[str, Any], scene: Scene) -> Scene | None:
    """The scene with the values with which a fit of it began; None where the summary does not say all of them, or of
    other values than the scene flags.
    """
    p, blocks = parameters(scene), records(summary, "parameters")
    starts = {tuple(str(each.get(key)) for key in ("object", "name", "mode")): each.get("start") for each in blocks}
    for block in scene.blocks:
        found = starts.get((str(block.cloth), block.name, block.mode))
        values = [number(value) for value in (found if isinstance(found, list) else [found] * block.count)]
        known = [value for value in values if value is not None and abs(value) < LARGEST_START]
        if len(known) != block.count or len(values) != block.count:
            return None
        p[block.part] = known
    try:
        return with_parameters(scene, p)
    except InvalidScene:
        return None


def pair(ends: object) -> list[float] | None:
    """Two finite numbers in order; None where they are not."""
    if not isinstance(ends, (list, tuple)) or len(ends) != 2:
        return None
    low, high = number(ends[0]), number(ends[1])
    return None if low is None or high is None or low > high else [low, high]
