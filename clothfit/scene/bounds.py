"""Between which values a fit looks: what the scene, an object or the user asks for, else around the cloth's own values.

    lower = 1e-4, or a thousandth of the smallest positive value where that is below 1e-4
    upper = 1e4, or a thousand times the largest value where that is above 1e4

for masses, stiffnesses and rest lengths, in SI units; dampings and drags may likewise be larger than those of `kinds`,
where the cloth's own value is, or its faces are so small that real air has a larger drag; every other kind has the
bounds of `kinds`. So the bounds of ordinary values do not depend on them, and in a trial they give away nothing.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from clothfit.base.arrays import Array
from clothfit.base.errors import InvalidInput
from clothfit.base.messages import meant
from clothfit.scene.kinds import KINDS, Kind

End = float | None
Bounds = Mapping[str, tuple[End, End]]
"""Lower and upper bound of kinds, by name; None: the default."""

NO_BOUNDS: Bounds = {}

AROUND = 1e3
"""Factor around values that lie outside the bounds of their kind."""

LEAST = 1e-290
"""A lower bound that no default is below: upper bounds can be divided by it."""


def kind_named(name: str, kinds: Sequence[Kind] = KINDS) -> Kind | None:
    """The kind with this name, or whose field in the scene file has it; None where there is none."""
    return next((kind for kind in kinds if name in (kind.name, kind.field)), None)


def fault(kind: Kind, low: End, high: End) -> str | None:
    """What is wrong with the bounds of a kind; None where nothing is."""
    for end in (low, high):
        if end is not None and not math.isfinite(end):
            return f"{end:g} is not a finite number"
        if end is not None and end < 0 and kind.valid != "any number":
            return f"{end:g}{kind.suffix} cannot be a bound: the {kind.title} must be {kind.valid}"
    if high is not None and high <= 0 and kind.valid != "any number":
        return f"the upper bound {high:g}{kind.suffix} must be above 0"
    if low is not None and high is not None and not low < high:
        return f"the lower bound {low:g} must be below the upper one, {high:g}"
    return None


def from_file(given: Mapping[str, Any], kinds: Sequence[Kind], place: str, problems: list[str]) -> Bounds:
    """The bounds in a `fit` of the scene file, whose structure has been checked; what is wrong goes to `problems`."""
    found: dict[str, tuple[End, End]] = {}
    for name, (low, high) in given.items():
        kind = kind_named(name, kinds)
        if kind is None:
            continue
        wrong = "the kind is named twice" if kind.name in found else fault(kind, low, high)
        if wrong:
            problems.append(f"{place}.{name}: {wrong}")
        found[kind.name] = low, high
    return found


def from_user(given: Mapping[str, Any]) -> Bounds:
    """The bounds that a user gives, by names of kinds or of fields: a pair each, None where an end is left out.

    Raises InvalidInput.
    """
    found: dict[str, tuple[End, End]] = {}
    for name, pair in given.items():
        kind = kind_named(name)
        if kind is None:
            known = [kind.name for kind in KINDS]
            raise InvalidInput(f"bounds: there is no kind {name!r}; use {', '.join(known)}{meant(name, known)}")
        try:
            low, high = (None if end is None else float(end) for end in pair)
        except (TypeError, ValueError):
            raise InvalidInput(f"bounds: {name}: {pair!r} is not a pair of numbers, lower and upper") from None
        if wrong := fault(kind, low, high):
            raise InvalidInput(f"bounds: {name}: {wrong}")
        found[kind.name] = low, high
    return found


def of_values(kind: Kind, values: Array, asked: tuple[End, End] = (None, None)) -> tuple[float, float]:
    """Lower and upper bound of the values of one cloth, as asked for where an end is given.

    A fit moves the logarithm of a mass, stiffness or length: a lower bound of 0 means the default one, which is above.
    """
    low, high = asked
    least, most = around(kind, values)  # an end that is left out is as far from the other as the default ones
    if low is None or (kind.log and low <= 0.0):
        low = least if high is None or least < high else _shifted(kind, high, kind.lower, kind.upper)
    if high is None:
        high = most if low < most else _shifted(kind, low, kind.upper, kind.lower)
    return low, high


def around(kind: Kind, values: Array) -> tuple[float, float]:
    """The default bounds of values."""
    if kind.valid == "any number" or not values.size:
        return kind.lower, kind.upper
    most = float(values.max())
    if not kind.log:
        return kind.lower, kind.upper if most <= kind.upper else most * AROUND
    least = float(np.min(values, where=values > 0, initial=np.inf))
    return (
        kind.lower if least >= kind.lower else max(least / AROUND, LEAST),
        kind.upper if most <= kind.upper else most * AROUND,
    )


def wider(kind: Kind, low: float, high: float) -> tuple[End, float]:
    """Bounds beyond those of values; None where the values can be no less."""
    if kind.log:
        return low / AROUND, high * AROUND
    least = None if kind.valid != "any number" else low - AROUND * max(abs(low), kind.scale)
    return least, high + AROUND * max(abs(high), kind.scale)


def of_factor(values: Array, ends: tuple[float, float]) -> tuple[float, float]:
    """Bounds of one factor that keep the values, positive, within their bounds `ends`; in order where none can."""
    least, most = sorted((ends[0] / float(values.min()), ends[1] / float(values.max())))
    return least, most


def _shifted(kind: Kind, end: float, there: float, here: float) -> float:
    """A bound as far from the bound `end` as the default one `there` is from `here`."""
    return end * there / here if kind.log else end + (there - here)
