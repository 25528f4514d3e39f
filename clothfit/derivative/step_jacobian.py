"""The matrices of one step: the derivative of its velocity by the state before it, by masses and by stiffnesses.

An iteration of a step that goes from u to w (`implicit`) changes its velocity by

    A dw = Y dy + U du + M dv + C dp,      dy = dx and du = dv,

and so do the explicit steps, with A = M. In later iterations, whose point of linearisation moves with u, dy = dx + h du
and du = dw of the iteration before, and the solution is dw − du, with M (dv − du) for M dv.

Rows of Y, U and C are pullbacks of unit vectors. Springs and faces are taken apart, each with vertices of its own, so
that one pullback gives a row of the block of every one of them: that of the unit vector along one axis at one corner
each. Three such probes are enough for springs, whose ends feel opposite forces, nine for faces, and three for the
forces that act on each vertex for itself.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from clothfit.base.arrays import Array, Elements, Indices
from clothfit.engine.forces import contact, springs, total, wind
from clothfit.engine.forces.faces import Faces, add_along
from clothfit.engine.forces.selfcontact.zones import add_row
from clothfit.engine.forces.springs import Springs
from clothfit.engine.solve import sparse
from clothfit.engine.step import implicit
from clothfit.engine.system import IMPLICIT, System, zeros
from clothfit.kernels.kernel import kernel
from clothfit.kernels.lanes.operations import load3, store3
from clothfit.kernels.vectors import add, copy


class Stencil(NamedTuple):
    """Neighbours of the n vertices of a cloth; E neighbours in all."""

    start: Indices  # (n + 1,), vertex i has the neighbours start[i] … start[i + 1] − 1
    neighbour: Indices  # (E,), vertices, ascending for each vertex, itself included

    def entries(self, first: NDArray[np.integer], second: NDArray[np.integer]) -> Indices:
        """Where the vertices `second` are among the neighbours of the vertices `first`."""
        count = len(self.start) - 1
        keys = np.repeat(np.arange(count), np.diff(self.start)) * count + self.neighbour
        return np.searchsorted(keys, first * np.int64(count) + second).astype(np.int32)


def stencil(system: System) -> Stencil:
    """The neighbours of all vertices: those that a spring or a face joins to them."""
    from scipy.sparse import csr_array

    n, faces = len(system.x0), system.faces.corners
    pairs = np.concatenate([system.springs.ends, faces[:, :2], faces[:, 1:], faces[:, ::2]])
    ends = np.concatenate([pairs, pairs[:, ::-1], np.repeat(np.arange(n)[:, None], 2, axis=1)])
    graph = csr_array((np.ones(len(ends), np.int32), (ends[:, 0], ends[:, 1])), shape=(n, n))
    graph.sum_duplicates()
    return Stencil(graph.indptr.astype(np.int32), graph.indices.astype(np.int32))


class Apart(NamedTuple):
    """N elements of k corners each that share no vertex: N k vertices in all, and memory for probes, (N k, 3) each."""

    corners: Indices  # (N, k), from 0 to N k − 1
    vertex: Indices  # (N k,), which one of the cloth each of them is
    entry: Indices  # (N, k, k), of a corner's vertex and another's in the stencil
    y: Array
    u: Array
    w: Array
    s: Array
    lam: Array
    gy: Array
    gu: Array


def apart(corners: Indices, near: Stencil) -> Apart:
    """Elements with these corners (N, k), taken apart."""
    own = np.arange(corners.size, dtype=np.int32).reshape(corners.shape)
    entry = near.entries(corners[:, :, None], corners[:, None, :])
    return Apart(own, corners.reshape(-1), entry, *(np.zeros((corners.size, 3)) for _ in range(7)))


class Jacobian(NamedTuple):
    """Derivative of one iteration of a step; its matrix A is in the workspace."""

    by_y: Array  # Y, (E, 3, 3), one block for each neighbour in the stencil; (0, 3, 3) where C alone is asked for
    by_u: Array  # U, as Y
    by_mass: Array  # C of each mass, (n, 3): on its own vertex
    by_stiffness: Array  # C of each stiffness, (S, 2, 3): on the two ends of its spring
    by_rest: Array  # C of each rest length, (S, 2, 3); (0, 2, 3) where it is not asked for
    by_load: Array  # of what pressed each vertex of a collider in the step before, (R, 3); (0, 3) without such
    load_by_y: Array  # and what presses it in this one, by dy, (R, 3)
    load_by_w: Array  # and by dw, in later iterations dw − du
    row: Elements  # scratch: C of one probe
    springs: Apart
    faces: Apart
    vertices: Apart  # elements of one corner


def jacobian(system: System, near: Stencil, rest: bool = False, states: bool = True) -> Jacobian:
    """Memory for the derivative of a step of `system`, by its states or else by masses and stiffnesses alone; with
    `rest` by the rest lengths as well.
    """
    n, count, blocks = len(system.x0), len(system.springs.rest), len(near.neighbour) if states else 0
    kept = system.colliders if states and system.method >= IMPLICIT else None
    loads = 0 if kept is None else kept.load.shape[1]
    return Jacobian(
        np.zeros((blocks, 3, 3)),
        np.zeros((blocks, 3, 3)),
        np.zeros((n, 3)),
        np.zeros((count, 2, 3)),
        np.zeros((count if rest else 0, 2, 3)),
        np.zeros((loads, 3)),
        np.zeros((loads, 3)),
        np.zeros((loads, 3)),
        zeros(system, ["rest"] if rest else []),
        apart(system.springs.ends, near),
        apart(system.faces.corners, near),
        apart(np.arange(n, dtype=np.int32)[:, None], near),
    )


@kernel(nogil=True)
def differentiate(system, x, v, w, u, later, work, out):
    """Fill `out` with the derivative of an iteration from u to w, the first or a `later` one, and work.A with its
    matrix.
    """
    y, s = work.y, work.s
    at, to = offset(system, x, v, w, u, later, y, s)
    if system.method == IMPLICIT:
        implicit.assemble(system, y, u, later, work.A, work.b)
    else:
        sparse.reset(work.A, system.vertex.mass)
    out.by_y[:] = 0.0
    out.by_u[:] = 0.0
    damped = len(out.by_u) > 0 and (later or system.method != IMPLICIT)
    probe_springs(system, y, at, to, s, damped, out)
    if len(out.by_y) > 0:
        probe_faces(system, y, at, to, s, damped, out)
    probe_vertices(system, y, at, to, s, damped, out)
    probe_loads(system.colliders, system.h, out)
    add(1.0, v, out.by_mass)
    add(-1.0, w, out.by_mass)


@kernel
def offset(system, x, v, w, u, later, y, s):
    """Write where an iteration or an explicit step is linearised to y and s; returns the velocity there, and the one
    that the forces' model is for.
    """
    if system.method == IMPLICIT:
        implicit.offset(system, x, w, u, later, y, s)
        return u, w
    copy(x, y)
    s[:] = 0.0
    return v, v


@kernel
def probe_springs(system, y, u, w, s, damped, out):
    """Add to `out` what springs have in it, where `damped` with h D in U."""
    own, part, row, h = system.springs, out.springs, out.row, system.h
    alone = Springs(part.corners, own.rest, own.stiffness, own.damping, own.slot, own.cap, own.object, own.bend)
    gather(part, y, u, w, s)
    for c in range(3):
        seed(part, 0, c)
        row.stiffness[:] = 0.0
        row.rest[:] = 0.0
        springs.add_pullback(alone, part.y, part.u, part.w, part.s, part.lam, h, row, part.gy, part.gu)
        if damped:
            springs.add_damping(alone, part.y, part.u, h, part.lam, part.gu)
        keep(part, 0, c, 1.0, out)
        keep(part, 1, c, -1.0, out)
        for i in range(len(out.by_stiffness)):
            out.by_stiffness[i, 0, c], out.by_stiffness[i, 1, c] = row.stiffness[i], -row.stiffness[i]
        for i in range(len(out.by_rest)):
            out.by_rest[i, 0, c], out.by_rest[i, 1, c] = row.rest[i], -row.rest[i]


@kernel
def probe_faces(system, y, u, w, s, damped, out):
    """The same for the faces."""
    own, part, h = system.faces, out.faces, system.h
    alone = Faces(part.corners, own.drag, own.wind, own.quadratic, own.object)
    gather(part, y, u, w, s)
    for corner in range(3):
        for c in range(3):
            seed(part, corner, c)
            wind.add_pullback(alone, part.y, part.u, part.w, part.s, part.lam, h, out.row, part.gy, part.gu)
            if damped:
                wind.add_damping(alone, part.y, part.u, h, part.lam, part.gu)
            keep(part, corner, c, 1.0, out)


@kernel
def probe_vertices(system, y, u, w, s, damped, out):
    """The same for the forces that act on each vertex for itself."""
    part, h = out.vertices, system.h
    gather(part, y, u, w, s)
    for c in range(3):
        seed(part, 0, c)
        out.row.mass[:] = 0.0
        contact.forget(system.colliders)
        total.add_pullback_alone(system, part.y, part.u, part.w, part.s, part.lam, h, out.row, part.gy, part.gu)
        if damped:
            total.add_damping_alone(system, part.y, part.u, h, part.lam, part.gu)
        keep(part, 0, c, 1.0, out)
        for i in range(len(out.by_mass)):
            out.by_mass[i, c] = out.row.mass[i]
        keep_load(system.colliders, c, out)


@kernel(absent=None)
def keep_load(colliders, c, out):
    """The same of what pressed vertices in the step before."""
    for k in range(len(out.by_load)):
        out.by_load[k, c] = colliders.of_load[0, k]


@kernel(absent=None)
def probe_loads(colliders, h, out):
    """Write what presses vertices in a step; the vertices have what `probe_vertices` gave them."""
    part = out.vertices
    n = len(part.y)
    for first in range(0, len(out.by_load), n):
        for each in (part.lam, part.gy, part.gu):
            each[:] = 0.0
        contact.forget(colliders)
        colliders.of_load[1, first : first + n] = 1.0
        contact.add_pullback(colliders, part.y, part.u, part.w, part.s, part.lam, h, out.row, part.gy, part.gu)
        contact.add_press(colliders, part.y, part.u, part.w, part.s, h, 1.0, part.gu)
        copy(part.gy, out.load_by_y[first : first + n])
        copy(part.gu, out.load_by_w[first : first + n])
    contact.forget(colliders)


@kernel
def gather(part, y, u, w, s):
    """Give the corners of elements what their vertices have."""
    for i in range(len(part.vertex)):
        for a, own in ((y, part.y), (u, part.u), (w, part.w), (s, part.s)):
            store3(load3(a, part.vertex[i]), own, i)


@kernel
def seed(part, corner, c):
    """λ = the unit vector along axis c at one corner of each element; the gradients are 0."""
    for each in (part.lam, part.gy, part.gu):
        each[:] = 0.0
    for i in range(len(part.corners)):
        part.lam[part.corners[i, corner], c] = 1.0


@kernel
def keep(part, corner, c, scale, out):
    """Add what a probe has found, times `scale`, to row c of the blocks of one corner of each element."""
    if len(out.by_y) == 0:
        return
    for i in range(len(part.corners)):
        for other in range(part.corners.shape[1]):
            e, j = part.entry[i, corner, other], part.corners[i, other]
            add_along(out.by_y[e], c, scale, load3(part.gy, j))
            add_along(out.by_u[e], c, scale, load3(part.gu, j))


@kernel
def add_loads(by, place, loads, right):
    """Add what the changes `loads` (R, Q) of what pressed vertices before have in the right-hand side (3 f, Q)."""
    for k in range(len(loads)):
        row = 3 * place[k % len(place)]
        for c in range(3 if row >= 0 else 0):
            add_row(by.by_load[k, c], loads[k], right[row + c])


@kernel
def change_loads(by, place, dy, dq, loads):
    """Write the changes of what presses vertices in the step, for those of y and of the velocity (3 f, Q)."""
    loads[:] = 0.0
    for k in range(len(loads)):
        row = 3 * place[k % len(place)]
        for c in range(3 if row >= 0 else 0):
            add_row(by.load_by_y[k, c], dy[row + c], loads[k])
            add_row(by.load_by_w[k, c], dq[row + c], loads[k])


@kernel(absent=None)
def change_loads_globally(colliders, system, x, v, w, u, later, scratch, direction, q, loads):
    """Add those of a change `direction` of elements that act everywhere to column q."""
    (y, s, zero, _), h = scratch, system.h
    zero[:] = 0.0
    at, to = offset(system, x, v, w, u, later, y, s)
    contact.push_press(colliders, y, at, to, s, zero, zero, direction, h)
    for k in range(len(loads)):
        loads[k, q] += colliders.of_load[1, k]
    contact.forget(colliders)


@kernel
def differentiate_globally(system, x, v, w, u, later, scratch, direction, place, q, right):
    """Add C dp of an iteration for a change `direction` of elements that act everywhere to column q of `right`
    (3 f, Q), which has the rows of vertex i from 3 place[i] on; `scratch` is four arrays (n, 3).
    """
    (y, s, zero, out), h = scratch, system.h
    zero[:] = 0.0
    out[:] = 0.0
    at, to = offset(system, x, v, w, u, later, y, s)
    if len(direction.damping) > 0:
        springs.add_pushforward(system.springs, y, at, to, s, zero, zero, direction, h, out)
    if len(direction.drag) + len(direction.wind) > 0:
        wind.add_pushforward(system.faces, y, at, to, s, zero, zero, direction, h, out)
    total.add_pushforward_alone(system, y, at, to, s, zero, zero, direction, h, out)
    for i in range(len(place)):
        if place[i] >= 0:
            for c in range(3):
                right[3 * place[i] + c, q] += out[i, c]
