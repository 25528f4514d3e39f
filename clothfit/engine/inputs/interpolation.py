"""The values of keys at any time: in between two of them, and as factors where they scale."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from clothfit.base.arrays import Array
from clothfit.base.errors import InvalidScene
from clothfit.scene.keys import Keys

if TYPE_CHECKING:
    from scipy.interpolate import CubicSpline


def resolved(keys: Keys) -> Keys:
    """Keys with their numbers. Raises InvalidScene where their file does not have them."""
    if keys.file is None:
        return keys
    from clothfit.engine.inputs.files import loaded  # what reads all formats, which few scenes need

    return loaded(keys)


def interpolated(keys: Keys, times: Array) -> Array:
    """The values (T, …) of keys at times (T,), s."""
    own, values = keys.times, keys.values
    inside = np.clip(times, own[0], own[-1])
    after = np.clip(np.searchsorted(own, inside, side="right"), 1, max(len(own) - 1, 1))
    if keys.interpolation == "hold" or len(own) == 1:
        return np.ascontiguousarray(values[np.searchsorted(own, inside, side="right") - 1])
    if keys.interpolation == "smooth":
        return np.ascontiguousarray(splined(own, values, keys.place)(inside))
    share = (inside - own[after - 1]) / (own[after] - own[after - 1])
    share = share.reshape(-1, *[1] * (values.ndim - 1))
    return np.ascontiguousarray(values[after - 1] + share * (values[after] - values[after - 1]))


def growth(keys: Keys, times: Array) -> Array:
    """The factors (T, 3) since time 0 at times (T,), s, of keys of a scale. Raises InvalidScene where one is not above
    0.
    """
    found = interpolated(resolved(keys), np.append(0.0, times))
    if not (found > 0.0).all():
        late = np.append(0.0, times)[np.argmin((found > 0.0).all(axis=1))]
        raise InvalidScene(f"{keys.place}: at {late:.4g} s the scale is not above 0")
    return np.asarray(found[1:] / found[0])


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
