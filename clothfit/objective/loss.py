"""Robust losses: how much a large residual counts, so that outliers do not decide a fit.

A group of residuals d (the gap of a vertex, say) costs C² ρ(z), z = |d|² / C². As SciPy defines them (`least_squares`),

    linear   ρ = z                          every distance counts by its square
    soft_l1  ρ = 2 (sqrt(1 + z) − 1)        … far above C by its length, with a smooth transition
    huber    ρ = z where z ≤ 1, else 2 sqrt(z) − 1      … exactly quadratic below C

The scale C, in metres, is the largest gap that is still noise. Reference: B. Triggs, P. F. McLauchlan, R. I. Hartley,
A. W. Fitzgibbon, Bundle adjustment: a modern synthesis, section 3 (2000).
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from clothfit.base.arrays import Array
from clothfit.base.errors import InvalidInput
from clothfit.base.messages import meant

LOSSES = ("linear", "soft_l1", "huber")

LOSS_SCALE = 0.01
"""C where none is given, m: ten times the noise of a good capture, far below the size of a cloth."""

SCALES = 1e-100, 1e100
"""Range of scales, m, whose squares and quotients of squares do not overflow."""


class Loss(NamedTuple):
    """One of LOSSES with its scale."""

    name: str = "linear"
    scale: float = LOSS_SCALE  # C, m

    @property
    def is_linear(self) -> bool:
        """Whether the cost is the plain sum of squares."""
        return self.name == "linear"

    def value(self, squares: Array) -> Array:
        """C² ρ of squared norms |d|², m²."""
        if self.is_linear:
            return squares
        z = squares / self.scale**2
        if self.name == "soft_l1":
            return np.asarray(2.0 * squares / (np.sqrt(1.0 + z) + 1.0))  # the same, without the difference
        return np.asarray(np.where(z <= 1.0, squares, self.scale**2 * (2.0 * np.sqrt(z) - 1.0)))

    def derivative(self, squares: Array) -> Array:
        """ρ' at squared norms |d|², m²: the derivative of `value`, between 0 and 1."""
        if self.is_linear:
            return np.ones_like(squares)
        z = squares / self.scale**2
        return np.asarray(1.0 / np.sqrt(1.0 + z if self.name == "soft_l1" else np.maximum(z, 1.0)))


def loss_named(name: str = "linear", scale: float | None = None) -> Loss:
    """The loss of that name, C in metres (default: LOSS_SCALE). Raises InvalidInput."""
    if name not in LOSSES:
        raise InvalidInput(f"loss: there is no {name!r}; use {', '.join(LOSSES)}{meant(name, LOSSES)}")
    if scale is None:
        return Loss(name)
    if name == "linear":
        raise InvalidInput("loss scale: the linear loss has none; choose the loss soft_l1 or huber with it")
    if not 0 < scale < np.inf:
        raise InvalidInput(f"loss scale must be above 0 and finite; {scale:g} m was given")
    if not SCALES[0] <= scale <= SCALES[1]:
        raise InvalidInput(f"loss scale must be within {SCALES[0]:g} … {SCALES[1]:g} m; {scale:g} m was given")
    return Loss(name, float(scale))
