"""Linear least squares with bounds, from its normal equations: the inner problem of both kinds of fit.

    min_δ  δᵀ H δ + 2 gᵀ δ   with   lower ≤ δ ≤ upper

H (Q, Q) may be singular: what it does not determine stays 0, the shortest solution. Bounds are met by projected Newton
steps: a coordinate that the derivative presses against its bound is held, the others are solved, and the bounds cut
the step. Every step lowers the value, so even where the steps end early the result is no worse than δ = 0. They end
where the same coordinates are held again and the value is no lower: H is singular, and rounding moves them in turn.
Where the bounds cut away most of what a step promised and H hardly determines some direction, the rounding of g makes a
long way along it: steps are then made shorter by more on the diagonal. `within` solves for each step.
The eigenvalues of a singular H are taken once, for the first step: they take twenty times as long as the factor of
H + ridge, which is as good for a step that the bounds will cut. A sparse H always has a ridge.

Raises what `interrupts.check` raises, between two steps.

D. P. Bertsekas, Projected Newton methods for optimization problems with simple constraints, SIAM Journal on Control
and Optimization 20, 1982.

The minimum of a quadratic within a ball, without bounds: what each step of `solve` solves.

    min_δ  δᵀ H δ + 2 gᵀ δ   with   |δ| ≤ radius

Parts of H that share nothing, as those of two cloths, are factorised each by itself and on two threads: their work
grows with the cube of their size.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from functools import cached_property, partial
from typing import TYPE_CHECKING, Any, TypeVar

import numpy as np

from clothfit.base import interrupts
from clothfit.base.arrays import Array, Flags
from clothfit.base.eigen import eigen, independent
from clothfit.kernels import lapack
from clothfit.optimise.evidence import at_once

if TYPE_CHECKING:
    from scipy.sparse import csr_array

    Matrix = Array | csr_array
    """Symmetric (Q, Q), dense or sparse."""

T = TypeVar("T")

RADIUS_ROUNDS = 20
"""Rounds of Newton's iteration for the radius."""

SINGULAR, UNSURE = 1e-13, 1e-9
"""Reciprocal conditions below which H counts as singular, and below which it hardly determines some direction."""


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
        return at_once([partial(make, block) for block in self.blocks], len(self.g))

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
    known = [each for each in of.each(eigen) if each is not None]
    if not len(of.g) or len(known) < len(of.blocks):
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


STEPS = 100
"""Projected steps; a handful suffices, except where many bounds hold strongly coupled coordinates."""

HALVINGS = 40
"""Halvings of a step that the bounds cut, until it lowers the value."""

ROUNDING = 1e-12
"""Relative decrease of the value below which the same coordinates are not held a second time: steps go in circles."""

RIDGE = 1e-12
"""Added to the diagonal of a singular H, relative to its trace: above the rounding of H, and below what it shows."""

EIGENVALUES = 3000
"""Coordinates above which a singular H has its ridge from the first step on: eigenvalues would take minutes."""

SPARSE = 1500
"""Coordinates from which on a sparse H is factored as such."""

KEPT, SHIFTS = 0.5, (1e-10, 1e-8, 1e-6)
"""The least part of what a step promised that is left where the bounds cut it; else, where H hardly determines some
direction, what is added to the diagonal, relative to its largest entry.
"""

PATIENCE = 2.0
"""Seconds after which `waiting` is called, between two steps."""


def either(H: csr_array) -> Matrix:
    """A sparse H, dense where that is small enough or hardly less."""
    size = H.shape[0]
    return H if size > SPARSE and H.nnz < 0.1 * size * size else H.toarray()


@np.errstate(invalid="ignore")  # what is not finite ends the search, and some processors warn of it
def solve(
    H: Matrix,
    g: Array,
    lower: Array,
    upper: Array,
    radius: float = np.inf,
    waiting: Callable[[], None] | None = None,
) -> Array:
    """The minimum δ (Q,) within the bounds, and within a ball of this radius about 0 before they cut it. A solution
    that takes long calls `waiting` now and then.
    """
    delta = np.clip(np.zeros(len(g)), lower, upper)
    held = pressed(H, g, lower, upper, delta)
    reached: dict[bytes, float] = {}  # the value where these were held
    least = RIDGE * float(H.diagonal().sum())
    ridge, reported = least if len(g) > EIGENVALUES else 0.0, time.monotonic()
    shift, shifts = 0.0, list(SHIFTS if isinstance(H, np.ndarray) else ())
    for _ in range(STEPS):
        interrupts.check()  # thousands of values take seconds a step
        if waiting and time.monotonic() - reported >= PATIENCE:
            waiting()
            reported = time.monotonic()
        value = quadratic(H, g, delta)
        if value >= reached.get(held.tobytes(), np.inf) - ROUNDING * abs(value):
            break
        reached[held.tobytes()] = value
        free, rest = np.flatnonzero(~held), np.flatnonzero(held)
        target = delta.copy()
        if isinstance(H, np.ndarray):
            inner = Quadratic(H[np.ix_(free, free)], g[free] + H[np.ix_(free, rest)] @ delta[rest])
            target[free] = within(inner, radius, ridge, shift)
        else:
            target[free] = unbounded(H[free][:, free], -g[free] - H[free][:, rest] @ delta[rest])
        inside = bool(((target >= lower) & (target <= upper)).all())
        new = target if inside else downwards(H, g, lower, upper, delta, target)
        saved = value - (value if new is None else quadratic(H, g, new))
        if shifts and not inside and saved < KEPT * (value - quadratic(H, g, target)) and (shift or inner.is_unsure):
            shift, new = shifts.pop(0) * float(H.diagonal().max()), delta if new is None else new
            reached.clear()
        if new is None:
            break
        delta, held = new, pressed(H, g, lower, upper, new)
        if inside and held[rest].all():
            break
        ridge = least
    return delta


def pressed(H: Matrix, g: Array, lower: Array, upper: Array, delta: Array) -> Flags:
    """Which coordinates (Q,) lie at a bound and would leave it outwards."""
    derivative = H @ delta + g
    return np.asarray(((delta <= lower) & (derivative >= 0)) | ((delta >= upper) & (derivative <= 0)))


def downwards(H: Matrix, g: Array, lower: Array, upper: Array, delta: Array, target: Array) -> Array | None:
    """The best of the points on the way to `target`, cut by the bounds, among the halvings around the first that is
    lower; None where none is.
    """
    way, value, best = target - delta, quadratic(H, g, delta), None
    for k in range(HALVINGS):
        new = np.clip(delta + 0.5**k * way, lower, upper)
        reached = quadratic(H, g, new)
        if reached < value:
            value, best = reached, new
        elif best is not None:
            break
    return best


def quadratic(H: Matrix, g: Array, delta: Array) -> float:
    """δᵀ H δ + 2 gᵀ δ."""
    return float(delta @ (H @ delta + 2.0 * g))


def unbounded(H: Matrix, right: Array) -> Array:
    """H⁻¹ times a vector (Q,); see `inverse`."""
    return inverse(H)(right)


def inverse(H: Matrix) -> Callable[[Array], Array]:
    """What makes H⁻¹ b of vectors b (Q,), with a little on the diagonal that makes a singular H regular; 0 where a
    sparse H has numbers that are not finite.
    """
    if isinstance(H, np.ndarray):
        tiny = RIDGE * float(H.diagonal().max(initial=0.0)) + np.finfo(float).tiny
        lower = factorised(with_diagonal(H, tiny))
        return np.zeros_like if lower is None else partial(substitute, lower)
    from scipy.sparse import diags_array
    from scipy.sparse.linalg import splu

    if not np.isfinite(H.data).all():
        return np.zeros_like
    size = H.diagonal()
    scale = 1.0 / np.sqrt(np.where(size > 0, size, 1.0))
    regular = (diags_array(scale) @ H @ diags_array(scale) + diags_array(np.where(size > 0, RIDGE, 1.0))).tocsc()
    options: dict[str, Any] = {"diag_pivot_thresh": 0.0, "options": {"SymmetricMode": True}}
    try:
        factor = splu(regular, permc_spec="MMD_AT_PLUS_A", **options)
    except RuntimeError:  # rounding of entries that differ by many orders of magnitude: exactly singular
        return np.zeros_like
    return lambda right: np.asarray(scale * factor.solve(scale * right))
