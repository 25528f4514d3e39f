"""A motion as few shapes: positions(t) ≈ base + Σ_k w_k(t) d_k, with weights within 0 … 1, to which viewers clamp them.

The displacements D (frames, 3 n) from the first frame x₀ are projected on the K leading eigenvectors U of their Gram
matrix D Dᵀ, the left singular vectors of D (Eckart and Young, Psychometrika 1, 1936): amounts a = U_K, vectors
v = U_Kᵀ D, the best that K shapes can do in the mean square. With more frames than coordinates, the eigenvectors V of
Dᵀ D take their place: a = D V_K, v = V_Kᵀ. With l_k and h_k the least and the largest amount of a shape,

    base = x₀ + Σ_k l_k v_k,      d_k = (h_k − l_k) v_k,      w_k = (a_k − l_k) / (h_k − l_k)

The sign of a vector is free: the one with |l_k| ≤ h_k keeps the base nearer to the first frame. K is the smallest
number that keeps every vertex of every frame within a tolerance, with all numbers rounded to float32 as they are
stored. The Gram matrix loses half of the digits, but only in the choice of the space: with all vectors the projection
is exact.
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
    weights: Singles  # (frames, K), within 0 … 1
    error: float  # the largest distance of a vertex from where it should be


def reduced(positions: Array, tolerance: float) -> Morphs:
    """The fewest shapes for positions (frames, n, 3) without NaN: all of them where, because of the rounding, even all
    do not come within the tolerance.
    """
    count = positions.shape[1]
    amounts, vectors = _factors((positions - positions[0]).reshape(len(positions), -1))
    least, most = amounts.min(axis=0), amounts.max(axis=0)
    turned = -least > most
    sign = np.where(turned, -1.0, 1.0)
    low, range_ = np.where(turned, -most, least), np.maximum(most - least, np.finfo(np.float32).tiny)
    vectors *= sign[:, None]
    shapes = (vectors * range_[:, None]).astype(np.float32)
    weights = np.clip((amounts * sign - low) / range_, 0.0, 1.0).astype(np.float32)

    def of(k: int) -> Morphs:
        base = (positions[0] + (low[:k] @ vectors[:k]).reshape(count, 3)).astype(np.float32)
        made = Morphs(base, shapes[:k].reshape(k, count, 3), weights[:, :k], 0.0)
        return made._replace(error=_error(positions, made))

    few, many = 0, len(shapes)  # `few` do not suffice, `many` must
    while many - few > 1:
        middle = (few + many) // 2
        few, many = (few, middle) if of(middle).error <= tolerance else (middle, many)
    return of(many)


def _factors(shift: Array) -> tuple[Array, Array]:
    """Amounts (frames, K) and vectors (K, 3 n) whose product are the displacements, the largest first."""
    frames, coordinates = shift.shape
    if frames <= coordinates:
        amounts = np.linalg.eigh(shift @ shift.T)[1][:, ::-1]
        return amounts, amounts.T @ shift
    vectors = np.linalg.eigh(shift.T @ shift)[1][:, ::-1].T.copy()
    return shift @ vectors.T, vectors


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
