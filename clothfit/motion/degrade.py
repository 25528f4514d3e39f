"""Noise: making a motion look like a capture (noise, vertices that no camera saw, another frame rate), and how far the
rounding of a file's numbers may have moved the positions of a motion.

Many files hold float32, or text with some digits. The numbers themselves show that: all are multiples of a unit to
which those of float64 would not keep. Half of this unit is the most that rounding changes a coordinate by, so a motion
that is nearer than that is as good as the file. Coordinates that do not move say nothing: they may be round by design.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import TypeAlias

import numpy as np

from clothfit.base.arrays import Array
from clothfit.base.limits import check_capture
from clothfit.base.memory import check_memory
from clothfit.motion.motion import Motion, arrays_of, check_loaded
from clothfit.motion.times import TIME_SLACK, interpolated, snapped

MOST_RECORDED_FRAMES = 1e18
"""More frames than any memory holds."""


def degrade(
    motion: Motion, noise: float = 0.0, observed: float = 1.0, every: int = 1, seed: int = 0, fps: float | None = None
) -> Motion:
    """Make a motion look like a capture: noise, unseen vertices, fewer frames.

    `noise` is the standard deviation of each coordinate, m. `observed`, above 0 and at most 1, is the fraction of the
    vertices that are seen, drawn once for each object, at least one of each; the others become NaN. `every` K keeps
    every K-th frame; `fps` records so many frames per second instead. The same seed gives the same motion. Raises
    InvalidInput when a value is out of range.
    """
    check_loaded(motion)
    check_capture(noise, observed, every, fps)
    generator = np.random.default_rng(seed)
    if fps is not None:
        motion = at_rate(motion, fps)
    else:  # a copy: noise and gaps are written into it
        motion = replace(motion, **{name: array[::every].copy() for name, array in arrays_of(motion).items()})
    positions, kept = motion.positions, motion.observed
    if noise > 0:
        for frame in positions:  # one by one: an array as large as `positions` would take as much memory again
            frame += generator.normal(scale=noise, size=frame.shape)
    if observed < 1:
        seen = np.zeros(positions.shape[1], bool)
        start = 0
        for count in motion.vertex_counts:
            chosen = generator.choice(count, size=max(1, round(observed * count)), replace=False)
            seen[start + chosen] = True
            start += count
        kept = np.broadcast_to(seen, positions.shape[:2]).copy() if kept is None else kept & seen
        positions[~kept] = np.nan
    return replace(motion, observed=kept)


def at_rate(motion: Motion, fps: float) -> Motion:
    """The motion at `fps` frames per second from its first time on, linear between its frames.

    A fit interpolates in the same way, so a perfect target stays perfect. A position is observed, and weighs more
    than 0, where both frames beside it allow that.
    """
    first, last = float(motion.times[0]), float(motion.times[-1])
    slack = TIME_SLACK * (last - first) / max(len(motion.times) - 1, 1)
    frames = int(min((last - first + slack) * fps, MOST_RECORDED_FRAMES)) + 1
    check_memory(frames, motion.positions.shape[1], 1)
    times = first + np.arange(frames) / fps
    index, fraction = snapped(np.interp(times, motion.times, np.arange(len(motion.times))))
    after = index + (fraction > 0)
    observed, weights = motion.observed, motion.weights
    if weights is not None:
        weights = np.where((weights[index] > 0) & (weights[after] > 0), interpolated(weights, index, fraction), 0.0)
    return replace(
        motion,
        positions=interpolated(motion.positions, index, fraction),
        times=times,
        observed=None if observed is None else observed[index] & observed[after],
        weights=weights,
    )


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


Grid: TypeAlias = tuple[Callable[[int, Array], tuple[Array, Array]], int]
"""Numbers that a file can hold: what gives the nearest of them to some numbers (N,) and the unit between those around
each, and how many bits, places or digits they have.
"""


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
    units = [way(count, x[seen] / motion.unit)[1] for way, count in GRIDS if holds((way, count), moved, motion.unit)]
    return max((0.5 * motion.unit * float(np.sqrt(3.0 * (unit**2).mean())) for unit in units), default=0.0)


def holds(grid: Grid, x: Array, unit: float) -> bool:
    """Whether a file with numbers of a grid, in units of so many m, can hold the coordinates x (N,), m."""
    way, count = grid
    few = x[:FEW]  # of a grid that holds not all, one of these is hardly ever held
    return all(bool(np.array_equal(way(count, each / unit)[0] * unit, each)) for each in (few, x))


def binary(bits: int, q: Array) -> tuple[Array, Array]:
    """Numbers with so many significant bits; the unit of 0 is 0."""
    exponent = np.frexp(q)[1] - bits
    return np.ldexp(np.rint(np.ldexp(q, -exponent)), exponent), np.where(q == 0, 0.0, np.ldexp(1.0, exponent))


def decimals(places: int | Array, q: Array) -> tuple[Array, Array]:
    """Numbers with so many places after the point, as a reader makes them of text."""
    places = np.full(q.shape, places, float)
    number = np.minimum(places, MOST_PLACES)
    up, down = 10.0 ** np.maximum(number, 0), 10.0 ** np.maximum(-number, 0)
    return np.rint(q * up / down) / up * down, 10.0**-places  # up or down is 1


def digits(count: int, q: Array) -> tuple[Array, Array]:
    """Numbers with so many significant digits; 0 has hundreds of places."""
    return decimals(count - 1 - np.floor(np.log10(np.maximum(np.abs(q), np.finfo(float).tiny))), q)


KINDS = (binary, PRECISIONS), (decimals, DECIMALS), (digits, DIGITS)
GRIDS: list[Grid] = [(way, count) for way, counts in KINDS for count in counts]
"""The coarsest that holds all numbers counts."""
