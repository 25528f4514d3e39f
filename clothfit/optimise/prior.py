"""What is believed of the parameters before the data: that a cloth is not far from one fabric.

In the coordinates y of a fit (log parameters), the values of one kind of one cloth scatter around their start by τ:

    penalty = Σ_groups (σ²/τ²) |P (y − y₀)|²,   P: deviation from the group's mean, so that a common factor is free

with σ² the variance of a residual. Where the data determine more than that, it does nothing; where they are noisy or
determine nothing, it keeps values near those of the group. τ is found from the data with the fit (the
evidence, with the number of well-determined parameters γ): D. J. C. MacKay, Bayesian interpolation, Neural
Computation 4, 1992. A τ that the user gives is kept, and then the mean is held to the start as well.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from clothfit.base.arrays import Array, Indices
from clothfit.base.eigen import pseudo_inverse

FIRST_TAU = 0.3
"""τ before the data have been asked, in log parameters: a third more or less."""

NARROWEST, WIDEST = 1e-3, 3.0
TAU_ROUNDS = 12  # of learning τ from one quadratic model
RIDGE = 1e-14
"""Added to the matrix, relative to its largest entry, so that what nothing determines does not stop its inversion."""
TAU_TOLERANCE = 0.02  # relative change of τ


@dataclass(frozen=True)
class Prior:
    """The belief, and how sure it is."""

    centre: Array  # y₀, (Q,)
    groups: tuple[Indices, ...]  # coordinates that scatter together
    tau: tuple[float, ...]  # one per group
    learns: bool = True  # τ from the data, the mean free
    narrowest: float = NARROWEST  # of what is learned

    def matrix(self, sigma2: float) -> Array:
        """The penalty's matrix (Q, Q): penalty = (y − y₀)ᵀ A (y − y₀)."""
        A = np.zeros((len(self.centre), len(self.centre)))
        for group, tau in zip(self.groups, self.tau, strict=True):
            A[np.ix_(group, group)] += sigma2 / tau**2 * self.spread(len(group))
        return A

    def spread(self, count: int) -> Array:
        """P (count, count)."""
        return np.eye(count) - (1.0 / count if self.learns else 0.0)

    def value(self, y: Array, sigma2: float) -> float:
        """The penalty at y (Q,)."""
        return sum(
            sigma2 / tau**2 * float((self.deviation(y, group) ** 2).sum())
            for group, tau in zip(self.groups, self.tau, strict=True)
        )

    def deviation(self, y: Array, group: Indices) -> Array:
        """P (y − y₀) of one group."""
        away = y[group] - self.centre[group]
        return np.asarray(away - away.mean() if self.learns else away)

    def between(self, other: Prior) -> Prior:
        """This prior with a τ half the way, in its logarithm, to the other's: steps of full length can overshoot."""
        return replace(self, tau=tuple(float(np.sqrt(a * b)) for a, b in zip(self.tau, other.tau, strict=True)))

    def learned(self, H: Array, g: Array, y: Array, cost: float, count: int) -> tuple[Prior, float]:
        """The prior with the τ that the data make most likely, and σ², both for the quadratic model (H, g) of the cost
        at y with `count` residuals.
        """
        prior, sigma2 = self, variance(cost, count, len(y))
        finite = np.isfinite(H).all() and np.isfinite(g).all()
        for _ in range(TAU_ROUNDS if finite and len(y) else 0):
            A = prior.matrix(sigma2)
            covariance = inverse(H + A)
            step = -covariance @ (g + A @ (y - prior.centre))
            determined = float((H * covariance).sum())  # γ = tr(H (H + A)⁻¹)
            sigma2 = variance(cost + float(2.0 * g @ step + step @ H @ step), count, determined)
            tau = prior.tau
            if self.learns:
                prior = replace(prior, tau=prior._widths(y + step, covariance, sigma2))
            if np.allclose(prior.tau, tau, rtol=TAU_TOLERANCE):
                break
        return prior, sigma2

    def _widths(self, y: Array, covariance: Array, sigma2: float) -> tuple[float, ...]:
        widths = []
        for group, tau in zip(self.groups, self.tau, strict=True):
            P, inside = self.spread(len(group)), covariance[np.ix_(group, group)]
            known = len(group) - 1.0 - sigma2 / tau**2 * float((P * inside).sum())
            away = float((self.deviation(y, group) ** 2).sum())
            widths.append(float(np.clip(np.sqrt(away / max(known, 1e-9)), self.narrowest, WIDEST)))
        return tuple(widths)


def inverse(matrix: Array) -> Array:
    """Inverse of a symmetric matrix (Q, Q) that is positive semidefinite but for rounding; NaN where the matrix holds
    what is not finite.
    """
    from scipy.linalg import lapack

    if not len(matrix) or not np.isfinite(matrix).all():  # LAPACK writes about these to standard output
        return np.full_like(matrix, np.nan)
    ridge = RIDGE * len(matrix) * np.abs(matrix).max(initial=0.0)
    lower, fault = lapack.dpotrf(matrix + ridge * np.eye(len(matrix)), lower=1)
    if fault:
        return pseudo_inverse(matrix)
    half = np.tril(lapack.dpotri(lower, lower=1)[0])
    return np.asarray(half + np.tril(half, -1).T)


def variance(cost: float, count: int, determined: float) -> float:
    """Variance σ² of a residual from the sum of squares that is left of `count` of them."""
    return max(cost, 0.0) / max(count - determined, 1.0)


def none(count: int) -> Prior:
    """No belief about `count` coordinates."""
    return Prior(np.zeros(count), (), ())


def first(centre: Array, groups: Sequence[Indices], tau: float | None) -> Prior:
    """Groups of coordinates around `centre`, with a fixed τ or (None) one that is learned."""
    kept = tuple(group for group in groups if len(group) > (1 if tau is None else 0))
    return Prior(np.array(centre), kept, (FIRST_TAU if tau is None else tau,) * len(kept), tau is None)
