"""Times on the grid of steps: between which states of a simulation a frame lies, and the state there.

A frame at time t = (j + φ) h, 0 ≤ φ < 1, is compared with the simulated state at that time, which lies on the straight
line between the states after steps j and j + 1,

    s = (1 − φ) x_j + φ x_{j+1},

because backward Euler's velocity is constant during a step. Times that are multiples of h except for rounding count as
multiples; several frames may fall within one step.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from clothfit.base.arrays import Array, Indices
from clothfit.base.errors import InvalidMotion
from clothfit.motion.motion import Motion

if TYPE_CHECKING:
    from scipy.sparse import csr_array

TIME_SLACK = 1e-3
"""A frame within this many steps of a multiple of the time step counts as the multiple: many files have the time step
as float32.
"""

MOST_STEPS = 2**31 - 1
"""Steps are counted in 32 bits."""


def snapped(places: Array) -> tuple[Indices, Array]:
    """Split places on a grid, in grid units, into whole numbers and fractions, which are 0 within TIME_SLACK."""
    whole = np.rint(places)
    on_grid = np.abs(places - whole) <= TIME_SLACK
    below = np.where(on_grid, whole, np.floor(places))
    return below.astype(np.int32), np.where(on_grid, 0.0, places - below)


def frame_places(motion: Motion, delta: float) -> tuple[Indices, Array]:
    """Step (F,) and fraction (F,) of each frame of a motion, for time step `delta`, s. Raises InvalidMotion."""
    places = motion.times / delta
    if places[-1] > MOST_STEPS:
        frame = len(places) - 1
        raise InvalidMotion(f"{motion.name}: times[{frame}]: {motion.times[-1]:.6g} s is too many steps away")
    if places[0] < -TIME_SLACK:
        raise InvalidMotion(f"{motion.name}: times[0]: {motion.times[0]:.6g} s is before the start, which is at 0 s")
    return snapped(places)


def interpolation(step: Indices, fraction: Array, states: int) -> csr_array:
    """The matrix (F, states) from the states after the steps to those at F times."""
    from scipy.sparse import csr_array

    between = fraction > 0
    frames = np.arange(len(step))
    rows = np.concatenate([frames, frames[between]])
    columns = np.concatenate([step, step[between] + 1])
    values = np.concatenate([1.0 - fraction, fraction[between]])
    return csr_array((values, (rows, columns)), shape=(len(step), states))


def interpolated(x: Array, step: Indices, fraction: Array) -> Array:
    """The arrays (F, …) at places between the items of x (T + 1, …)."""
    if not fraction.any():
        return x[step]
    flat: Array = interpolation(step, fraction, len(x)) @ x.reshape(len(x), -1)
    return flat.reshape(len(step), *x.shape[1:])
