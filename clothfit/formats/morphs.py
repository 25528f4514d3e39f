"""A motion as few shapes: positions(t) ≈ base + Σ_k w_k(t) d_k, the base being the first frame.

The displacements D (frames, 3 n) are projected on the K leading eigenvectors U of their Gram matrix D Dᵀ, the left
singular vectors of D (Eckart and Young, Psychometrika 1, 1936): w = U_K, d = U_Kᵀ D, the best that K shapes can do in
the mean square. With more frames than coordinates, the eigenvectors V of Dᵀ D take their place: w = D V_K, d = V_Kᵀ.
K is the smallest number that keeps every vertex of every frame within a tolerance, with all numbers rounded to float32
as they are stored. The Gram matrix loses half of the digits, but only in the choice of the space: with all vectors the
projection is exact.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from clothfit.base.arrays import Array

Singles = NDArray[np.float32]

NUMBERS_AT_ONCE = 4_000_000
"""Numbers to compare at a time."""


class Morphs(NamedTuple):
    """A base shape and others that are added to it."""

    base: Singles  # (n, 3)
    targets: Singles  # (K, n, 3), K at least 1
    weights: Singles  # (frames, K), within −1 … 1
    error: float  # the largest distance of a vertex from where it should be


def reduced(positions: Array, tolerance: float) -> Morphs:
    """The fewest shapes for positions (frames, n, 3) without NaN: all of them where, because of the rounding, even all
    do not come within the tolerance.
    """
    frames, count = positions.shape[:2]
    base = positions[0].astype(np.float32)
    shift = (positions - positions[0]).reshape(frames, -1)
    if frames <= 3 * count:
        amounts = np.linalg.eigh(shift @ shift.T)[1][:, ::-1]  # the largest first
        vectors = amounts.T @ shift
    else:
        vectors = np.linalg.eigh(shift.T @ shift)[1][:, ::-1].T
        amounts = shift @ vectors.T
    largest = np.maximum(np.abs(amounts).max(axis=0), np.finfo(np.float32).tiny)
    shapes = (vectors * largest[:, None]).astype(np.float32)
    weights = (amounts / largest).astype(np.float32)

    def off(k: int) -> float:
        return _error(positions, Morphs(base, shapes[:k].reshape(k, count, 3), weights[:, :k], 0.0))

    few, many = 0, len(shapes)  # `few` do not suffice, `many` must
    while many - few > 1:
        middle = (few + many) // 2
        few, many = (few, middle) if off(middle) <= tolerance else (middle, many)
    return Morphs(base, shapes[:many].reshape(many, count, 3), weights[:, :many], off(many))


def _error(positions: Array, morphs: Morphs) -> float:
    """The largest distance between the positions and those of the shapes."""
    targets = morphs.targets.reshape(len(morphs.targets), -1).astype(np.float64)
    step = max(NUMBERS_AT_ONCE // max(targets.shape[1], 1), 1)
    worst = 0.0
    for first in range(0, len(positions), step):
        there: Any = morphs.weights[first : first + step].astype(np.float64) @ targets
        gap = there.reshape(-1, *morphs.base.shape) + morphs.base - positions[first : first + step]
        worst = max(worst, float(np.sqrt(np.einsum("fnc,fnc->fn", gap, gap)).max(initial=0.0)))
    return worst
