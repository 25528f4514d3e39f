"""The normal equations of a fit: H = JᵀJ and g = Jᵀr of the residuals r and their derivative J by Q coordinates.

J (N, Q) is the derivative of the residuals by the positions, sparse, times the sensitivity of the motion, dense. It
is never whole in memory: a few steps at a time, each row is added to H and g as soon as its last step has passed, in
a thread beside the sweep.
"""

from __future__ import annotations

from collections.abc import Iterator
from concurrent.futures import Future, ThreadPoolExecutor

import numpy as np

from clothfit.base.arrays import Array
from clothfit.objective.running_residuals import Residuals

CHUNK = 3_000_000
"""Numbers of the sensitivity that are kept at a time."""


def chunk_steps(wide: int) -> int:
    """Steps of the sensitivity that are kept at a time, of so many numbers each."""
    return max(1, CHUNK // max(wide, 1))


class Scores:
    """What each step of a motion adds to H and g, and how strongly it depends on the coordinates."""

    def __init__(self, by_step: bool) -> None:
        """`by_step`: H and g are kept, of each step that completes residuals."""
        self.by_step = by_step
        self.information: list[Array] = []  # JᵀJ (Q, Q) of the residuals that a step completes
        self.parts: list[Array] = []  # Jᵀr (Q,) of the same
        self.sizes: list[float] = []  # norm of dX after each step

    def add(self, J: Array, r: Array, dX: Array) -> None:
        """Take the residuals r (R,) that the next steps complete, their J (R, Q), and the sensitivities
        (steps, 3 f, Q) after these steps.
        """
        if self.by_step and len(r):
            self.information.append(J.T @ J)
            self.parts.append(J.T @ r)
        self.sizes += [float(np.linalg.norm(each)) for each in dX]


def accumulate(
    residuals: Residuals, steps: Iterator[Array], before: Array, scores: Scores | None = None
) -> tuple[Array, Array]:
    """H (Q, Q) and g (Q,) from the residuals and the sensitivities (3 f, Q) `before` the first and after each of their
    T steps. `scores` takes what each step adds.
    """
    rows, count = before.shape
    length = 1 if scores is not None and scores.by_step else chunk_steps(rows * count)
    H, g = np.zeros((count, count)), np.zeros(count)

    def add(sensitivity: Array, first: int, end: int) -> None:
        J, r = residuals.rows(sensitivity, first, end)
        H[:] += J.T @ J  # of one array, so that only half of the products are computed
        g[:] += J.T @ r
        if scores is not None:
            scores.add(J, r, sensitivity.reshape(-1, rows, count)[1:])

    with ThreadPoolExecutor(1) as pool:
        adding: Future[None] | None = None
        for first in range(0, residuals.steps, length):
            end = min(first + length, residuals.steps)
            chunk = np.empty((end - first + 1, rows, count))
            chunk[0] = before
            for t in range(1, len(chunk)):
                chunk[t] = next(steps)
            before = chunk[-1].copy()
            if adding is not None:
                adding.result()
            adding = pool.submit(add, chunk.reshape(-1, count), first, end)
        if adding is not None:
            adding.result()
    return H, g
