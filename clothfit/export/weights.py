"""Values of springs as weights of vertices, for tools that paint weights: a spring takes the mean of its two ends.

With the smallest and the largest value as the range, k_s ≈ low + (high − low) (w_a + w_b)/2, 0 ≤ w ≤ 1, by least
squares. A cloth has three times as many springs as vertices, so most of the variation from spring to spring is lost.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from clothfit.base.arrays import Array, Indices


class Painted(NamedTuple):
    """Weights of n vertices for the values of some springs, and how well they fit."""

    low: float  # value of weight 0
    high: float  # of weight 1
    weights: Array  # (n,), 0 … 1
    deviation: float  # |painted/value − 1|, median over the springs
    largest: float  # the largest


def painted(count: int, ends: Indices, values: Array) -> Painted | None:
    """Find the weights of `count` vertices for values at pairs of them, `ends` (S, 2); None without values."""
    if not len(values):
        return None
    low, high = float(values.min()), float(values.max())
    weights = np.zeros(count)
    if high > low:
        weights = fitted(count, ends, (values - low) / (high - low))
    made = low + (high - low) * weights[ends].mean(axis=1)
    gaps = np.abs(made - values) / np.where(values > 0, values, np.inf)
    return Painted(low, high, weights, float(np.median(gaps)), float(gaps.max()))


def fitted(count: int, ends: Indices, wanted: Array) -> Array:
    """Weights (count,) within 0 … 1 whose means at the ends are nearest to the `wanted` values, within 0 … 1."""
    from scipy.optimize import lsq_linear
    from scipy.sparse import csr_array

    rows = np.repeat(np.arange(len(wanted)), 2)
    halves = csr_array((np.full(len(rows), 0.5), (rows, ends.reshape(-1))), shape=(len(wanted), count))
    found = lsq_linear(halves, wanted, bounds=(0.0, 1.0), lsmr_tol="auto").x
    return np.clip(found, 0.0, 1.0)
