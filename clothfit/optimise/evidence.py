"""The widths of a prior that make the data most likely, from the quadratic model of a cost.

Near a point y the cost is |Lᵀ (y' − y) + b|² + c, with H = L Lᵀ and L b = g. The true values y' therefore show as data
d = Lᵀ (y' − y₀) with noise of the variance σ² of a residual. Where these values are X m + Σₖ Bₖ uₖ with free m and
uₖ ~ N(0, τₖ²), the data have the covariance

    S = σ² + Σₖ τₖ² Zₖ Zₖᵀ,   Zₖ = Lᵀ Bₖ

beside the free part Lᵀ X m. With that integrated out (H. D. Patterson, R. Thompson, Recovery of inter-block information
when block sizes are unequal, Biometrika 58, 1971) and P = S⁻¹ − S⁻¹ X (Xᵀ S⁻¹ X)⁻¹ Xᵀ S⁻¹, the most likely τₖ² satisfy
|Zₖᵀ P d|² = tr Zₖᵀ P Zₖ; their ratio is a factor that leads there (D. J. C. MacKay, Bayesian interpolation, Neural
Computation 4, 1992). σ² is what is left, divided by the number of residuals that the values do not take up.

Q values, r directions that the data show, N residuals.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial
from typing import NamedTuple, TypeVar

import numpy as np
from numpy.typing import NDArray

from clothfit.base.arrays import Array
from clothfit.base.eigen import independent, pseudo_inverse
from clothfit.kernels import lapack
from clothfit.kernels.parallel import together

T = TypeVar("T")

CHANGE = 0.02
"""Relative change of the widths, and of σ², that ends the search for them."""

WIDE = 3
"""A pattern of more than this part of as many coordinates as there are data is taken by its ZₖZₖᵀ."""

RIDGE = 1e-14
"""Added to a matrix, relative to its largest entry, so that what nothing determines does not stop its inversion."""

LARGE = 200
"""Data, or rows, from which on parts are taken on two threads: to begin one takes 50 µs."""

UNSEEN = 1e-3
"""What the data add to the precision of a value, relative to that of the widest prior, that is left out."""


@dataclass(frozen=True)
class Seen:
    """A quadratic model as data."""

    L: Array  # (Q, r), H = L Lᵀ but for what the data hardly show
    data: Array  # (r,), those of the way from the point of the model to the truth, Lᵀ (y' − y)
    rest: float  # c

    @classmethod
    def of(cls, H: Array, g: Array, cost: float, count: int, widest: float) -> Seen | None:
        """That of H (Q, Q), g (Q,) and a cost of `count` residuals beside values that scatter by `widest` at most, by a
        Cholesky factorisation that takes what is best known first; None where nothing is.
        """
        from scipy.linalg import solve_triangular
        from scipy.linalg.lapack import dpstrf

        least = RIDGE * len(H) * float(np.abs(H).max(initial=0.0))
        parts = list[tuple[NDArray[np.intp], Array, Array]]()
        for own in independent(H):
            factor, pivots, rank, fault = dpstrf(H[np.ix_(own, own)], tol=least, lower=1)
            if fault >= 0 and rank:
                order, triangle = own[pivots - 1], np.tril(factor)[:, :rank]
                parts.append((order, triangle, solve_triangular(triangle[:rank], g[order[:rank]], lower=True)))
        if not parts:
            return None
        b = np.concatenate([own for _, _, own in parts])
        noise, columns, data = variance(cost - float(b @ b), count, len(b)), list[Array](), list[Array]()
        for order, triangle, shown in parts:
            left = np.cumsum((triangle**2)[:, ::-1], axis=1)[:, ::-1].max(axis=0)  # of the diagonal, before each column
            rank = max(int((left > UNSEEN * noise / widest**2).sum()), 1)
            columns.append(np.zeros((len(H), rank)))
            columns[-1][order] = triangle[:, :rank]
            data.append(-shown[:rank])
        known = np.concatenate(data)
        return cls(np.concatenate(columns, axis=1), known, max(cost - float(known @ known), 0.0))


def most_likely(
    seen: Seen, effects: Sequence[Array], free: Array, count: int, tau: Array, sigma2: float,
    ends: tuple[Array, float], doubts: Array, rounds: int,
) -> tuple[Array, float]:  # fmt: skip
    """The widths (K,) between their ends and σ², after so many rounds from those before. `effects` are Zₖ (r, ·),
    `free` is Lᵀ X (r, ·), `count` is N; `doubts` (K,) in a pattern lower the logarithm of the likelihood by that times
    log τₖ.
    """
    parts = separate(seen.data, effects, free)
    for _ in range(rounds):
        found, expected, determined, left = np.zeros(len(tau)), np.zeros(len(tau)), 0.0, seen.rest
        sums = at_once([partial(part.sums, tau, sigma2) for part in parts], len(seen.data))
        for part, own in zip(parts, sums, strict=True):
            found[part.which] += own.found
            expected[part.which] += own.expected
            determined, left = determined + own.determined, left + own.left
        before, ratio = (tau, sigma2), found / np.maximum(expected + doubts / tau**2, np.finfo(float).tiny)
        tau = np.clip(tau * np.sqrt(ratio), *ends)
        sigma2 = variance(left, count, determined)
        if np.allclose(before[0], tau, rtol=CHANGE) and np.isclose(before[1], sigma2, rtol=CHANGE, atol=0.0):
            break
    return tau, sigma2


class Round(NamedTuple):
    """What some of the data say of the widths."""

    found: Array  # (K,), |Zₖᵀ P d|²
    expected: Array  # (K,), tr Zₖᵀ P Zₖ
    determined: float  # directions that the values take up
    left: float  # |σ² P d|²


class Part:
    """Data that share no value and no width with others, as those of cloths that do not touch."""

    def __init__(self, data: Array, which: NDArray[np.intp], effects: Sequence[Array], free: Array) -> None:
        """`data` (r,), `which` (K,) of all widths, their Zₖ (r, ·), and Lᵀ X (r, ·)."""
        self.data, self.which, self.free = data, which, free
        self.wide = [k for k, Z in enumerate(effects) if Z.shape[1] * WIDE > len(data)]
        narrow = [k for k in range(len(effects)) if k not in self.wide]
        self.squares = [effects[k] @ effects[k].T for k in self.wide]
        self.narrow = np.concatenate([np.zeros((len(data), 0)), *(effects[k] for k in narrow)], axis=1)
        self.of = np.repeat(np.array(narrow, int), [effects[k].shape[1] for k in narrow])
        self.whole = [effects[k] for k in self.wide]

    def sums(self, tau: Array, sigma2: float) -> Round:
        """With widths, of all, and σ²."""
        tau, d = tau[self.which], self.data
        shared = self.narrow * tau[self.of]
        S = shared @ shared.T
        for k, G in zip(self.wide, self.squares, strict=True):
            S += tau[k] ** 2 * G
        S.flat[:: len(d) + 1] += sigma2
        P = inverse(S)
        along = P @ self.free
        P -= along @ inverse(self.free.T @ along) @ along.T
        left, found, expected = P @ d, np.zeros(len(tau)), np.zeros(len(tau))
        np.add.at(found, self.of, (left @ self.narrow) ** 2)
        np.add.at(expected, self.of, ((P @ self.narrow) * self.narrow).sum(axis=0))
        for k, Z, G in zip(self.wide, self.whole, self.squares, strict=True):
            found[k], expected[k] = ((left @ Z) ** 2).sum(), np.vdot(P, G)
        return Round(found, expected, len(d) - sigma2 * float(np.trace(P)), sigma2**2 * float(left @ left))


def separate(data: Array, effects: Sequence[Array], free: Array) -> list[Part]:
    """Data (r,) with their Zₖ (r, ·) and Lᵀ X (r, ·), apart where they share nothing."""
    from scipy.sparse import coo_array
    from scipy.sparse.csgraph import connected_components

    r, K = len(data), len(effects)
    acts = np.column_stack([np.zeros((r, 0)), *((Z != 0).any(axis=1) for Z in effects), free != 0]).astype(bool)
    rows, columns = np.nonzero(acts)
    graph = coo_array((np.ones(len(rows)), (rows, r + columns)), shape=(r + acts.shape[1],) * 2)
    count, label = connected_components(graph, directed=False)
    parts = []
    for i in range(count):
        own = np.flatnonzero(label[:r] == i)
        if len(own):
            which, beside = np.flatnonzero(label[r : r + K] == i), np.flatnonzero(label[r + K :] == i)
            parts.append(Part(data[own], which, [effects[int(k)][own] for k in which], free[np.ix_(own, beside)]))
    return parts


def at_once(made: Sequence[Callable[[], T]], size: int) -> list[T]:
    """What functions without arguments make of the parts of a problem of this size, on two threads where that pays."""
    return together(made) if size >= LARGE else [each() for each in made]


def inverse(matrix: Array) -> Array:
    """Inverse of a symmetric matrix (Q, Q) that is positive semidefinite but for rounding; NaN where the matrix holds
    what is not finite.
    """
    size = float(max(matrix.max(initial=0.0), -matrix.min(initial=0.0)))
    if not len(matrix) or not np.isfinite(size):
        return np.full_like(matrix, np.nan)
    ridge, parts = RIDGE * len(matrix) * size, independent(matrix)
    if len(parts) == 1:
        return inverse_of_part(matrix, ridge)
    found = np.zeros_like(matrix)
    made = at_once([partial(inverse_of_part, matrix[np.ix_(own, own)], ridge) for own in parts], len(matrix))
    for own, part in zip(parts, made, strict=True):
        found[np.ix_(own, own)] = part
    return found


def inverse_of_part(matrix: Array, ridge: float) -> Array:
    """The same of what is finite, with so much more on its diagonal."""
    lower = np.array(matrix, order="F")
    lower.flat[:: len(matrix) + 1] += ridge
    if not lapack.factorise(lower):
        return pseudo_inverse(matrix)
    lapack.invert(lower)
    half = np.tril(lower)
    half += np.tril(half, -1).T
    return half


def variance(cost: float, count: int, determined: float) -> float:
    """Variance σ² of a residual from the sum of squares that is left of `count` of them."""
    return max(cost, 0.0) / max(count - determined, 1.0)
