"""Names for the kinds of array that travel through the package."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
Indices = NDArray[np.int32]
Flags = NDArray[np.bool_]


LINE, PAGE = 8, 512
"""Numbers in a cache line of 64 bytes, and in a page of 4096."""

NO_NUMBERS: Array = np.zeros(0)
NO_VECTORS: Array = np.zeros((0, 3))
NO_TABLE: Array = np.zeros((0, 0, 3))


class Elements(NamedTuple):
    """What a fit may change of a cloth, kind by kind: values, a direction in them, or a gradient by them.

    Masses and stiffnesses are always there. Another kind is an empty array where it is not fitted, and then no kernel
    spends time on it; as a value, empty means unchanged.
    """

    mass: Array  # (n,), kg, one per vertex
    stiffness: Array  # (S,), N/m, one per spring
    damping: Array = NO_NUMBERS  # (K,), the coefficient α of each object, 1/s at the vertices, s at the springs
    drag: Array = NO_NUMBERS  # (K,), air drag of the faces of each object, kg/(m⁶ s)
    velocity: Array = NO_VECTORS  # (n, 3), at the start, m/s
    rest: Array = NO_NUMBERS  # (S,), rest lengths, m
    path: Array = NO_VECTORS  # (K, 3), how far the keys of the pins' paths are, m
    shift: Array = NO_NUMBERS  # (3,), how far all pins are from where their paths have them, m
    wind: Array = NO_NUMBERS  # (3,), velocity, m/s
    gravity: Array = NO_NUMBERS  # (3,), m/s²
    gusts: Array = NO_VECTORS  # (K, 3), what the keys add to the wind, m/s
    friction: Array = NO_NUMBERS  # (C,), coefficient of each collider that is no plain sphere, then of self-contact
    contact: Array = NO_NUMBERS  # (C,), their stiffnesses, N/m
    offset: Array = NO_NUMBERS  # (3,), how far all colliders are from where the system has them, m
    force: Array = NO_TABLE  # (T, n, 3), applied in each step, N


def aligned(*shape: int) -> Array:
    """Zeros whose rows of 4 or 8 numbers each lie in one cache line of 64 bytes: a row across two costs twice."""
    return staggered(1, *shape)[0]


def staggered(count: int, *shape: int) -> list[Array]:
    """Several such arrays, of which no two begin at the same place of a page of 4096 bytes.

    A processor compares the addresses of loads and pending stores by their last 12 bits: otherwise a load from one
    array would seem to wait for a store into another at the same index.
    """
    size = -(-math.prod(shape) // PAGE) * PAGE + PAGE // count // LINE * LINE
    memory = np.zeros(count * size + LINE)
    start = -(memory.ctypes.data // 8) % LINE
    begins = [start + k * size for k in range(count)]
    return [memory[begin : begin + math.prod(shape)].reshape(shape) for begin in begins]
