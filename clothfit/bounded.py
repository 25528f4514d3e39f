"""Linear least squares with bounds, from its normal equations: the inner problem of both kinds of fit.

    min_δ  δᵀ H δ + 2 gᵀ δ   with   lower ≤ δ ≤ upper

H (Q, Q) may be singular: what it does not determine stays 0, the shortest solution. Bounds are met by block pivoting:
what leaves them is put on them and the rest is solved again; what the descent pulls back inside is let go. J. J.
Júdice, F. M. Pires, A block principal pivoting algorithm for large-scale strictly monotone linear complementarity
problems, Computers & Operations Research 21, 1994.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from clothfit.arrays import Array, Flags

ROUNDS = 20
"""Exchanges between what is free and what is at a bound; the last few only add to the latter, so they end."""


class Spectrum(NamedTuple):
    """Eigenvalues (Q,), ascending, and eigenvectors (Q, Q) of the part of H that is free."""

    values: Array
    vectors: Array
    rank: int  # eigenvalues above rounding

    def solve(self, g: Array, shift: float = 0.0) -> Array:
        """The shortest δ with (H + shift) δ = −g, without the directions that H does not determine."""
        seen = slice(len(self.values) - self.rank, None)
        along = (self.vectors[:, seen].T @ g) / (self.values[seen] + shift)
        return np.asarray(-self.vectors[:, seen] @ along)


def spectrum(H: Array, epsilon: float = 1e-15) -> Spectrum:
    """Decompose H, symmetric; eigenvalues below epsilon · Q of the largest count as 0."""
    values, vectors = np.linalg.eigh(H) if len(H) else (np.zeros(0), np.zeros((0, 0)))
    floor = epsilon * max(len(values), 1) * values.max(initial=0.0)
    return Spectrum(values, vectors, int((values > floor).sum()))


def solve(H: Array, g: Array, lower: Array, upper: Array, radius: float = np.inf) -> Array:
    """The minimum δ (Q,) within the bounds, and within a ball of this radius about 0 before they cut it."""
    delta, held = np.zeros(len(g)), np.zeros(len(g), bool)
    for turn in range(ROUNDS):
        free = np.flatnonzero(~held)
        part = spectrum(H[np.ix_(free, free)])
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


def within(part: Spectrum, g: Array, radius: float) -> Array:
    """The minimum within a ball: (H + μ) δ = −g with the μ ≥ 0 that makes |δ| the radius, to 1 %."""
    delta = part.solve(g)
    if np.linalg.norm(delta) <= radius:
        return delta
    low, high = 0.0, float(np.linalg.norm(g)) / radius
    while high > 1.01 * low:
        shift = np.sqrt(low * high) if low > 0 else 1e-3 * high
        delta = part.solve(g, shift)
        low, high = (shift, high) if np.linalg.norm(delta) > radius else (low, shift)
    return part.solve(g, high)


def active(p: Array, g: Array, lower: Array, upper: Array) -> Flags:
    """Which coordinates (Q,) are at a bound that the descent −g does not leave."""
    return np.asarray(((p <= lower) & (g > 0)) | ((p >= upper) & (g < 0)))
