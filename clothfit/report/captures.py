"""Captures on a page: the residuals of each marker in each frame with gaps and weights, which markers were swapped or
false, and the clock and place of the target.

A marker stands for a vertex that the target shows. M markers, F shown frames. From the fit's summary, which is not
checked, as far as it is known, and from the motions themselves.
"""

from __future__ import annotations

import math
import warnings
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from clothfit.base.messages import counted, metres
from clothfit.registration.record import named
from clothfit.report.log import entry, number, records
from clothfit.report.packing import packed
from clothfit.report.showing import View

MOST_MARKERS = 400
"""Markers of which a page shows single residuals: more have no room for a row each."""

MOST_ROWS = 40
"""Markers in the table, those with the largest residuals first."""

GAP = -1.0
"""Stands for what was not seen."""

NUMBERS = (("rate", "target's clock, rate", ""), ("offset", "target's clock at the start", " s"),
           ("rotation", "target turned by", "°"), ("translation", "target moved by", " m"),
           ("scale", "target scaled by", ""))  # fmt: skip
"""Of a registration: keys, titles and units."""


def markers_of(show: View, summary: Mapping[str, Any]) -> NDArray[np.intp]:
    """The vertices that markers stand for, numbered through the scene; none where all is always seen, and nothing is
    known of markers, or where there are too many.
    """
    seen = np.isfinite(show.error)
    known = np.flatnonzero(seen.any(axis=0) | np.isin(np.arange(seen.shape[1]), list(remarks(show, summary))))
    capture = not seen[:, known].all() or len(known) < seen.shape[1] or show.weights is not None
    return known if (capture or summary.get("markers")) and len(known) <= MOST_MARKERS else known[:0]


def content(show: View, summary: Mapping[str, Any]) -> dict[str, Any]:
    """The residuals of each marker (M, F), m, −1 in gaps, and their weights, 1 for the largest."""
    own = markers_of(show, summary)
    error = np.where(np.isfinite(show.error[:, own]), show.error[:, own], GAP)
    weights = None if show.weights is None else show.weights[:, own]
    most = 0.0 if weights is None or not weights.size else float(weights.max())
    return {
        "markers": own.tolist(),
        "marker_times": show.times.tolist() if len(own) else [],
        "of_markers": packed(error.T),
        "weights": packed(weights.T / most) if weights is not None and most > 0 else None,
    }


def table_rows(show: View, summary: Mapping[str, Any]) -> list[list[Any]]:
    """A row for each marker, the farthest first: its residuals, how much of it is seen, and what was wrong with it."""
    own, said = markers_of(show, summary), remarks(show, summary)
    if not len(own):
        return []
    error = show.error[:, own]
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", RuntimeWarning)  # means of nothing are NaN, as they should be
        rmse, most = np.sqrt(np.nanmean(error**2, axis=0)), np.nanmax(error, axis=0)
    order = sorted(range(len(own)), key=lambda i: (int(own[i]) not in said, -np.nan_to_num(rmse[i], nan=np.inf)))
    rows = []
    for i in order[:MOST_ROWS]:
        seen = np.isfinite(error[:, i])
        when = float(show.times[int(np.nanargmax(error[:, i]))]) if seen.any() else np.nan
        mean = np.nan if show.weights is None else float(show.weights[:, own[i]].mean())
        share = float(seen.mean())
        lengths = [[metres(x), x] if np.isfinite(x) else "–" for x in (float(rmse[i]), float(most[i]))]
        weight = [] if show.weights is None else [[f"{mean:.3g}", mean]]
        name = named(int(own[i]), show.vertex_counts)
        rows.append([
            name if len(show.vertex_counts) > 1 else str(own[i]), said.get(int(own[i]), ""), *lengths,
            [f"{when:.3g} s", when] if np.isfinite(when) else "–", [f"{100 * share:.3g} %", share], *weight,
        ])  # fmt: skip
    return rows


def heads(show: View) -> list[str]:
    """Those of the table."""
    weight = [] if show.weights is None else ["weight"]
    return ["marker of" if len(show.vertex_counts) > 1 else "vertex", "remark", "RMS", "largest", "at", "seen", *weight]


def remarks(show: View, summary: Mapping[str, Any]) -> dict[int, str]:
    """What was wrong with markers of the first target, by the vertices, numbered through the scene, that they were
    given to.
    """
    known, counts = summary.get("markers"), show.vertex_counts
    said: dict[int, str] = {}
    found = known[0] if isinstance(known, list) and known else {}
    for each in records(found, "jumps"):
        frames = each.get("frames")
        lost = counted(len(frames) if isinstance(frames, list) else 0, "frame", "frames")
        said |= dict.fromkeys(vertices(counts, each, [each.get("vertex")]), f"jumped, {lost} left out")
    for each in records(found, "false"):
        said |= dict.fromkeys(vertices(counts, each, [each.get("vertex")]), "false, left out")
    for each in records(found, "swapped"):
        listed = each.get("vertices")
        own = vertices(counts, each, listed if isinstance(listed, list) else [])
        for i, vertex in enumerate(own):
            said[vertex] = f"swapped, was given to {own[i - 1] - sum(counts[: int(each['object'])])}"
    return said


def vertices(counts: Sequence[int], record: Mapping[str, Any], listed: Sequence[Any]) -> list[int]:
    """The vertices of a record, numbered through the scene; none where they are no vertices."""
    own = record.get("object")
    if not isinstance(own, int) or not 0 <= own < len(counts):
        return []
    good = all(isinstance(each, int) and 0 <= each < counts[own] for each in listed)
    return [sum(counts[:own]) + each for each in listed] if good else []


def registered(summary: Mapping[str, Any]) -> list[list[str]]:
    """The clock, the place and the scale that the fit found for its targets, with their 95 % intervals."""
    found = [row(each.get(key), entry(each, "intervals", key), title, unit)
             for each in records(summary, "registration") for key, title, unit in NUMBERS]  # fmt: skip
    return [made for made in found if made is not None]


def row(value: Any, ends: Any, title: str, unit: str) -> list[str] | None:
    """A number of a registration, or three, and half of their intervals; None where they say nothing."""
    values = value if isinstance(value, list) else [value]
    pairs = ends if isinstance(value, list) else [ends]
    parts, half = [number(each) for each in values], list[float]()
    if None in parts or (not any(parts) if unit else parts == [1.0]):
        return None
    for pair in pairs if isinstance(pairs, list) else []:
        low, high = (number(end) for end in pair) if isinstance(pair, list) and len(pair) == 2 else (None, None)
        half += [] if low is None or high is None else [(high - low) / 2]
    known = half if len(half) == len(parts) and any(half) else [0.0] * len(parts)
    shown = [(significant(part or 0.0, each), significant(each, each)) for part, each in zip(parts, known, strict=True)]
    text, ends = (", ".join(each) if len(shown) == 1 else f"({', '.join(each)})" for each in zip(*shown, strict=True))
    return [title, f"{text}{f' ± {ends}' if any(known) else ''}{unit}"]


def significant(value: float, within: float) -> str:
    """A value with the digits that half its interval leaves two of; five where it has none."""
    return f"{value:.{max(0, 1 - math.floor(math.log10(within)))}f}" if within > 0 else f"{value:.5g}"
