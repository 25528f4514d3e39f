"""The elements of a cloth's forces as the subspace sees them: few points, copies of points, and the engine's forces.

With x = x₀ + U q on the free vertices, a force element depends on q through few rows: a spring through the difference
of its ends, a face through its corners, a contact through its vertex. These are the *points*, (m, 3),

    y = c + R q,   c the part of the fixed vertices, of x₀ and of what carries them (`carrier`),
                   R (3 m, r) rows of U or their differences.

Every element owns *copies* of its points, so that the engine's own kernels (`forces`) act on small arrays: copy 0 is
the origin, to which each spring ties its point; then one copy for each spring, three for each face, one for each vertex
that may touch something. No two elements share a copy, so the matrix of a step has 3×3 blocks on its diagonal only, and
a weight per copy, 1 or that of a cubature, scales all that an element does: force, stiffness, derivatives.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from clothfit.base.arrays import Array, Indices, aligned
from clothfit.engine.forces import applied, bodies, spheres, springs, touch, vertex, wind
from clothfit.engine.inputs import tables
from clothfit.engine.solve.sparse import BLOCK_SIZE
from clothfit.engine.system import System


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
