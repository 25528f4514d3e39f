"""The matrices of one step: the derivative of its velocity by the state before it, by masses and by stiffnesses.

An iteration of a step that goes from u to w (`implicit`) changes its velocity by

    A dw = Y dy + U du + M dv + C dp,      dy = dx + h du and du = dw of the iteration before; at first dx and dv,

and so do the explicit steps, with A = M. Row i of Y, U and C is the pullback of the unit vector along one axis at
vertex i; all vertices of a colour are probed together, three probes a colour, whatever the forces are. Fixed vertices
have no rows.

A vertex feels itself and the vertices that a spring or a face joins it to. Two rows can be probed together where both
feel no common vertex: a colouring of the graph at distance 2. For the derivative by the masses and stiffnesses alone it
suffices that no spring joins the two: distance 1. Reference: A. R. Curtis, M. J. D. Powell, J. K. Reid, On the
estimation of sparse Jacobian matrices, IMA Journal of Applied Mathematics 13, 1974.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from clothfit.base.arrays import Array, Elements, Indices
from clothfit.engine.forces import total
from clothfit.engine.solve import sparse
from clothfit.engine.step import implicit
from clothfit.engine.system import IMPLICIT, System, zeros
from clothfit.kernels.kernel import kernel
from clothfit.kernels.vectors import add_mass, add_rows_dot, combine, copy


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


class Jacobian(NamedTuple):
    """Derivative of one iteration of a step; its matrix A is in the workspace."""

    by_y: Array  # Y, (E, 3, 3), one block for each neighbour in the stencil
    by_u: Array  # U, (E, 3, 3)
    by_mass: Array  # C of each mass, (n, 3): on its own vertex
    by_stiffness: Array  # C of each stiffness, (S, 2, 3): on the two ends of its spring
    by_rest: Array  # C of each rest length, (S, 2, 3); (0, 2, 3) where it is not asked for
    row: Elements  # scratch: C of one probe


def jacobian(system: System, stencil: Stencil, rest: bool = False) -> Jacobian:
    """Memory for the derivative of a step of `system`; with `rest` by the rest lengths as well."""
    n, springs, blocks = len(system.x0), len(system.springs.rest), len(stencil.neighbour)
    return Jacobian(
        np.zeros((blocks, 3, 3)),
        np.zeros((blocks, 3, 3)),
        np.zeros((n, 3)),
        np.zeros((springs, 2, 3)),
        np.zeros((springs if rest else 0, 2, 3)),
        zeros(system, ["rest"] if rest else []),
    )


@kernel(nogil=True)
def differentiate(system, stencil, x, v, w, u, later, work, out):
    """Fill `out` with the derivative of an iteration from u to w, the first or a `later` one, and work.A with its
    matrix.
    """
    A, y, s, lam, gy, gu, row = work.A, work.y, work.s, work.solution, work.gy, work.gu, out.row
    at, to = u, w  # what the forces are linearised at, and the velocity their model is for
    if system.method == IMPLICIT:
        implicit.linearise(system, x, w, u, later, A, work.b, y, s)
    else:
        copy(x, y)
        s[:] = 0.0
        at, to = v, v
        sparse.reset(A, system.vertex.mass)
    for color in range(stencil.colors):
        for c in range(3):
            seed(system.vertex.free, stencil.color, color, c, lam)
            for each in (gy, gu):
                each[:] = 0.0
            for each in (row.mass, row.stiffness, row.rest):
                each[:] = 0.0
            total.add_pullback(system, y, at, to, s, lam, system.h, row, gy, gu)
            add_rows_dot(-1.0, lam, w, row.mass)
            add_rows_dot(1.0, lam, v, row.mass)
            if system.method != IMPLICIT:
                total.add_damping(system, y, v, system.h, lam, gu)
            elif later:
                add_newton(system, A, y, u, lam, work.b, gu)
            keep(system, stencil, color, c, gy, gu, out)


@kernel
def seed(free, colors, color, c, lam):
    """lam = the unit vector along axis c at all free vertices of one colour."""
    for i in range(len(lam)):
        lam[i, 0], lam[i, 1], lam[i, 2] = 0.0, 0.0, 0.0
        if free[i] and colors[i] == color:
            lam[i, c] = 1.0


@kernel
def add_newton(system, A, y, u, lam, scratch, gu):
    """gu += −h² K λ = (A − M + h D) λ: how the point of linearisation of a later iteration moves with u."""
    sparse.multiply(A, lam, scratch)
    add_mass(system.vertex.mass, -1.0, lam, scratch)
    total.add_damping(system, y, u, system.h, lam, scratch)
    combine(1.0, gu, 1.0, scratch, gu)


@kernel
def keep(system, stencil, color, c, gy, gu, out):
    """Sort the result of probing one colour along axis c into rows."""
    for i in range(len(gy)):
        if stencil.color[i] == color:
            out.by_mass[i, c] = out.row.mass[i]
            for e in range(stencil.start[i], stencil.start[i + 1]):
                j = stencil.neighbour[e]
                for d in range(3):
                    out.by_y[e, c, d] = gy[j, d]
                    out.by_u[e, c, d] = gu[j, d]
    for i in range(len(out.by_stiffness)):
        for end in range(2):
            if stencil.color[system.springs.ends[i, end]] == color:
                out.by_stiffness[i, end, c] = out.row.stiffness[i]
                if len(out.by_rest) > 0:
                    out.by_rest[i, end, c] = out.row.rest[i]


@kernel
def differentiate_globally(system, x, v, w, u, later, work, direction, out):
    """out (n, 3) = C dp in an iteration for a change `direction` of elements that act everywhere."""
    y, s, zero = work.y, work.s, work.gy
    zero[:] = 0.0
    at, to = u, w
    if system.method == IMPLICIT:
        implicit.offset(system.h, x, w, u, later, y, s)
    else:
        copy(x, y)
        s[:] = 0.0
        at, to = v, v
    out[:] = 0.0
    total.add_pushforward(system, y, at, to, s, zero, zero, direction, system.h, out)
    add_mass(direction.mass, 1.0, v, out)
    add_mass(direction.mass, -1.0, w, out)
