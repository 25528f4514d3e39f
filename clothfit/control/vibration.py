"""The first modes of vibration of a cloth at its start: smooth shapes over it, as a basis of forces.

A flat cloth at rest has no stiffness across its plane, so all its out-of-plane shapes would have the frequency 0. A
slight tension everywhere, a thousandth of the springs' stiffness, orders them as a membrane does.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from clothfit.base.arrays import Array, Flags
from clothfit.base.errors import InvalidInput
from clothfit.scene.cloth import Cloth

if TYPE_CHECKING:
    from scipy.sparse import csc_array

TENSION = 1e-3
"""Of the mean stiffness of the springs."""

DENSE = 1500
"""Unknowns up to which all modes are found together."""


def modes_of(own: Cloth, acts: Flags, count: int) -> Array:
    """The first `count` shapes (3 n, count) of the free vertices, their largest displacement 1, and 0 where no force
    `acts` (n,). Raises InvalidInput where there are not so many.
    """
    from scipy.sparse import diags_array

    free = np.flatnonzero(~own.fixed)
    if count > 3 * len(free):
        raise InvalidInput(f"modes: {count} are asked for; the cloth has {3 * len(free)}")
    K, root = stiffness(own), 1.0 / np.sqrt(np.repeat(own.mass[free], 3))
    A = (diags_array(root) @ K @ diags_array(root)).tocsc()
    shapes = lowest(A, count) * root[:, None]
    found = np.zeros((len(own.mass), 3, count))
    found[free] = shapes.reshape(len(free), 3, count)
    found[~acts] = 0.0
    found /= np.maximum(np.abs(found).max(axis=(0, 1)), 1e-300)
    return found.reshape(-1, count)


def stiffness(own: Cloth) -> csc_array:
    """The stiffness (3 f, 3 f) of the f free vertices, N/m, without what compressed springs take from it."""
    from scipy.sparse import bsr_array

    ends, k = own.springs, own.stiffness
    away = own.positions[ends[:, 1]] - own.positions[ends[:, 0]]
    length = np.maximum(np.linalg.norm(away, axis=1), 1e-300)
    along = away / length[:, None]
    across = np.maximum(1.0 - own.rest / length, 0.0) * k + TENSION * max(float(k.mean()) if len(k) else 0.0, 1e-300)
    outer = along[:, :, None] * along[:, None, :]
    block = k[:, None, None] * outer + across[:, None, None] * (np.eye(3) - outer)
    n, (a, b) = len(own.mass), ends.T
    rows, columns = np.concatenate([a, b, a, b]), np.concatenate([a, b, b, a])
    data = np.concatenate([block, block, -block, -block])
    order = np.lexsort((columns, rows))
    starts = np.searchsorted(rows[order], np.arange(n + 1))
    whole = bsr_array((data[order], columns[order], starts), shape=(3 * n, 3 * n)).tocsc()
    kept = np.repeat(~own.fixed, 3)
    return whole[kept][:, kept]


def lowest(A: csc_array, count: int) -> Array:
    """The eigenvectors (Q, count) of the smallest eigenvalues of a symmetric matrix (Q, Q) that has none below 0."""
    from scipy.sparse.linalg import eigsh

    size = A.shape[0]
    if size <= DENSE or count > size // 3:
        from scipy.linalg import eigh

        return np.asarray(eigh(A.toarray(), subset_by_index=(0, count - 1))[1])
    shift = -1e-6 * float(A.diagonal().mean())
    values, vectors = eigsh(A, count, sigma=shift, v0=np.ones(size))
    return np.asarray(vectors[:, np.argsort(values)])
