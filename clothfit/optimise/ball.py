"""The minimum of a quadratic within a ball, without bounds: what each step of `bounded` solves.

    min_δ  δᵀ H δ + 2 gᵀ δ   with   |δ| ≤ radius

Parts of H that share nothing, as those of two cloths, are factorised each by itself and on two threads: their work
grows with the cube of their size.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import cached_property, partial
from typing import TypeVar

import numpy as np

from clothfit.base.arrays import Array
from clothfit.base.eigen import eigen
from clothfit.base.graph import independent
from clothfit.kernels import lapack
from clothfit.kernels.parallel import together

T = TypeVar("T")

RADIUS_ROUNDS = 20
"""Rounds of Newton's iteration for the radius."""

SINGULAR, UNSURE = 1e-13, 1e-9
"""Reciprocal conditions below which H counts as singular, and below which it hardly determines some direction."""

LARGE = 200
"""Coordinates from which on parts pay that are factorised on two threads: to begin one takes 50 µs."""


class Quadratic:
    """H (Q, Q) and g (Q,), and the parts of them that share nothing."""

    def __init__(self, H: Array, g: Array) -> None:
        self.H, self.g = H, g
        self.places = independent(H)
        alone = len(self.places) == 1
        self.blocks = [H] if alone else [H[np.ix_(own, own)] for own in self.places]
        self.parts = [g] if alone else [g[own] for own in self.places]

    @cached_property
    def factors(self) -> list[Array | None]:
        """The Cholesky factors of the blocks, lower, of any condition; None for one that has none."""
        return self.each(factorised)

    @cached_property
    def condition(self) -> float:
        """The reciprocal condition of H, roughly; 0 where it has no factor."""
        sizes, least = [norm(block) for block in self.blocks], np.inf  # of all inverses: 1 / norm
        for block, size, lower in zip(self.blocks, sizes, self.factors, strict=True):
            least = min(least, 0.0 if lower is None else size * reciprocal_condition(block, lower))
        return least / max(sizes) if least > 0 else 0.0

    @property
    def is_unsure(self) -> bool:
        """Whether H hardly determines some direction."""
        return self.condition < UNSURE

    def each(self, make: Callable[[Array], T]) -> list[T]:
        """What a function makes of each block."""
        made = [partial(make, block) for block in self.blocks]
        return together(made) if len(self.g) >= LARGE else [make() for make in made]

    def whole(self, parts: list[Array]) -> Array:
        """One vector (Q,) from those of the blocks."""
        found = np.zeros(len(self.g))
        for own, part in zip(self.places, parts, strict=True):
            found[own] = part
        return found

    def shifted(self, shift: float) -> list[Array | None]:
        """The factors of H + shift."""
        return self.each(lambda block: factorised(with_diagonal(block, shift)))

    def solved(self, factors: list[Array | None], right: list[Array]) -> list[Array] | None:
        """(L Lᵀ)⁻¹ times the parts of a vector; None where a factor is missing."""
        found = [substitute(each, own) for each, own in zip(factors, right, strict=True) if each is not None]
        return found if len(found) == len(right) else None


def within(of: Quadratic, radius: float = np.inf, ridge: float = 0.0, shift: float = 0.0) -> Array:
    """The minimum δ within a ball: (H + μ) δ = −g with the μ ≥ `shift` that makes |δ| at most the radius, to 1 %. Where
    H is singular μ is at least the `ridge`, or the directions that are rounding are left out, without one.
    """
    factors: list[Array | None] = [None] * len(of.parts)
    if shift or of.condition > SINGULAR:
        factors = of.shifted(shift) if shift else of.factors
    if 0.0 < ridge < np.inf and any(each is None for each in factors):
        factors, shift = of.shifted(ridge), ridge
    delta = of.solved(factors, of.parts)
    if delta is None:
        return within_singular(of, radius)
    for _ in range(RADIUS_ROUNDS):  # Newton's iteration on 1/|δ|, which is nearly linear in μ
        squares = sum(float(part @ part) for part in delta)
        length = float(np.sqrt(squares))
        change = of.solved(factors, delta) if length > 1.01 * radius else None
        if change is None:
            break
        shift += squares / sum(float(a @ b) for a, b in zip(delta, change, strict=True)) * (length - radius) / radius
        factors = of.shifted(shift)
        delta = of.solved(factors, of.parts) or delta
    return -of.whole(delta)


def within_singular(of: Quadratic, radius: float) -> Array:
    """As `within`, for an H that does not determine everything: by its eigenvalues, without those that are rounding."""
    found = of.each(eigen)
    known = [each for each in found if each is not None]
    if not len(of.g) or len(known) < len(found):
        return np.zeros(len(of.g))
    largest = max(values[-1] for values, _ in known)
    seen = [values > SINGULAR * largest for values, _ in known]
    vectors = [each[:, own] for (_, each), own in zip(known, seen, strict=True)]
    values = [each[own] for (each, _), own in zip(known, seen, strict=True)]
    along = [each.T @ part for each, part in zip(vectors, of.parts, strict=True)]

    def length(shift: float) -> float:
        return float(np.linalg.norm(np.concatenate([a / (v + shift) for a, v in zip(along, values, strict=True)])))

    low, high = 0.0, float(np.linalg.norm(of.g)) / radius
    if length(0.0) <= radius:
        high = 0.0
    while high > 1.01 * low:
        shift = np.sqrt(low * high) if low > 0 else 1e-3 * high
        low, high = (shift, high) if length(shift) > radius else (low, shift)
    return -of.whole([each @ (a / (v + high)) for each, a, v in zip(vectors, along, values, strict=True)])


def cholesky(H: Array) -> Array | None:
    """The Cholesky factor (Q, Q), lower; None where H is singular or not positive definite."""
    lower = factorised(H)
    return lower if lower is not None and reciprocal_condition(H, lower) > SINGULAR else None


def reciprocal_condition(H: Array, lower: Array) -> float:
    """That of H (Q, Q) by its Cholesky factor, roughly, in the norm of the largest column sum."""
    from scipy.linalg import lapack

    return float(lapack.dpocon(lower, norm(H), uplo="L")[0])


def norm(H: Array) -> float:
    """The largest column sum."""
    return float(np.abs(H).sum(axis=0).max(initial=0.0))


def factorised(H: Array) -> Array | None:
    """The Cholesky factor (Q, Q), lower, of any condition; None where there is none. Above it is what H has there."""
    if not len(H) or not np.isfinite(H).all():
        return None
    lower = np.array(H, order="F")
    return lower if lapack.factorise(lower) else None


def with_diagonal(H: Array, shift: float) -> Array:
    """H + shift (Q, Q)."""
    other = H.copy()
    np.fill_diagonal(other, H.diagonal() + shift)
    return other


def substitute(factor: Array, g: Array) -> Array:
    """(L Lᵀ)⁻¹ g."""
    from scipy.linalg import lapack

    return np.asarray(lapack.dpotrs(factor, g, lower=1)[0]) if len(g) else np.zeros(0)
