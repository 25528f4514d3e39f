"""The smooth curve through keys: a cubic spline of two continuous derivatives, at rest at its ends."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from clothfit.base.arrays import Array
from clothfit.base.errors import InvalidScene

if TYPE_CHECKING:
    from scipy.interpolate import CubicSpline


def splined(times: Array, values: Array, place: str) -> CubicSpline:
    """The spline through values (K, …) at times (K,), s. Raises InvalidScene, with the place, where the values are so
    large or the times so close that its slopes are no numbers.
    """
    from scipy.interpolate import CubicSpline

    with np.errstate(all="ignore"):
        try:
            found = CubicSpline(times, values, bc_type="clamped")
        except ValueError:  # of finite values at times that increase: a slope overflows
            found = None
    if found is None or not np.isfinite(found.c).all():
        raise InvalidScene(f"{place}: the values change too much in too short a time for a smooth curve")
    return found
