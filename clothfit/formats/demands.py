"""What some formats need of an animation and not every animation has: times, an even rate, and gaps as NaN."""

from __future__ import annotations

import os

import numpy as np

from clothfit.base.arrays import Array
from clothfit.base.errors import InvalidMotion
from clothfit.formats.animation import Animation
from clothfit.formats.files import name_of

ASSUMED_RATE = 30.0
"""Frames per second where neither the file nor the user gives a rate."""

EVEN = 1e-3
"""How far a frame may be from its place in an even rate, as a share of the time between two frames."""


def with_gaps(animation: Animation) -> Array:
    """The positions, NaN where they were not observed."""
    if animation.observed is None:
        return animation.positions
    return np.where(animation.observed[..., None], animation.positions, np.nan)


def times_of(animation: Animation) -> Array:
    """Times of the frames, s; at RATE where they are not known."""
    return np.arange(len(animation.positions)) / ASSUMED_RATE if animation.times is None else animation.times


def rate_of(animation: Animation) -> float | None:
    """Frames per second; None where the rate is not even."""
    times = times_of(animation)
    if len(times) < 2:
        return ASSUMED_RATE
    step = float(times[-1] - times[0]) / (len(times) - 1)
    away = np.abs(times - times[0] - step * np.arange(len(times)))
    return rounded(1 / step) if away.max() <= EVEN * step else None


def rated(path: str | os.PathLike[str], animation: Animation) -> float:
    """Frames per second, for formats with one rate for all frames. Raises InvalidMotion where the rate is not even."""
    rate = rate_of(animation)
    if rate is None:
        raise InvalidMotion(
            f"{name_of(path)}: frames that are not at equal distances in time cannot be written; use .trc or .csv"
        )
    return rate


def rounded(rate: float) -> float:
    """A rate without the rounding errors of its times: 50, not 49.99999999999999."""
    plain = float(f"{rate:.9g}")
    return plain if abs(plain - rate) <= 1e-12 * rate else rate
