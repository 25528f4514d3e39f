"""Linear least squares with bounds, from its normal equations: the inner problem of both kinds of fit.

    min_δ  δᵀ H δ + 2 gᵀ δ   with   lower ≤ δ ≤ upper

H (Q, Q) may be singular: what it does not determine stays 0, the shortest solution. Bounds are met by block pivoting:
what leaves them is put on them and the rest is solved again; what the descent pulls back inside is let go. J. J.
Júdice, F. M. Pires, A block principal pivoting algorithm for large-scale strictly monotone linear complementarity
problems, Computers & Operations Research 21, 1994.
"""

from __future__ import annotations

import numpy as np

from clothfit.arrays import Array

ROUNDS = 20
"""Exchanges between what is free and what is at a bound; the last few only add to the latter, so they end."""


SINGULAR = 1e-13
"""Reciprocal condition below which H counts as singular."""


def solve(H: Array, g: Array, lower: Array, upper: Array, radius: float = np.inf) -> Array:
    """The minimum δ (Q,) within the bounds, and within a ball of this radius about 0 before they cut it."""
    delta, held = np.zeros(len(g)), np.zeros(len(g), bool)
    for turn in range(ROUNDS):
        free = np.flatnonzero(~held)
        part = H[np.ix_(free, free)]
        delta[free] = within(part, g[free] + H[np.ix_(free, np.flatnonzero(held))] @ delta[held], radius)
        out = (delta < lower) | (delta > upper)
        delta = np.clip(delta, lower, upper)
        slope = H @ delta + g
        back = held & (((delta <= lower) & (slope < 0)) | ((delta >= upper) & (slope > 0)))
        if turn > ROUNDS // 2:
            back[:] = False
        if not (out.any() or back.any()):
            break
        held = (held | out) & ~back
    return delta


def within(H: Array, g: Array, radius: float = np.inf) -> Array:
    """The minimum δ within a ball: (H + μ) δ = −g with the μ ≥ 0 that makes |δ| at most the radius, to 1 %."""
    factor = cholesky(H)
    if factor is None:
        return within_singular(H, g, radius)
    delta = -substitute(factor, g)
    shift = 0.0
    for _ in range(ROUNDS):  # Newton's iteration on 1/|δ|, which is nearly linear in μ
        length = float(np.linalg.norm(delta))
        if length <= 1.01 * radius:
            break
        change = -substitute(factor, delta)
        shift += length**2 / -float(delta @ change) * (length - radius) / radius
        factor = shifted(H, shift)
        delta = -substitute(factor, g)
    return delta


def cholesky(H: Array) -> Array | None:
    """The Cholesky factor (Q, Q), lower; None where H is singular or not positive definite."""
    from scipy.linalg import lapack

    lower, fault = lapack.dpotrf(H, lower=1, clean=1)
    if fault or not len(H):
        return None
    condition, _ = lapack.dpocon(lower, float(np.abs(H).sum(axis=0).max()), uplo="L")
    return lower if condition > SINGULAR else None


def shifted(H: Array, shift: float) -> Array:
    """The Cholesky factor of H + shift, which is positive definite where H is."""
    from scipy.linalg import lapack

    return np.asarray(lapack.dpotrf(H + shift * np.eye(len(H)), lower=1, clean=1)[0])


def substitute(factor: Array, g: Array) -> Array:
    """(L Lᵀ)⁻¹ g."""
    from scipy.linalg import lapack

    return np.asarray(lapack.dpotrs(factor, g, lower=1)[0])


def within_singular(H: Array, g: Array, radius: float) -> Array:
    """As `within`, for an H that does not determine everything: by its eigenvalues, without those that are rounding."""
    if not len(H):
        return np.zeros(0)
    values, vectors = np.linalg.eigh(H)
    seen = values > SINGULAR * values[-1]
    values, vectors = values[seen], vectors[:, seen]
    along = vectors.T @ g
    if np.linalg.norm(along / values) <= radius:
        return np.asarray(-vectors @ (along / values))
    low, high = 0.0, float(np.linalg.norm(g)) / radius
    while high > 1.01 * low:
        shift = np.sqrt(low * high) if low > 0 else 1e-3 * high
        low, high = (shift, high) if np.linalg.norm(along / (values + shift)) > radius else (low, shift)
    return np.asarray(-vectors @ (along / (values + high)))
