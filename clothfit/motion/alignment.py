"""Does a motion begin where its scene does? If not, which other axes, unit, order or place would fit?

A cloth starts at the scene's initial positions, so a motion's frame at time 0 must be near them. Where it is not, the
file mostly has other axes or another unit than assumed.
"""

from __future__ import annotations

from itertools import product
from typing import NamedTuple

import numpy as np

from clothfit.base.arrays import Array, Flags
from clothfit.base.messages import metres
from clothfit.formats.axes import HANDS, UPS, Axes, from_scene, to_scene
from clothfit.formats.markers import METRES_PER_UNIT

DOUBTFUL_DISTANCE = 0.05
"""An RMS distance of this share of the scene's size is more than noise."""

MISTAKEN = 0.25
"""The share of the vertices that may be as far away without a word: markers that were mistaken for others."""

MUCH_NEARER = 0.2
"""A change that leaves less than this share of the distance is worth trying."""


class Alignment(NamedTuple):
    """How well the beginning of a motion fits the scene."""

    distance: float  # root of the mean squared distance of its vertices from the scene's, m
    doubt: str | None  # a sentence, where the distance is large
    advice: str | None  # which change would fit better


def alignment(points: Array, seen: Flags, start: Array, axes: Axes) -> Alignment:
    """Compare the observed vertices, `seen` (n,), of a frame (n, 3), m, with the start (n, 3) of the scene.

    `axes`: those assumed for the file.
    """
    points, start = points[seen], start[seen]
    if not len(points):
        return Alignment(np.nan, None, None)
    distance = apart(points, start)
    most = float(np.quantile(np.linalg.norm(points - start, axis=1), 1.0 - MISTAKEN))
    if min(distance, most) <= DOUBTFUL_DISTANCE * size(start):
        return Alignment(distance, None, None)
    doubt = f"its first frame is {metres(distance)} (RMS) away from where the scene begins"
    return Alignment(distance, doubt, advice(from_scene(points, axes), start, axes, MUCH_NEARER * distance))


def advice(points: Array, start: Array, axes: Axes, bar: float) -> str | None:
    """Which change would bring points (n, 3), as in the file, nearer to the start than `bar`, m."""
    scales = sorted({*METRES_PER_UNIT.values(), axes.scale})
    others = [Axes(up, hand, scale) for up, hand, scale in product(UPS, HANDS, scales)]
    best = min(others, key=lambda each: (apart(to_scene(points, each), start), differences(each, axes)))
    if apart(to_scene(points, best), start) < bar:
        return f"{options(best, axes)} would fit"
    now = to_scene(points, axes)
    shift = (now - start).mean(axis=0)
    if apart(now - shift, start) < bar:
        x, y, z = np.round(shift, 3) + 0.0  # no −0
        return f"it is moved by ({x:.3g}, {y:.3g}, {z:.3g}) m"
    for each in sorted(others, key=lambda each: differences(each, axes)):
        if unordered(to_scene(points, each), start) < bar:
            return f"{f'with {options(each, axes)} ' if each != axes else ''}its vertices would fit in another order"
    return None


def unordered(points: Array, others: Array) -> float:
    """The RMS distance from each of two sets of points (n, 3) to the nearest points of the other, m, the larger one."""
    from scipy.spatial import KDTree

    pairs = ((points, others), (others, points))
    return max(float(np.sqrt(np.mean(KDTree(b).query(a)[0] ** 2))) for a, b in pairs)


def options(axes: Axes, other: Axes) -> str:
    """The command's options for axes that differ from `other`."""
    changed = [name for name in axes._fields if getattr(axes, name) != getattr(other, name)]
    return " ".join(f"--{name} {getattr(axes, name)}" for name in changed)


def differences(axes: Axes, other: Axes) -> int:
    """In how many of the three fields they differ."""
    return sum(a != b for a, b in zip(axes, other, strict=True))


def apart(points: Array, others: Array) -> float:
    """Root of the mean squared distance between points (n, 3), m."""
    return float(np.sqrt(np.mean(np.sum((points - others) ** 2, axis=1))))


def size(points: Array) -> float:
    """Diagonal of the box around points (n, 3), m."""
    return float(np.linalg.norm(np.ptp(points, axis=0)))
