"""How far the rounding of a file's numbers may have moved the positions of a motion.

Many files hold float32, or text with some digits. The numbers themselves show that: all are multiples of a unit to
which those of float64 would not keep. Half of this unit is the most that rounding changes a coordinate by, so a motion
that is nearer than that is as good as the file. Coordinates that do not move say nothing: they may be round by design.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from typing import NamedTuple

import numpy as np

from clothfit.base.arrays import Array
from clothfit.motion.motion import Motion

SAMPLE = 100_000
"""Numbers that are looked at, of frames at equal distances."""

FEW = 100
"""Numbers that are looked at first."""

PRECISIONS = (11, 24)
"""Significant bits of float16 and float32."""

DECIMALS, DIGITS = range(10), range(3, 10)
"""Places after the point, and significant digits, of text."""

MOST_PLACES = 22
"""The largest power of ten that float64 holds exactly."""


class Grid(NamedTuple):
    """Numbers that a file can hold."""

    nearest: Callable[[Array], Array]  # to some numbers
    unit: Callable[[Array], Array]  # between the numbers around some


def rounding(motion: Motion) -> float:
    """Root mean square distance, m, of the observed positions if each coordinate is off by half a unit in the last
    place of the file's numbers; 0 where these have all digits of float64.
    """
    frames = slice(None, None, max(1, -(-motion.positions.size // SAMPLE)))
    x, seen = motion.positions[frames], motion.seen()[frames]
    both = (seen[1:] & seen[:-1])[..., None]
    moved = x[1:][both & (x[1:] != x[:-1])]
    if not len(moved):
        return 0.0
    units = [grid.unit(x[seen] / motion.unit) for grid in GRIDS if holds(grid, moved, motion.unit)]
    return max((0.5 * motion.unit * float(np.sqrt(3.0 * (unit**2).mean())) for unit in units), default=0.0)


def holds(grid: Grid, x: Array, unit: float) -> bool:
    """Whether a file with numbers of a grid, in units of so many m, can hold the coordinates x (N,), m."""
    few = x[:FEW]  # of a grid that holds not all, one of these is hardly ever held
    return all(bool(np.array_equal(grid.nearest(each / unit) * unit, each)) for each in (few, x))


def binary_unit(precision: int, q: Array) -> Array:
    """Unit in the last place (N,) of numbers q with so many bits; 0 for 0."""
    return np.where(q == 0, 0.0, np.ldexp(1.0, np.frexp(q)[1] - precision))


def binary(precision: int, q: Array) -> Array:
    """The nearest numbers (N,) to q with so many bits."""
    exponent = np.frexp(q)[1] - precision
    return np.asarray(np.ldexp(np.rint(np.ldexp(q, -exponent)), exponent))


def digits_places(digits: int, q: Array) -> Array:
    """Places (N,) after the point of numbers q with so many significant digits; hundreds for 0."""
    return digits - 1 - np.floor(np.log10(np.maximum(np.abs(q), np.finfo(float).tiny)))


def decimal(places: Callable[[Array], Array], q: Array) -> Array:
    """The nearest numbers (N,) to q with so many places after the point: as a reader makes them of text."""
    number = np.minimum(places(q), MOST_PLACES)
    up, down = 10.0 ** np.maximum(number, 0), 10.0 ** np.maximum(-number, 0)
    return np.asarray(np.rint(q * up / down) / up * down)  # one of both is 1


def decimal_unit(places: Callable[[Array], Array], q: Array) -> Array:
    """10^−places (N,) of numbers q."""
    return np.asarray(10.0 ** -places(q))


def always(places: int, q: Array) -> Array:
    """`places` (N,), whatever the numbers q are."""
    return np.full(q.shape, float(places))


GRIDS = [
    *(Grid(partial(binary, bits), partial(binary_unit, bits)) for bits in PRECISIONS),
    *(
        Grid(partial(decimal, places), partial(decimal_unit, places))
        for places in [*(partial(always, n) for n in DECIMALS), *(partial(digits_places, n) for n in DIGITS)]
    ),
]
"""The coarsest that holds all numbers counts."""
