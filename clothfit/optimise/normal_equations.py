"""The normal equations of a fit: H = JᵀJ and g = Jᵀr of the residuals r and their derivative J by Q coordinates.

J (N, Q) is the derivative of the residuals by the positions, sparse, times the sensitivity of the motion, dense. It
is never whole in memory: a few steps at a time, each row is added to H and g as soon as its last step has passed, in
a thread beside the sweep.
"""

from __future__ import annotations

from collections.abc import Iterator
from concurrent.futures import Future, ThreadPoolExecutor
from typing import TYPE_CHECKING, Protocol

import numpy as np

from clothfit.base.arrays import Array, Indices
from clothfit.objective.running_residuals import Passing

if TYPE_CHECKING:
    from scipy.sparse import csr_array

CHUNK = 3_000_000
"""Numbers of the sensitivity that are kept at a time."""


class Adder(Protocol):
    """What H and g are summed up in."""

    H: Array
    g: Array

    def add(self, chunk: Array, first: int, end: int) -> None:
        """Add the sensitivities ((end − first + 1) · 3 f, Q) after steps `first` to `end`; those of `first` again."""


def accumulate(
    by_position: csr_array, residual: Array, steps: Iterator[Array], size: tuple[int, int]
) -> tuple[Array, Array]:
    """H (Q, Q) and g (Q,) from ∂r/∂x (N, T · 3 f), r (N,) and the sensitivities (3 f, Q) after each of T steps.

    `size` is (3 f, Q).
    """
    return summed(Sums(by_position, residual, size), steps, size, by_position.shape[1] // max(size[0], 1))


def accumulate_passing(passing: Passing, steps: Iterator[Array], size: tuple[int, int]) -> tuple[Array, Array]:
    """The same for squared distances, whose residuals are told in passing: by `steps`, while they go on."""
    return summed(PassingSums(passing, size), steps, size, passing.steps)


def chunk_steps(wide: int) -> int:
    """Steps of the sensitivity that are kept at a time, of so many numbers each."""
    return max(1, CHUNK // max(wide, 1))


def summed(sums: Adder, steps: Iterator[Array], size: tuple[int, int], total: int) -> tuple[Array, Array]:
    """H and g, from so many steps."""
    rows, count = size
    length = chunk_steps(rows * count)
    before = np.zeros(size)
    with ThreadPoolExecutor(1) as pool:
        adding: Future[None] | None = None
        for first in range(0, total, length):
            end = min(first + length, total)
            chunk = np.empty((end - first + 1, rows, count))
            chunk[0] = before
            for t in range(1, len(chunk)):
                chunk[t] = next(steps)
            before = chunk[-1].copy()
            if adding is not None:
                adding.result()
            adding = pool.submit(sums.add, chunk.reshape(-1, count), first, end)
        if adding is not None:
            adding.result()
    return sums.H, sums.g


class PassingSums:
    """H and g of what has passed."""

    def __init__(self, passing: Passing, size: tuple[int, int]) -> None:
        self.passing, count = passing, size[1]
        self.H, self.g = np.zeros((count, count)), np.zeros(count)

    def add(self, chunk: Array, first: int, end: int) -> None:
        """Add the residuals that can be told after steps `first` + 1 to `end`."""
        by_position, residual = self.passing.rows(first, end)
        block = by_position @ chunk
        self.H += block.T @ block
        self.g += block.T @ residual


class Sums:
    """H and g so far, and the rows whose last step has not passed."""

    def __init__(self, by_position: csr_array, residual: Array, size: tuple[int, int]) -> None:
        """As `accumulate`."""
        self.rows, count = size
        self.H, self.g = np.zeros((count, count)), np.zeros(count)
        self.residual, self.columns = residual, by_position.tocsc()
        self.last = last_step(by_position, self.rows)
        self.open, self.block = np.zeros(0, np.int64), np.zeros((0, count))

    def add(self, chunk: Array, first: int, end: int) -> None:
        """Add the sensitivities ((end − first + 1) · 3 f, Q) after steps `first` to `end`; those of `first` again."""
        chunk = chunk[self.rows :]
        part = self.columns[:, first * self.rows : end * self.rows].tocsr()
        touched = np.union1d(self.open, np.flatnonzero(np.diff(part.indptr)))
        block = part[touched] @ chunk
        block[np.searchsorted(touched, self.open)] += self.block
        done = self.last[touched] < end
        ready = block if done.all() else block[done]
        self.H += ready.T @ ready  # of one array, so that only half of the products are computed
        self.g += ready.T @ self.residual[touched[done]]
        self.open, self.block = touched[~done], block[~done]


def last_step(by_position: csr_array, rows: int) -> Indices:
    """The last step (N,) that each residual depends on; −1 for none."""
    entries = by_position.tocoo()
    last = np.full(by_position.shape[0], -1, np.int32)
    np.maximum.at(last, entries.coords[0], (entries.coords[1] // max(rows, 1)).astype(np.int32))
    return last
