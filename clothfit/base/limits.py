"""Limits of the numbers that a caller gives: checks without any library, so that a wrong number fails at once."""

from __future__ import annotations

import math
from collections.abc import Sequence

from clothfit.base.errors import InvalidInput
from clothfit.base.messages import kilograms, metres

FIT_TOLERANCE = 1e-10  # of the linear systems of a fit and of what is compared with it, relative

FARTHEST = 1e12
"""A vertex farther than this many metres from the origin (sum of its coordinates) counts as diverged."""

LENGTHS = (1e-2, 20.0)  # m, of the largest side: a doll's handkerchief, a stage curtain
MASSES = (1e-6, 1e4)  # kg
OTHER_UNITS = {0.01: "centimetres", 0.001: "millimetres", 100.0: "units of 100 m", 1000.0: "kilometres"}
OF_FILES, OF_SCENES = "add --scale {:g}", "make it again with clothfit new MESH --scale {:g}"
"""What to do about the unit of a file that has an option for it, and of a scene."""


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



def doubts(size: Sequence[float], mass: float | None = None, remedy: str = OF_FILES) -> list[str]:
    """A sentence where something is hard to believe: `size` the sides of the bounding box, m; mass, kg. The unit is the
    one in which the longest side comes nearest to a metre.
    """
    longest = max(size, default=0.0)
    if longest > 0 and not LENGTHS[0] <= longest <= LENGTHS[1]:
        scale = min(OTHER_UNITS, key=lambda each: abs(math.log(each * longest)))
        weight = f", and weighs {kilograms(mass)}" if mass else ""
        return [f"it is {metres(longest)} across{weight}: if that is in {OTHER_UNITS[scale]}, {remedy.format(scale)}"]
    if mass is not None and mass > 0 and not MASSES[0] <= mass <= MASSES[1]:
        return [f"it weighs {kilograms(mass)}; are size and mass per area (--density) right?"]
    return []


UNITS = {"": 1.0, "s": 1.0, "m": 60.0, "min": 60.0, "h": 3600.0}
"""Seconds of the units of a duration."""


def duration(text: str | None, option: str) -> float | None:
    """The seconds that the text of an option means: 30, 30s, 2m, 1.5h. Raises InvalidInput."""
    if text is None:
        return None
    number = text.strip().rstrip("abcdefghijklmnopqrstuvwxyz")
    unit = text.strip()[len(number) :]
    if not is_number(number) or unit not in UNITS or not 0 < float(number) < math.inf:
        raise InvalidInput(f"{option}: {text!r} is no time above 0; write it as 30, 30s, 2m or 1h")
    return float(number) * UNITS[unit]


def is_number(text: str) -> bool:
    """Whether a text, which may stand for something else, is a number."""
    try:
        float(text)
    except ValueError:
        return False
    return True
