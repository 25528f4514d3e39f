"""The first modes of vibration of a cloth, as a net under even tension: smooth shapes over it, the same for x, y and z.

A flat cloth at rest has no stiffness across its plane, so its own modes would say nothing of the shapes out of it. With
L the Laplacian of its springs, weighted by stiffness, they are L φ = λ M φ, ΦᵀMΦ = I.
"""

from __future__ import annotations

import numpy as np

from clothfit.base.arrays import Array, Indices
from clothfit.scene.cloth import Cloth

DENSE = 1500
"""Vertices up to which all modes are found at once."""


def modes_of(cloth: Cloth, free: Indices, count: int) -> Array:
    """The modes (f, count) with the lowest frequencies of the f free vertices."""
    from scipy.linalg import eigh
    from scipy.sparse import csr_array, diags_array

    ends, n = np.concatenate([cloth.springs, cloth.springs[:, ::-1]]), len(cloth.mass)
    graph = csr_array((np.concatenate([cloth.stiffness, cloth.stiffness]), (ends[:, 0], ends[:, 1])), shape=(n, n))
    scale = 1.0 / np.sqrt(cloth.mass[free])
    inner = csr_array(diags_array(graph.sum(axis=1)) - graph)[free][:, free]
    balanced = diags_array(scale) @ inner @ diags_array(scale)
    if len(free) <= DENSE or 3 * count > len(free):
        _, found = eigh(balanced.toarray(), subset_by_index=[0, count - 1])
    else:
        from scipy.sparse.linalg import eigsh

        below = -1e-6 * float(balanced.diagonal().max())
        start = np.random.default_rng(0).normal(size=len(free))
        _, found = eigsh(balanced.tocsc(), count, sigma=below, v0=start)
    return np.asarray(scale[:, None] * found)
