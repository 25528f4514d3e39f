"""Limits of the numbers that a caller gives, checked without any library, so that a wrong number fails at once; and
doubts about numbers whose unit is hard to believe.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

from clothfit.base.errors import InvalidInput
from clothfit.base.messages import kilograms, metres

FIT_TOLERANCE = 1e-10  # of the linear systems of a fit and of what is compared with it, relative

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


LENGTHS = (1e-2, 20.0)  # m, of the largest side: a doll's handkerchief, a stage curtain
MASSES = (1e-6, 1e4)  # kg
LARGE_UNITS = {0.01: "centimetres", 0.001: "millimetres", 100.0: "units of 100 m", 1000.0: "kilometres"}
GARMENT = 1.0  # m, of the largest side in the right unit
LONGEST_STEP = 1.0  # s
FALLS = 100.0  # m/s²


def doubts(size: Sequence[float], mass: float | None = None, remedy: str = "add --scale {}") -> list[str]:
    """A sentence for each thing that is hard to believe: `size` the sides of the bounding box, m; mass, kg. `remedy`
    is what to type, with {} in the place of the metres per unit.
    """
    longest = max(size, default=0.0)
    if longest > 0 and not LENGTHS[0] <= longest <= LENGTHS[1]:
        scale = min(LARGE_UNITS, key=lambda each: abs(math.log(each * longest / GARMENT)))
        weight = f", and weighs {kilograms(mass)}" if mass else ""
        unit = f"if the file is in {LARGE_UNITS[scale]}, {remedy.format(f'{scale:g}')}"
        return [f"it is {metres(longest)} across{weight}: {unit}"]
    if mass is not None and mass > 0 and not MASSES[0] <= mass <= MASSES[1]:
        return [f"it weighs {kilograms(mass)}; are size and mass per area right?"]
    return []


def doubts_of_time(step: float, gravity: Sequence[float]) -> list[str]:
    """The same of a time step, s, and of gravity, m/s²."""
    found = []
    if step > LONGEST_STEP:
        found.append(f'delta: a time step of {step:g} s; of milliseconds, "delta" is {step / 1000:g}')
    if (falls := math.hypot(*gravity)) > FALLS:
        found.append(f"gravity: it is {falls:g} m/s²; on Earth, in metres, it is 9.81")
    return found


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
