"""The elements of a cloth's forces as the subspace sees them: few points, copies of points, and the engine's forces;
and an iteration of an implicit step on these copies.

With x = x₀ + U q on the free vertices, a force element depends on q through few rows: a spring through the difference
of its ends, a face through its corners, a contact through its vertex. These are the *points*, (m, 3),

    y = c + R q,   c the part of the fixed vertices, of x₀ and of what carries them (`carrier`),
                   R (3 m, r) rows of U or their differences.

Every element owns *copies* of its points, so that the engine's own kernels (`forces`) act on small arrays: copy 0 is
the origin, to which each spring ties its point; then one copy for each spring, three for each face, one for each vertex
that may touch something. No two elements share a copy, so the matrix of a step has 3×3 blocks on its diagonal only, and
a weight per copy, 1 or that of a cubature, scales all that an element does: force, stiffness, derivatives.

On all vertices an iteration solves A w = M v + h [f(y, u) + K (x − y) − D u] (`engine.step.implicit`). With w = U ω on
the free vertices and the velocities of the pins elsewhere, projected on U, that is

    (Uᵀ M U (1 + h α) + Σ Rᵀ B R) ω = Uᵀ M U p + h Uᵀ M 1 g + Σ Rᵀ (b − B ċ),

the sums over copies, B = −h² K − h D and b the blocks and the right-hand sides that the engine's forces give, ċ the
velocity of the pins' part of a copy. Each block is symmetric: B = Σ d l lᵀ, and the rows √|d| lᵀ R of all blocks make
the matrix as one product, those with d < 0 subtracted. A block of rank one, as those of faces and of contacts, gives
one row. Arrays are (copies, 3) or (points, 3).
"""

from __future__ import annotations

from math import sqrt
from typing import NamedTuple

import numpy as np

from clothfit.base.arrays import Array, Indices, aligned
from clothfit.engine.forces import applied, bodies, colliders, meeting, spheres, springs, touch, vertex, wind
from clothfit.engine.inputs import tables
from clothfit.engine.inputs.tables import set_inputs
from clothfit.engine.solve.sparse import BLOCK_SIZE, XX, XY, XZ, YY, YZ, ZZ
from clothfit.engine.system import System
from clothfit.kernels.kernel import kernel


class Selection(NamedTuple):
    """Which elements are evaluated, and how often each counts."""

    springs: Indices  # (s,)
    spring_weight: Array  # (s,)
    faces: Indices  # (f,)
    face_weight: Array  # (f,)
    vertices: Indices  # (c,), those that may touch something
    vertex_weight: Array  # (c,)


class Blocks(NamedTuple):
    """What forces write of a step's matrix: the fields of `sparse.BlockMatrix` that they use."""

    diagonal: Array  # (copies + 1, 8)
    upper: Array  # (1, 8)


class Layout(NamedTuple):
    """Where the copies are, and how they depend on q."""

    rows: Array  # R, (3 m, r), row 3 j + c of component c of point j
    constant: Array  # c, (m, 3), m, with the fixed vertices where they start
    point: Indices  # (copies,), the point of each; 0 for the origin, whose weight is 0
    weight: Array  # (copies,)
    ends: Indices  # (3,), where the copies of springs, of faces and of vertices end
    pinned: Indices  # (e, 2), points that a pin is part of, and the pin
    sign: Array  # (e,), how often


class Sampled(NamedTuple):
    """The forces on the copies: what of a System the kernels need."""

    h: float  # s
    springs: springs.Springs  # between copy 0 and those of the springs
    faces: wind.Faces
    spheres: spheres.Spheres
    colliders: touch.Colliders | None
    vertex: vertex.Vertex  # no vertices, but the gravity and the damping
    inputs: tables.Inputs | None
    applied: applied.Applied


def nothing() -> Selection:
    """No elements: what a network evaluates."""
    some = (np.zeros(0, np.int32), np.zeros(0))
    return Selection(*some, *some, *some)


def everything(system: System) -> Selection:
    """All elements of a cloth, each once; springs and faces between fixed vertices do nothing."""
    free, touches = system.vertex.free, len(system.spheres.radius) > 0 or system.colliders is not None
    own = np.flatnonzero(free[system.springs.ends].any(axis=1)).astype(np.int32)
    faces = np.flatnonzero(free[system.faces.corners].any(axis=1)).astype(np.int32)
    contacts = np.flatnonzero(free).astype(np.int32) if touches else np.zeros(0, np.int32)
    return Selection(own, np.ones(len(own)), faces, np.ones(len(faces)), contacts, np.ones(len(contacts)))


def build(system: System, basis: Array, chosen: Selection) -> tuple[Layout, Sampled]:
    """The layout and the forces of chosen elements of a cloth on a basis U (n, 3, r), 0 at fixed vertices."""
    n, r = len(system.x0), basis.shape[2]
    ends = system.springs.ends[chosen.springs]
    corners = system.faces.corners[chosen.faces]
    corner, index = np.unique(np.concatenate([corners.ravel(), chosen.vertices]), return_inverse=True)
    s, f = len(ends), 3 * len(corners)
    rows = np.concatenate([basis[ends[:, 0]] - basis[ends[:, 1]], basis[corner]]).reshape(-1, r)
    x0 = system.x0
    constant = np.concatenate([x0[ends[:, 0]] - x0[ends[:, 1]], x0[corner]])
    point = np.concatenate([[0], np.arange(s), s + index]).astype(np.int32)
    weight = np.concatenate([[0.0], chosen.spring_weight, np.repeat(chosen.face_weight, 3), chosen.vertex_weight])
    last = np.cumsum([1 + s, f, len(chosen.vertices)]).astype(np.int32)
    pinned, sign = pinned_points(system, ends, corner, n)
    layout = Layout(np.ascontiguousarray(rows), constant, point, weight, last, pinned, sign)
    return layout, sampled(system, chosen, len(ends))


def pinned_points(system: System, ends: Indices, corner: Indices, n: int) -> tuple[Indices, Array]:
    """Which points a pin is part of, with the pin, (e, 2), and its sign (e,). Free vertices follow a pin of their own,
    the mean of all, of which springs between two of them feel nothing.
    """
    pin = np.full(n, -1)
    if system.inputs is not None:
        pin[system.inputs.pins] = np.arange(len(system.inputs.pins))
    if pin.max() < 0:
        return np.zeros((0, 2), np.int32), np.zeros(0)
    pin[system.vertex.free] = pin.max() + 1  # what carries them
    owners = [(np.arange(len(ends)), ends[:, 0], 1.0), (np.arange(len(ends)), ends[:, 1], -1.0)]
    owners.append((len(ends) + np.arange(len(corner)), corner, 1.0))
    found, signs = [], []
    for points, vertices, sign in owners:
        held = pin[vertices] >= 0
        found.append(np.stack([points[held], pin[vertices][held]], axis=1))
        signs.append(np.full(np.count_nonzero(held), sign))
    entries, places = np.unique(np.concatenate(found), axis=0, return_inverse=True)
    total = np.bincount(places.ravel(), np.concatenate(signs), len(entries))
    return np.ascontiguousarray(entries[total != 0], np.int32), total[total != 0]


def sampled(system: System, chosen: Selection, count: int) -> Sampled:
    """The forces of chosen elements on the copies."""
    ties = np.stack([1 + np.arange(count), np.zeros(count)], axis=1).astype(np.int32)
    own, k = system.springs, chosen.springs
    tied = own._replace(
        ends=np.ascontiguousarray(ties), rest=own.rest[k].copy(), stiffness=own.stiffness[k].copy(),
        slot=np.zeros(count, np.int32),
    )  # fmt: skip
    corners = np.arange(3 * len(chosen.faces), dtype=np.int32).reshape(-1, 3)
    held = system.vertex._replace(mass=np.zeros(0), gravity=system.vertex.gravity.copy(), free=np.zeros(0, bool))
    return Sampled(
        h=system.h,
        springs=tied,
        faces=system.faces._replace(corners=corners, wind=system.faces.wind.copy()),
        spheres=system.spheres._replace(centre=system.spheres.centre.copy()),
        colliders=of_vertices(system.colliders, chosen.vertices),
        vertex=held,
        inputs=system.inputs,
        applied=applied.build(0, 0),
    )


def of_vertices(own: touch.Colliders | None, vertices: Indices) -> touch.Colliders | None:
    """Colliders with memory of their own, for these vertices of the cloth only."""
    if own is None:
        return None
    meshes: bodies.Bodies = bodies.copied(own.bodies)
    meshes = meshes._replace(last=np.ascontiguousarray(meshes.last[:, vertices]))
    met = np.ascontiguousarray(own.met[:, :, vertices])
    return own._replace(rows=own.rows.copy(), met=met, turn=own.turn.copy(), bodies=meshes)


def blocks(layout: Layout) -> Blocks:
    """Memory for the matrix of a step on the copies."""
    return Blocks(aligned(len(layout.point) + 1, BLOCK_SIZE), aligned(1, BLOCK_SIZE))


TINY = 1e-13
"""What of a block's pivot is rounding, relative to its trace."""


@kernel
def begin(own, t):
    """Set the inputs of step t."""
    set_inputs(own.inputs, own, t)
    meeting.clear(own.colliders)


@kernel
def spread(lay, points, out):
    """Give every copy the values of its point; the origin keeps 0."""
    for i in range(1, len(out)):
        j = lay.point[i]
        out[i, 0], out[i, 1], out[i, 2] = points[j, 0], points[j, 1], points[j, 2]


@kernel
def add_pins(lay, pins, out):
    """Add the part of the pins (P, 3) to points."""
    for e in range(len(lay.pinned)):
        j, p = lay.pinned[e, 0], lay.pinned[e, 1]
        for c in range(3):
            out[j, c] += lay.sign[e] * pins[p, c]


@kernel
def linearise(own, lay, points, h, y, u, A, b):
    """Write y and u of the copies for R q and R p in the rows of `points` (2, 3 m), and the blocks A and b of a step
    from there. What of y and u is the pins' is there.
    """
    for i in range(1, len(y)):
        j = lay.point[i]
        for c in range(3):
            y[i, c] += points[0, 3 * j + c] + lay.constant[j, c]
            u[i, c] += points[1, 3 * j + c]
    assemble(own, lay, y, u, h, False, A, b)


@kernel
def assemble(own, lay, y, u, h, ahead, A, b):
    """The blocks of A (copies) and b (copies, 3) of the forces at (y, u), without weights."""
    for i in range(len(A.diagonal)):
        for c in range(8):
            A.diagonal[i, c] = 0.0
    b[:] = 0.0
    s, f = lay.ends[0], lay.ends[1]
    springs.add_step(own.springs, y[:s], u[:s], h, ahead, Blocks(A.diagonal, A.upper), b[:s])
    wind.add_step(own.faces, y[s:f], u[s:f], h, ahead, Blocks(A.diagonal[s:], A.upper), b[s:f])
    spheres.add_step(own.spheres, y[f:], u[f:], h, ahead, Blocks(A.diagonal[f:], A.upper), b[f:])
    colliders.add_step(own.colliders, y[f:], u[f:], h, ahead, Blocks(A.diagonal[f:], A.upper), b[f:])


@kernel
def times_block(A, i, x0, x1, x2):
    """B x of copy i."""
    D = A.diagonal
    return (
        D[i, XX] * x0 + D[i, XY] * x1 + D[i, XZ] * x2,
        D[i, XY] * x0 + D[i, YY] * x1 + D[i, YZ] * x2,
        D[i, XZ] * x0 + D[i, YZ] * x1 + D[i, ZZ] * x2,
    )


@kernel
def of_copies(A, b, velocity, out):
    """out (copies, 3) = b − B w for velocities w."""
    for i in range(len(b)):
        p0, p1, p2 = times_block(A, i, velocity[i, 0], velocity[i, 1], velocity[i, 2])
        out[i, 0], out[i, 1], out[i, 2] = b[i, 0] - p0, b[i, 1] - p1, b[i, 2] - p2


@kernel
def factors(lay, A, up, down):
    """Write the rows √|d| lᵀ R of all weighted blocks, those with d > 0 to `up` and the others to `down`, (…, r) each;
    returns how many there are of both.
    """
    more, less = 0, 0
    f = np.empty((3, 4))
    for i in range(1, len(lay.point)):
        weight = lay.weight[i]
        for k in range(split(A.diagonal, i, f)):
            scale = weight * f[k, 3]
            if scale > 0.0:
                write_row(lay.rows, 3 * lay.point[i], sqrt(scale), f[k], up[more])
                more += 1
            elif scale < 0.0:
                write_row(lay.rows, 3 * lay.point[i], sqrt(-scale), f[k], down[less])
                less += 1
    return more, less


@kernel
def write_row(rows, j, scale, along, out):
    """out (r,) = scale · lᵀ R for `along` l (3,), R the three rows from j on."""
    l0, l1, l2 = scale * along[0], scale * along[1], scale * along[2]
    for c in range(rows.shape[1]):
        out[c] = l0 * rows[j, c] + l1 * rows[j + 1, c] + l2 * rows[j + 2, c]


@kernel
def split(D, i, f):
    """Block i as Σ d l lᵀ, largest pivot first: rows l, d of f (3, 4); returns how many there are."""
    a, b, c = D[i, XX], D[i, XY], D[i, XZ]
    d, e, g = D[i, YY], D[i, YZ], D[i, ZZ]
    least = TINY * (abs(a) + abs(d) + abs(g))
    for k in range(3):
        if max(abs(a), abs(d), abs(g)) <= least:
            return k
        if abs(a) >= abs(d) and abs(a) >= abs(g):
            pivot, l0, l1, l2 = a, 1.0, b / a, c / a
        elif abs(d) >= abs(g):
            pivot, l0, l1, l2 = d, b / d, 1.0, e / d
        else:
            pivot, l0, l1, l2 = g, c / g, e / g, 1.0
        f[k, 0], f[k, 1], f[k, 2], f[k, 3] = l0, l1, l2, pivot
        a, b, c = a - pivot * l0 * l0, b - pivot * l0 * l1, c - pivot * l0 * l2
        d, e, g = d - pivot * l1 * l1, e - pivot * l1 * l2, g - pivot * l2 * l2
    return 3
