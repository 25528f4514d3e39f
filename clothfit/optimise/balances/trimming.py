"""Which steps of a motion can be in balance, and how they were taken.

Few steps of a motion may not be in balance as the scene has it, whatever the parameters: those that were shortened
(`step.guard`) or taken with the clamped matrix, and Euler steps among those of BDF2. They are found by least trimmed
squares: the half of the steps that is nearest to balance is balanced again and again, until it stays the same, from all
steps and from some that follow one another, of which the best answer counts. Steps out of balance are then looked at in
the other forms that steps may have had; those that fit in none are left out.

P. J. Rousseeuw, Least median of squares regression, Journal of the American Statistical Association 79, 1984;
P. J. Rousseeuw, K. Van Driessen, Computing LTS regression for large data sets, Data Mining and Knowledge Discovery 12,
2006.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from typing import TYPE_CHECKING, Protocol

import numpy as np

from clothfit.base.arrays import Array, Flags
from clothfit.optimise import trust_region

if TYPE_CHECKING:
    from scipy.sparse import csr_array

OUT_OF_BALANCE = 10.0
"""Times the median residual of the steps from which on a step is out of balance."""

UNEVEN = 3.0
"""The same for a balance that all steps share in, so that those which are in none spoil it for the others."""

NEGLIGIBLE = 1e-8
"""Residual, relative to what masses and stiffnesses make of their columns, up to which a step is in balance however
much less the others' is: a hundred times the tolerance of the linear systems of an exact target.
"""

EXACT = 1e-6
"""The same up to which a step is in balance beside others that are."""

SHARP = 1e-3
"""The same of half of the steps, up to which they are taken for exact but for the rounding of a file, and the others
for exceptions, how many they may be: nearer than noise or another model comes.
"""

MOST_OUT = 0.25
"""Share of the steps that may be out of balance; where more are, it is not the steps that are exceptions."""

ROUNDS = 10
"""Rounds of trimming; a few suffice."""

RUNS = 6
"""Parts of the motion, of steps that follow one another, whose balances are tried as starts."""

ENOUGH = 4
"""Rows for each parameter, at least."""


class Equations(Protocol):
    """Linear equations C q = r for Q parameters, in S steps."""

    counts: Array
    """Rows of each step (S,)."""
    Q: int

    def sizes(self, q: Array) -> tuple[Array, Array]:
        """The residual of each step (S,), and Σ |C q|, its terms."""

    def gram(self, kept: Flags) -> csr_array:
        """CᵀC (Q, Q) of the kept steps."""

    def right(self, q: Array, kept: Flags) -> Array:
        """Cᵀ(r − C q) (Q,) of the kept steps."""


def trimmed(rows: Equations, known: Flags, H: trust_region.Matrix, waiting: Callable[[], None] | None = None) -> Flags:
    """The steps (S,) that can be in balance, of those that are `known`, whose CᵀC (Q, Q) is H."""
    if rows.counts[known].sum() < ENOUGH * H.shape[0]:
        return known
    q = balanced(rows, known, H)
    size, terms = rows.sizes(q)
    if size[known].max() <= NEGLIGIBLE * np.median(terms[known]):
        return known
    even = size[known].max() <= UNEVEN * np.median(size[known])  # as noise leaves it
    best, least = q, np.inf
    for start in starts(rows, known, None if even else q):
        q = start if even else nearest_half(rows, known, start)
        size, terms = rows.sizes(q)
        away = float(np.median(relative(size, terms)[known]))
        if away < least:
            best, least = q, away
        if least <= SHARP:
            break
        if waiting:
            waiting()
    if even and least > SHARP:
        return known
    return in_balance(rows, known, best)


def starts(rows: Equations, known: Flags, q: Array | None) -> Iterator[Array]:
    """Where trimming starts from: q (Q,), of all known steps, and then the balances of some that follow one another."""
    if q is not None:
        yield q
    for part in np.array_split(np.flatnonzero(known), RUNS):
        some = np.zeros(len(known), bool)
        some[part] = True
        if rows.counts[some].sum() >= ENOUGH * rows.Q:
            yield balanced(rows, some)


def nearest_half(rows: Equations, known: Flags, q: Array) -> Array:
    """The parameters (Q,) that balance the half of the steps which is nearest to balance, from q (Q,) on."""
    half: Flags = np.zeros(len(known), bool)
    for _ in range(ROUNDS):
        before, half = half, nearest(rows.sizes(q)[0], known)
        if np.array_equal(half, before):
            break
        q = balanced(rows, half)
    return q


def nearest(size: Array, known: Flags) -> Flags:
    """The half of the known steps (S,) with the least residuals (S,)."""
    return np.asarray(known & (size <= np.median(size[known])))


def in_balance(rows: Equations, known: Flags, q: Array) -> Flags:
    """Which of the known steps (S,) are in balance at q (Q,): all, where too many would not be."""
    size, terms = rows.sizes(q)
    away = relative(size, terms)
    if np.median(away[known]) <= SHARP:
        good = known & is_sharp(away, away[known])
        if good[known].mean() > 0.5:
            return np.asarray(good)
    good = known & (size <= OUT_OF_BALANCE * np.median(size[known]))
    return np.asarray(good if good[known].mean() >= 1.0 - MOST_OUT else known)


def is_sharp(away: Array, others: Array) -> Flags:
    """Which steps with residuals `away`, relative, are in balance beside others, of which most are."""
    return np.asarray(away <= max(OUT_OF_BALANCE * float(np.median(others)), EXACT))


def relative(size: Array, terms: Array) -> Array:
    """Residuals relative to their terms."""
    return np.asarray(size / np.maximum(terms, np.finfo(float).tiny))


def balanced(rows: Equations, kept: Flags, H: trust_region.Matrix | None = None) -> Array:
    """The minimum q (Q,) of |r − C q|² over some steps, without bounds."""
    G = trust_region.either(rows.gram(kept)) if H is None else H
    return trust_region.unbounded(G, rows.right(np.zeros(G.shape[0]), kept))
