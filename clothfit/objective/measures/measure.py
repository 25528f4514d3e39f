"""What of a motion is compared: objectives, one file each, and what they share.

An objective takes the states s (F, n, 3) of one cloth at the times of the target's F frames (`target.sample`) and gives
their differences from the target's in R groups of c numbers each. It is a class like `Measure`, made from (goal,
system, name): a Target, the cloth's System and the name of the motion for messages.

J is exact. A robust loss takes the norm of a group. A weight is a factor of the loss, so that a weight of 2 is the same
as observing twice.

To add an objective, write such a class in a file of its own and a line in `comparison.OBJECTIVES`.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING, Any, Protocol, TypeAlias

import numpy as np
from numpy.typing import NDArray

from clothfit.base.arrays import Array, Flags
from clothfit.engine.system import System
from clothfit.objective.target import Target

if TYPE_CHECKING:
    from scipy.sparse import csr_array


Integers: TypeAlias = NDArray[np.integer[Any]]


class Measure(Protocol):
    """One objective for one cloth and one target."""

    groups: int  # R
    reach: int  # how many vertices at how many times a group depends on
    linear: bool  # whether J is the same for all s
    weights: Array | None  # (R,), how often each group counts; None where all count once
    seen: Flags  # (n,), the vertices that are compared at some time after the initial state

    def residual(self, s: Array) -> Array:
        """d (R, c) of the states s (F, n, 3); 0 where s is the target."""

    def pullback(self, s: Array, r: Array) -> Array:
        """Jᵀ r (F, n, 3) for r (R, c), J = ∂d/∂s."""

    def jacobian(self, s: Array) -> csr_array:
        """J as a sparse matrix (R·c, F·n·3), rows and columns in the order of the arrays."""


Maker = Callable[[Target, System, str], Measure]


def both(weights: Array, other: Array) -> Array:
    """The weight of the difference of two values of these weights.

    Weights are inverse variances, and variances add. The factor 2 lets two values of one weight keep that weight.
    """
    return np.asarray(2.0 * weights * other / (weights + other))


def marked(pairs: Integers, n: int) -> Flags:
    """Flags (n,), set at the vertices that are listed."""
    flags = np.zeros(n, bool)
    flags[pairs] = True
    return flags


def coordinates(frame: Integers, vertex: Integers, n: int) -> Integers:
    """Columns (R, 3) of the coordinates of vertices (R,) in frames (R,)."""
    return np.asarray(3 * (frame * n + vertex)[:, None] + np.arange(3))


def matrix(rows: Integers, columns: Integers, values: Array, shape: tuple[int, int]) -> csr_array:
    """A sparse matrix from its entries, arrays of one shape."""
    from scipy.sparse import csr_array

    entries = [np.ravel(part) for part in np.broadcast_arrays(values, rows, columns)]
    return csr_array((entries[0], (entries[1], entries[2])), shape=shape)
