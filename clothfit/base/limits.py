"""Limits of the numbers that a caller gives: checks without any library, so that a wrong number fails at once."""

from __future__ import annotations

import math

from clothfit.base.errors import InvalidInput

FARTHEST = 1e12
"""A vertex farther than this many metres from the origin (sum of its coordinates) counts as diverged."""


def checked_tolerance(tolerance: float | None, default: float) -> float:
    """The relative tolerance to solve to. Raises InvalidInput unless it is above 0 and below 1."""
    value = default if tolerance is None else tolerance
    if not 0 < value < 1:
        raise InvalidInput(f"tolerance must be above 0 and below 1; {value:g} was given")
    return value


def check_capture(noise: float, observed: float, every: int, fps: float | None = None) -> None:
    """Raise InvalidInput when a capture cannot have these values."""
    if not (math.isfinite(noise) and noise >= 0):
        raise InvalidInput(f"noise must be at least 0 and finite; {noise:g} m was given")
    if not 0 < observed <= 1:
        raise InvalidInput(f"observed must be a fraction above 0 and at most 1; {observed:g} was given")
    if every < 1:
        raise InvalidInput(f"every must be at least 1; {every} was given")
    if fps is not None and not 0 < fps < math.inf:
        raise InvalidInput(f"fps must be above 0 and finite; {fps:g} was given")
    if fps is not None and every != 1:
        raise InvalidInput("fps: does not go with every; each says which frames there are")
