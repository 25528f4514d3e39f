"""Linear least squares with bounds, from its normal equations: the inner problem of both kinds of fit.

    min_δ  δᵀ H δ + 2 gᵀ δ   with   lower ≤ δ ≤ upper

H (Q, Q) may be singular: what it does not determine stays 0, the shortest solution. Bounds are met by projected Newton
steps: a coordinate that the derivative presses against its bound is held, the others are solved, and the bounds cut
the step. Every step lowers the value, so even where the steps end early the result is no worse than δ = 0. They end
where the same coordinates are held again and the value is no lower: H is singular, and rounding moves them in turn.
Where the bounds cut away most of what a step promised and H hardly determines some direction, the rounding of g makes a
long way along it: steps are then made shorter by more on the diagonal. `ball` solves for each step.
The eigenvalues of a singular H are taken once, for the first step: they take twenty times as long as the factor of
H + ridge, which is as good for a step that the bounds will cut. A sparse H always has a ridge.

Raises what `interrupts.check` raises, between two steps.

D. P. Bertsekas, Projected Newton methods for optimization problems with simple constraints, SIAM Journal on Control
and Optimization 20, 1982.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from typing import TYPE_CHECKING, Any

import numpy as np

from clothfit.base import interrupts
from clothfit.base.arrays import Array, Flags
from clothfit.optimise import ball

if TYPE_CHECKING:
    from scipy.sparse import csr_array

    Matrix = Array | csr_array
    """Symmetric (Q, Q), dense or sparse."""

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
    ridge, told = least if len(g) > EIGENVALUES else 0.0, time.monotonic()
    shift, shifts = 0.0, list(SHIFTS if isinstance(H, np.ndarray) else ())
    for _ in range(STEPS):
        interrupts.check()  # thousands of values take seconds a step
        if waiting and time.monotonic() - told >= PATIENCE:
            waiting()
            told = time.monotonic()
        value = quadratic(H, g, delta)
        if value >= reached.get(held.tobytes(), np.inf) - ROUNDING * abs(value):
            break
        reached[held.tobytes()] = value
        free, rest = np.flatnonzero(~held), np.flatnonzero(held)
        target = delta.copy()
        if isinstance(H, np.ndarray):
            inner = ball.Quadratic(H[np.ix_(free, free)], g[free] + H[np.ix_(free, rest)] @ delta[rest])
            target[free] = ball.within(inner, radius, ridge, shift)
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
    """H⁻¹ times a vector (Q,), with a little on the diagonal that makes a singular H regular; 0 where a sparse H has
    numbers that are not finite.
    """
    if isinstance(H, np.ndarray):
        tiny = RIDGE * float(H.diagonal().max(initial=0.0)) + np.finfo(float).tiny
        lower = ball.factorised(ball.with_diagonal(H, tiny))
        return np.zeros(len(right)) if lower is None else ball.substitute(lower, right)
    from scipy.sparse import diags_array
    from scipy.sparse.linalg import splu

    if not np.isfinite(H.data).all():
        return np.zeros(len(right))
    size = H.diagonal()
    scale = 1.0 / np.sqrt(np.where(size > 0, size, 1.0))
    regular = (diags_array(scale) @ H @ diags_array(scale) + diags_array(np.where(size > 0, RIDGE, 1.0))).tocsc()
    options: dict[str, Any] = {"diag_pivot_thresh": 0.0, "options": {"SymmetricMode": True}}
    try:
        factor = splu(regular, permc_spec="MMD_AT_PLUS_A", **options)
    except RuntimeError:  # rounding of entries that differ by many orders of magnitude: exactly singular
        return np.zeros(len(right))
    return np.asarray(scale * factor.solve(scale * right))
