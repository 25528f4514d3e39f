"""The normal equations of a fit: H = JᵀJ and g = Jᵀr of the residuals r and their derivative J by Q coordinates.

J (N, Q) is the derivative of the residuals by the positions, sparse, times the sensitivity of the motion, dense. It
is never whole in memory: a few steps at a time, each row is added to H and g as soon as its last step has passed.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import TYPE_CHECKING

import numpy as np

from clothfit.arrays import Array, Indices

if TYPE_CHECKING:
    from scipy.sparse import csr_array

CHUNK = 3_000_000
"""Numbers of the sensitivity that are kept at a time."""


def accumulate(
    by_position: csr_array, residual: Array, steps: Iterator[Array], size: tuple[int, int]
) -> tuple[Array, Array]:
    """H (Q, Q) and g (Q,) from ∂r/∂x (N, T · 3 f), r (N,) and the sensitivities (3 f, Q) after each of T steps.

    `size` is (3 f, Q).
    """
    rows, count = size
    H, g = np.zeros((count, count)), np.zeros(count)
    length = max(1, CHUNK // max(rows * count, 1))
    total = by_position.shape[1] // max(rows, 1)
    last = last_step(by_position, rows)
    columns = by_position.tocsc()
    open_rows, open_block = np.zeros(0, np.int64), np.zeros((0, count))
    for first in range(0, total, length):
        end = min(first + length, total)
        chunk = np.concatenate([next(steps).copy() for _ in range(first, end)])
        part = columns[:, first * rows : end * rows].tocsr()
        touched = np.union1d(open_rows, np.flatnonzero(np.diff(part.indptr)))
        block = part[touched] @ chunk
        block[np.searchsorted(touched, open_rows)] += open_block
        done = last[touched] < end
        H += block[done].T @ block[done]
        g += block[done].T @ residual[touched[done]]
        open_rows, open_block = touched[~done], block[~done]
    return H, g


def last_step(by_position: csr_array, rows: int) -> Indices:
    """The last step (N,) that each residual depends on; −1 for none."""
    entries = by_position.tocoo()
    last = np.full(by_position.shape[0], -1, np.int32)
    np.maximum.at(last, entries.coords[0], (entries.coords[1] // max(rows, 1)).astype(np.int32))
    return last
