"""The knots in time of paths and of a wind that a search moves, beside keys that a scene has already.

The scene's own keys stay, to the end, with knots between them where the values go on as they did. What is found is a
change that the knots have, of the same interpolation.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from clothfit.base.arrays import Array
from clothfit.engine.inputs.interpolation import interpolated
from clothfit.scene.keys import Keys

SPACING, MOST_KNOTS = 0.1, 60
"""s between two knots of a path or of the wind where nothing is said, and how many there are at most."""

FEWEST_KNOTS = 5

TOGETHER = 1e-6
"""Share of the spacing within which a knot and a key are one."""


def times(end: float, step: float, every: float | None) -> Array:
    """The times (K,), s, of the knots, from 0 to `end`, `every` so many s, at most one for each time `step`, s."""
    spacing = max(SPACING, end / MOST_KNOTS) if every is None else max(every, step)
    least = FEWEST_KNOTS if every is None else 2
    return np.linspace(0.0, end, max(int(np.ceil(end / spacing - 1e-9)) + 1, least))


def among(knots: Array, own: Array) -> Array:
    """The knots (K,), s, those after the first that are as good as one of a scene's own keys (T,), s, at it."""
    if not len(own):
        return knots
    near = own[np.clip(np.searchsorted(own, knots), 0, len(own) - 1)]
    before = own[np.clip(np.searchsorted(own, knots) - 1, 0, len(own) - 1)]
    near = np.where(np.abs(before - knots) < np.abs(near - knots), before, near)
    at = np.abs(near - knots) < TOGETHER * (knots[1] - knots[0])
    at[0] = False  # what moves begins at time 0 itself
    return np.where(at, near, knots)


def keyed(knots: Array, given: Keys | None, since: float | None = None) -> dict[str, Any]:
    """Keys with a value at each knot (K,), s, as the file of a scene has them: 0, or as those that are `given`, with
    its own ones; less the value at the time `since`, s.
    """
    if given is None:
        return written(knots, np.zeros((len(knots), 3)), "smooth")
    both = np.union1d(given.times, among(knots, given.times))
    values = interpolated(given, both)
    if since is not None:
        values = values - interpolated(given, np.array([since]))
    return written(both, values, given.interpolation)


def written(at: Array, values: Array, interpolation: str) -> dict[str, Any]:
    """Keys as the file of a scene has them."""
    rows = [dict(zip("xyz", row, strict=True)) for row in values.tolist()]
    return {"times": at.tolist(), "values": rows, "interpolation": interpolation}


def shares(knots: Array, own: Keys) -> Array:
    """The share (T, K) of each knot (K,), s, in the values of a scene's keys, at the knots and between them."""
    knots = among(knots, own.times)
    if np.array_equal(knots, own.times):
        return np.eye(len(knots))
    return interpolated(Keys(knots, np.eye(len(knots)), own.interpolation), own.times)
