"""The elements of a cloth's forces as the subspace sees them: few points, copies of points, and the engine's forces;
and an iteration of an implicit step on these copies.

With x = x₀ + U q on the free vertices, a force element depends on q through few rows: a spring through the difference
of its ends, a face through its corners, a contact through its vertex. These are the *points*, (m, 3),

    y = c + R q,   c the part of the fixed vertices, of x₀ and of what carries them (`translation`),
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

from copy import copy
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from clothfit.base.arrays import Array, Indices, aligned
from clothfit.base.errors import InvalidInput
from clothfit.engine.forces import applied, bodies, collider_rows, contact, faces, spheres, springs, vertex, wind
from clothfit.engine.inputs import tables
from clothfit.engine.inputs.tables import set_inputs
from clothfit.engine.solve.sparse import BLOCK_SIZE, XX, XY, XZ, YY, YZ, ZZ
from clothfit.engine.system import BDF2, IMPLICIT, System, meets_itself
from clothfit.kernels.kernel import kernel
from clothfit.subspace import translation
from clothfit.subspace.physics.dense import LANES


class Selection(NamedTuple):
    """Which elements are evaluated, and how often each counts."""

    springs: Indices  # (s,)
    spring_weight: Array  # (s,)
    faces: Indices  # (f,)
    face_weight: Array  # (f,)
    vertices: Indices  # (c,), those that may touch something
    vertex_weight: Array  # (c,)

    @property
    def counts(self) -> dict[str, int]:
        """The numbers of elements by their kind."""
        return {"springs": len(self.springs), "faces": len(self.faces), "vertices": len(self.vertices)}


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


class Fixed(NamedTuple):
    """What no step changes."""

    rows: NDArray[np.float32]  # R, (3 m, w)
    mass: Array  # Uᵀ M U, (r, r)
    weight: Array  # Uᵀ M 1, (r, 3)
    alpha: float  # damping of the vertices, 1/s
    path: Array  # (T, P + 1, 3), m, of the pins and their mean
    held: Array  # (P + 1, 3), m, where they start
    v_held: Array  # (P + 1, 3), m/s
    h: float  # s
    iterations: int
    second: bool  # whether steps are those of BDF2


class Sampled(NamedTuple):
    """The forces on the copies: what of a System the kernels need."""

    h: float  # s
    springs: springs.Springs  # between copy 0 and those of the springs
    faces: faces.Faces
    spheres: spheres.Spheres
    colliders: collider_rows.Colliders | None
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


def of_vertices(own: collider_rows.Colliders | None, vertices: Indices) -> collider_rows.Colliders | None:
    """Colliders with memory of their own, for these vertices of the cloth only."""
    if own is None:
        return None
    meshes: bodies.Bodies = bodies.copied(own.bodies)
    meshes = meshes._replace(last=np.ascontiguousarray(meshes.last[:, vertices]))
    count = len(own.rows)
    places = (np.arange(count)[:, None] * (len(own.depth) // max(count, 1)) + vertices).ravel()
    part = {name: getattr(own, name)[places] for name in ("depth", "point", "origin")}
    whole = {name: getattr(own, name).copy() for name in ("rows", "turn", "span", "posed")}
    part |= {name: np.ascontiguousarray(getattr(own, name)[:, places]) for name in ("on", "load", "of_load")}
    return own._replace(**part, **whole, bodies=meshes)


def blocks(layout: Layout) -> Blocks:
    """Memory for the matrix of a step on the copies."""
    return Blocks(aligned(len(layout.point) + 1, BLOCK_SIZE), aligned(1, BLOCK_SIZE))


@kernel
def begin(own, t):
    """Set the inputs of step t."""
    set_inputs(own.inputs, own, t)
    contact.clear(own.colliders)


@kernel
def spread(lay, points, out):
    """Give every copy the values of its point; the origin keeps 0."""
    for i in range(1, len(out)):
        j = lay.point[i]
        out[i, 0], out[i, 1], out[i, 2] = points[j, 0], points[j, 1], points[j, 2]


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
    contact.add_step(own.colliders, y[f:], u[f:], h, ahead, Blocks(A.diagonal[f:], A.upper), b[f:])


@kernel
def place_pins(fixed, pins, t, second, h):
    """Where a step of the pins and their mean begins, their velocities there, and that with which they go on, in `pins`
    as `march.Work` has them.
    """
    path = fixed.path
    for p in range(pins.shape[1]):
        for c in range(3):
            x, v = path[t, p, c], pin_velocity(fixed, t, p, c)
            pins[1, p, c] = v
            if second:
                before = pin_velocity(fixed, t - 1, p, c)
                pins[1, p, c] = 2.0 * v - before
                x, v = x + (x - path[t - 1, p, c]) / 3.0, v + (v - before) / 3.0
            pins[2, p, c] = (path[t + 1, p, c] - x) / h
            pins[3, p, c], pins[4, p, c] = x, v


@kernel
def pin_velocity(fixed, t, p, c):
    """A component of the velocity of a pin before step t."""
    path, h = fixed.path, fixed.h
    if t == 0:
        return fixed.v_held[p, c]
    if fixed.second and t > 1:
        return (1.5 * path[t, p, c] - 2.0 * path[t - 1, p, c] + 0.5 * path[t - 2, p, c]) / h
    return (path[t, p, c] - path[t - 1, p, c]) / h


TINY = 1e-13
"""What of a block's pivot is rounding, relative to its trace."""


def factors(D: Array) -> tuple[Array, Array]:
    """Symmetric blocks (c, 3, 3) as Σ d l lᵀ, largest pivot first: all l (c, 3, 3), a row each, and d (c, 3), 0 for
    those that are not needed.
    """
    least, every = TINY * np.abs(np.diagonal(D, axis1=1, axis2=2)).sum(axis=1), np.arange(len(D))
    lines, pivots, needed = np.zeros(D.shape), np.zeros(D.shape[:2]), np.ones(len(D), bool)
    for k in range(3):
        size = np.abs(np.diagonal(D, axis1=1, axis2=2))
        at = size.argmax(axis=1)
        needed &= ~(size.max(axis=1) <= least)
        pivots[needed, k] = D[every, at, at][needed]
        lines[needed, k] = D[every, at][needed] / pivots[needed, k, None]
        upper = np.triu(D - (pivots[:, k, None] * lines[:, k])[:, :, None] * lines[:, k, None, :])
        D = upper + np.triu(upper, 1).swapaxes(1, 2)
    return lines, pivots


def wide(rows: Array) -> NDArray[np.float32]:
    """The same rows (3 m, r) in single precision, with as many columns as whole registers hold."""
    made = np.zeros((len(rows), LANES * -(-rows.shape[1] // LANES)), np.float32)
    made[:, : rows.shape[1]] = rows
    return made


class Reduced:
    """A cloth on a basis: its state is q and p (r,), positions x₀ + T + U q and velocities Ṫ + U p of the free
    vertices, with T what carries them (`translation`).

    Here is what no step changes, and the equations of a step at a state, for a cubature; `march` takes the steps. They
    are those of the scene's method, projected: implicit Euler with all its Newton iterations, or BDF2 whose inner step
    begins at the extrapolated state, as `engine.step.bdf2` has it, also where something is hit. Steps are never
    shortened (`engine.step.guard`).
    """

    def __init__(self, system: System, basis: Array, chosen: Selection | None = None) -> None:
        """`basis` U (n, 3, r), 0 at fixed vertices. Raises InvalidInput for what subspaces do not have."""
        check_reducible(system)
        self.system, self.basis = system, np.ascontiguousarray(basis)
        self.chosen = everything(system) if chosen is None else chosen
        self.layout, self.own = build(system, basis, self.chosen)
        self.r = basis.shape[2]
        weighted = self.basis * system.vertex.mass[:, None, None]
        mass = np.ascontiguousarray(weighted.reshape(-1, self.r).T @ self.basis.reshape(-1, self.r))
        weight = np.ascontiguousarray(weighted.sum(axis=0).T)
        self.fixed = Fixed(
            wide(self.layout.rows), mass, weight, float(system.vertex.damping[0]), *translation.paths(system), system.h,
            system.newton_iterations, system.method == BDF2
        )  # fmt: skip

    def under(self, system: System) -> Reduced:
        """The same cloth under other inputs over time, with the same pins; it shares memory with this one."""
        other = copy(self)
        other.system, other.own = system, self.own._replace(inputs=system.inputs)
        path, held, v_held = translation.paths(system)
        other.fixed = self.fixed._replace(path=path, held=held, v_held=v_held)
        return other

    def pins(self, t: int) -> Array:
        """Of the pins and their mean, (P + 1, 3) each, before an implicit Euler step: places, velocities, and those of
        the step.
        """
        found = np.zeros((5, len(self.fixed.held), 3))
        if len(self.fixed.path):
            place_pins(self.fixed, found, t, False, self.fixed.h)
        return found[[3, 4, 2]]

    def at_copies(self, points: Array, pins: Array) -> Array:
        """The values (copies, 3) of points (m, 3) with the part of the pins and their mean (P + 1, 3), which is added
        in place; the origin has 0.
        """
        lay = self.layout
        np.add.at(points, lay.pinned[:, 0], lay.sign[:, None] * pins[lay.pinned[:, 1]])
        found = points[lay.point]
        found[0] = 0.0
        return found

    def linearised(self, q: Array, p: Array, t: int, cap: float = np.inf) -> tuple[Array, Array]:
        """The blocks (copies, 3, 3) and the right-hand sides b (copies, 3) of an implicit Euler step t from a state q,
        p (r,), with springs that push sideways up to `cap` times as much as they pull.
        """
        begin(self.own, t)
        lay, still = self.layout, np.zeros_like(self.layout.constant)
        x, v, _ = self.pins(t)
        y, u = (self.at_copies(still.copy(), pins) for pins in (x - self.fixed.held, v))
        y[1:] += ((lay.rows @ q).reshape(-1, 3) + lay.constant)[lay.point[1:]]
        u[1:] += (lay.rows @ p).reshape(-1, 3)[lay.point[1:]]
        forces = self.own._replace(springs=self.own.springs._replace(cap=cap, bend=0.0))
        A, b = blocks(lay), np.zeros_like(y)
        assemble(forces, lay, y, u, self.fixed.h, False, A, b)
        return A.diagonal[: len(b), [[XX, XY, XZ], [XY, YY, YZ], [XZ, YZ, ZZ]]], b

    def impulses(self, q: Array, p: Array, w: Array, t: int) -> Array:
        """The momentum (elements, r) that each element adds in a step to a velocity w (r,): springs, faces, vertices.
        """
        lay = self.layout
        D, b = self.linearised(q, p, t)
        w = self.at_copies((lay.rows @ w).reshape(-1, 3), self.pins(t)[2])
        given = b - (D[:, :, 0] * w[:, :1] + D[:, :, 1] * w[:, 1:2] + D[:, :, 2] * w[:, 2:])
        rows, (s, f, _) = lay.rows.reshape(-1, 3, self.r), lay.ends
        own = [np.einsum("ic,icr->ir", given[i:j], rows[lay.point[i:j]]) for i, j in ((1, s), (s, f), (f, len(given)))]
        own[1] = own[1].reshape(-1, 3, self.r).sum(axis=1)
        return np.concatenate(own)

    def matrix(self, D: Array) -> Array:
        """The projected matrix (r, r) of such blocks."""
        lay = self.layout
        lines, pivots = factors(D)
        scale = lay.weight[:, None] * pivots
        A = (1.0 + self.fixed.h * self.fixed.alpha) * self.fixed.mass
        for sign in (1.0, -1.0):
            i, k = np.nonzero(sign * scale > 0.0)
            along, first = np.sqrt(sign * scale[i, k])[:, None] * lines[i, k], 3 * lay.point[i]
            rows = np.asarray(sum(along[:, c, None] * lay.rows[first + c] for c in range(3)))
            A = A + sign * (rows.T @ rows) if len(rows) else A  # NumPy computes one half of a square
        return np.asarray(A)


def check_reducible(system: System) -> None:
    """Raise InvalidInput for what subspaces do not have."""
    if system.method not in (IMPLICIT, BDF2):
        raise InvalidInput("a subspace needs implicit steps: integrationMethod 2 or 3")
    if meets_itself(system):
        raise InvalidInput("selfCollision: a subspace does not know where a cloth touches itself")
    if system.inputs is not None and (len(system.inputs.force) or len(system.inputs.gain)):
        raise InvalidInput("a subspace has no applied forces")


def decode(system: System, basis: Array, q: Array, first: int = 0) -> Array:
    """Positions (T, n, 3), m, of coordinates (T, r) of the frames from `first` on."""
    x = (q @ basis.reshape(-1, basis.shape[2]).T).reshape(-1, *system.x0.shape) + system.x0
    inputs = system.inputs
    if inputs is not None and inputs.path.size:
        x[:, system.vertex.free] += translation.shift(inputs, len(q), first)
        x[:, inputs.pins] = inputs.path[first : first + len(q)]
    return x
