"""First guesses for a series of linear solves: the polynomial through the last solutions, one step on.

A motion is smooth, so the next solution lies near. With the backward differences ∇⁰x = x, ∇ᵏ⁺¹x = ∇ᵏx − (∇ᵏx one step
before), the polynomial through the last K solutions gives the guess ∇⁰x + … + ∇ᴷ⁻¹x, and the same rule one step
earlier was wrong by ∇ᴷx. So the differences say themselves how many of them to add: as many as would have been best for
the newest solution. Where solutions jump or are noisy, that is the last one alone. The answer stays within the
tolerance whatever the guess.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from clothfit.base.arrays import Array, aligned
from clothfit.kernels.kernel import kernel
from clothfit.kernels.lanes.operations import add, fma, load3, load4, store3, store4, sub, sum3

TERMS = 6
"""Differences that a guess may be the sum of: more gain little at tolerances of 1e-5 to 1e-10."""


class Past(NamedTuple):
    """What is kept of the solutions so far."""

    differences: Array  # (TERMS · n, 4), ∇⁰x, ∇¹x … of the newest solution, one after the other
    sizes: Array  # (TERMS + 1, 4), scratch: squares of each, summed over the vertices


def past(n: int) -> Past:
    """Memory for solutions of n vertices."""
    return Past(aligned(TERMS * n, 4), aligned(TERMS + 1, 4))


@kernel
def next_guess(past, count, x):
    """Take the newest solution from x and replace it by a guess of the next; `count` solutions were found so far."""
    if count == 0:
        x[:] = 0.0
        return
    update(past, x)
    terms = useful(past.sizes, count)
    n = len(x)
    for i in range(n):
        total = load4(past.differences, i)
        for k in range(1, terms):
            total = add(total, load4(past.differences, k * n + i))
        store3(total, x, i)


@kernel
def update(past, x):
    """Make the differences those of the new solution x (n, 3)."""
    differences, sizes, n = past.differences, past.sizes, len(x)
    sizes[:] = 0.0
    for i in range(n):
        new = load3(x, i)
        for k in range(TERMS):
            store4(fma(new, new, load4(sizes, k)), sizes, k)
            old = load4(differences, k * n + i)
            store4(new, differences, k * n + i)
            new = sub(new, old)
        store4(fma(new, new, load4(sizes, TERMS)), sizes, TERMS)


@kernel
def useful(sizes, count):
    """How many differences to add: those that would have guessed the newest of `count` solutions best.

    ∇ᵏ takes k + 1 solutions. The longest rule whose error is known is taken one further where it is the best.
    """
    known = min(count - 1, TERMS)
    best, least = 1, np.inf
    for k in range(1, known + 1):
        size = sum3(load4(sizes, k))
        if size < least:
            best, least = k, size
    return count if best >= known and count <= TERMS else best
