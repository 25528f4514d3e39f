"""Which vertices act on which: the pattern by which probing finds all rows of a sparse derivative at once.

A vertex feels itself and the vertices that a spring or a face joins it to. Two rows can be probed together where both
feel no common vertex: a colouring of the graph at distance 2. For the derivative by the masses and stiffnesses alone it
suffices that no spring joins the two: distance 1.
Reference: A. R. Curtis, M. J. D. Powell, J. K. Reid, On the estimation of sparse Jacobian matrices, IMA Journal of
Applied Mathematics 13, 1974.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from clothfit.base.arrays import Indices
from clothfit.engine.system import System


class Stencil(NamedTuple):
    """Neighbours and colours of the n vertices of a cloth; E neighbours in all."""

    start: Indices  # (n + 1,), vertex i has the neighbours start[i] … start[i + 1] − 1
    neighbour: Indices  # (E,), vertices, ascending for each vertex, itself included
    color: Indices  # (n,)
    colors: int


def stencil(system: System, distance: int) -> Stencil:
    """The neighbours of all vertices, coloured so that two of one colour are more than `distance` apart."""
    from scipy.sparse import csr_array

    n, faces = len(system.x0), system.faces.corners
    pairs = np.concatenate([system.springs.ends, faces[:, :2], faces[:, 1:], faces[:, ::2]])
    ends = np.concatenate([pairs, pairs[:, ::-1], np.repeat(np.arange(n)[:, None], 2, axis=1)])
    graph = csr_array((np.ones(len(ends), np.int32), (ends[:, 0], ends[:, 1])), shape=(n, n))
    graph.sum_duplicates()
    near = graph if distance == 1 else csr_array(graph @ graph)
    color = colouring(near.indptr, near.indices)
    return Stencil(
        graph.indptr.astype(np.int32), graph.indices.astype(np.int32), color, int(color.max(initial=-1)) + 1
    )


def colouring(start: Indices, neighbour: Indices) -> Indices:
    """Greedy colours (n,): each vertex takes the first colour that no neighbour has."""
    color = np.full(len(start) - 1, -1, np.int32)
    for i in range(len(color)):
        taken = set(color[neighbour[start[i] : start[i + 1]]].tolist())
        color[i] = next(c for c in range(len(taken) + 1) if c not in taken)
    return color
