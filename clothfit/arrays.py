"""Names for the kinds of array that travel through the package."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
Indices = NDArray[np.int32]
Flags = NDArray[np.bool_]


class Elements(NamedTuple):
    """One number for every mass and every stiffness of a cloth: values, a direction in them, or a gradient."""

    mass: Array  # (n,), one per vertex
    stiffness: Array  # (S,), one per spring
