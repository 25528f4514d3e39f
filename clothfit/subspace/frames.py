"""What a player needs of a frame besides its coordinates: the positions in single precision, normals, and
vertices pushed out of the scene's obstacles.

Normals come from the faces around every vertex, or straight from the coordinates by linear regression: n ≈ N (1, q), a
product like that of the positions, which a graph, a shader, or one product for many instances gives. N minimises
Σ |N (1, q) − n|² over frames of the recorded motions, n the exact normals of the full cloth, weighted by the areas of
the faces. Its columns are found with the coordinates scaled to a variance of 1 and a ridge that holds those back that
the frames hardly show.

D. Holden et al., Subspace Neural Physics, SCA 2019, section 4.4.

What a basis leaves out may put a limb through a sleeve. So a vertex at
the distance δ < d from the surface of an obstacle goes by (d − δ) n to the distance d, n the outward normal there. On
spheres, planes and capsules with two radii, where δ is the distance to the whole obstacle also from inside, that is the
shortest way. Fixed vertices stay. A vertex between several obstacles is pushed by one after the other, a few times
around.
"""

from __future__ import annotations

from collections.abc import Iterable
from math import sqrt

import numpy as np
from numpy.typing import NDArray

from clothfit.base.arrays import Array, Indices
from clothfit.base.errors import InvalidInput
from clothfit.engine.forces import collider_rows, spheres
from clothfit.engine.inputs.tables import set_frame
from clothfit.engine.system import System
from clothfit.kernels.kernel import kernel
from clothfit.kernels.lanes.operations import lane0, lane1, lane2, pack


class Decoder:
    """Positions and normals of a frame of N instances, fast: one product in single precision. What it gives is valid
    until the next call.
    """

    def __init__(
        self, x0: Array, basis: Array, triangles: Indices, regression: NDArray[np.float32] | None = None
    ) -> None:
        """`x0` (n, 3), m, `basis` (n, 3, r), faces (T, 3) and the regression of normals, (n, 3, 1 + r)."""
        self.regression = None if regression is None else regression.reshape(-1, basis.shape[2] + 1)
        self.basis = np.ascontiguousarray(basis.reshape(-1, basis.shape[2]), np.float32)
        self.x0, self.triangles = x0.astype(np.float32).ravel(), np.ascontiguousarray(triangles, np.int32)
        self.x, self.n = np.empty((2, 0, len(self.x0)), np.float32)

    def room(self, count: int) -> None:
        """Memory for so many instances."""
        if len(self.x) != count:
            self.x, self.n = np.empty((2, count, len(self.x0)), np.float32)

    def positions(self, q: Array) -> NDArray[np.float32]:
        """Positions (N, n, 3), m, of coordinates (N, r)."""
        self.room(len(q))
        np.dot(q.astype(np.float32), self.basis.T, out=self.x)
        self.x += self.x0
        return self.x.reshape(len(q), -1, 3)

    def normals(self, x: NDArray[np.float32]) -> NDArray[np.float32]:
        """Unit normals (N, n, 3) of the vertices at positions (N, n, 3), weighted by the areas of the faces around."""
        self.room(len(x))
        n = self.n.reshape(x.shape)
        for each, out in zip(x, n, strict=True):
            fill_normals(self.triangles, each, out)
        return n

    def predicted(self, q: Array) -> NDArray[np.float32]:
        """Unit normals (N, n, 3) by regression, from coordinates (N, r) alone."""
        assert self.regression is not None
        self.room(len(q))
        np.dot(np.concatenate([np.ones((len(q), 1)), q], axis=1).astype(np.float32), self.regression.T, out=self.n)
        n = self.n.reshape(-1, 3)
        make_unit(n)
        return n.reshape(len(q), -1, 3)


@kernel
def fill_normals(triangles, x, out):
    """Write the normals (n, 3); 0 where there is no face."""
    out[:] = 0.0
    for i in range(len(triangles)):
        a, b, c = triangles[i, 0], triangles[i, 1], triangles[i, 2]
        p0, p1, p2 = x[b, 0] - x[a, 0], x[b, 1] - x[a, 1], x[b, 2] - x[a, 2]
        q0, q1, q2 = x[c, 0] - x[a, 0], x[c, 1] - x[a, 1], x[c, 2] - x[a, 2]
        n0, n1, n2 = p1 * q2 - p2 * q1, p2 * q0 - p0 * q2, p0 * q1 - p1 * q0
        for j in (a, b, c):
            out[j, 0] += n0
            out[j, 1] += n1
            out[j, 2] += n2
    make_unit(out)


@kernel
def make_unit(out):
    """Make vectors (n, 3) unit vectors; those of 0 stay."""
    for j in range(len(out)):
        size = sqrt(out[j, 0] * out[j, 0] + out[j, 1] * out[j, 1] + out[j, 2] * out[j, 2])
        if size > 0.0:
            out[j, 0] /= size
            out[j, 1] /= size
            out[j, 2] /= size


RIDGE = 1e-6
"""Of the scaled coordinates, relative to the number of frames."""

MOST_FRAMES = 800
"""That the regression sees, spread over all motions."""


def regression(frames: Iterable[tuple[Array, Array]], triangles: Indices) -> NDArray[np.float32]:
    """N (n, 3, 1 + r) from coordinates (F, r) and positions (F, n, 3), part by part, for faces (T, 3)."""
    faces = np.ascontiguousarray(triangles, np.int32)
    gram, onto, count = np.zeros(0), np.zeros(0), 0
    for q, x in frames:
        known = np.column_stack([np.ones(len(q)), q])
        if not count:
            gram, onto = np.zeros((known.shape[1],) * 2), np.zeros((known.shape[1], x[0].size))
        normals = np.empty(x.shape, np.float32)
        for each, out in zip(x, normals, strict=True):
            fill_normals(faces, np.ascontiguousarray(each, np.float32), out)
        gram += known.T @ known
        onto += known.T @ normals.reshape(len(q), -1)
        count += len(q)
    scale = np.sqrt(np.maximum(np.diag(gram) / max(count, 1), 1e-300))
    ridge = np.full(len(scale), RIDGE * count)
    ridge[0] = 0.0
    found = np.linalg.solve(gram / np.outer(scale, scale) + np.diag(ridge), onto / scale[:, None]) / scale[:, None]
    return np.ascontiguousarray(found.T.reshape(-1, 3, len(scale)), np.float32)


def angles(a: NDArray[np.floating], b: NDArray[np.floating]) -> Array:
    """The angles (…), degrees, between unit vectors (…, 3); NaN where one of them is 0, as there are no faces."""
    with np.errstate(invalid="ignore"):
        gap, both = np.linalg.norm(a - b, axis=-1), np.linalg.norm(a + b, axis=-1)
        none = (np.abs(a).sum(axis=-1) == 0.0) | (np.abs(b).sum(axis=-1) == 0.0)
    return np.where(none, np.nan, np.degrees(2.0 * np.arctan2(gap, both)))


ROUNDS = 3
"""How often all obstacles get their turn."""


def push_all(system: System, x: Array, distance: float = 0.0) -> None:
    """Push the vertices of all frames, positions (F, n, 3), m, in place. Raises InvalidInput where there are no
    obstacles, or the distance is below 0.
    """
    if not (np.isfinite(distance) and distance >= 0.0):
        raise InvalidInput(f"--push-out must be at least 0; {distance:g} m was given")
    if not len(system.spheres.radius) and (system.colliders is None or not len(system.colliders.rows)):
        raise InvalidInput("--push-out: the scene has no obstacles")
    for frame, each in enumerate(x):
        set_frame(system.inputs, system, frame)
        push(system.spheres, system.colliders, system.vertex.free, each, distance)


@kernel
def push(balls, colliders, free, x, distance):
    """Move positions (n, 3), m, to a distance, m, from the obstacles where they are."""
    for i in range(len(x)):
        if free[i]:
            for _ in range(ROUNDS):
                if not (out_of_spheres(balls, x, i, distance) or out_of_colliders(colliders, x, i, distance)):
                    break


@kernel
def out_of_spheres(balls, x, i, distance):
    """Push one vertex out of the plain spheres; whether it was in any."""
    found = False
    for c in range(len(balls.radius)):
        depth, _, n = spheres.contact(balls, x, i, c)
        if depth + distance > 0.0:
            spheres.add_times(x, i, depth + distance, n)
            found = True
    return found


@kernel(absent=False)
def out_of_colliders(colliders, x, i, distance):
    """The same for all other obstacles."""
    found = False
    for c in range(len(colliders.rows)):
        own = colliders.rows[c]
        p = pack(x[i, 0], x[i, 1], x[i, 2], 0.0)
        delta, _, _, inner, _, _ = collider_rows.measured(colliders.bodies, own, i, p)
        depth = distance - delta
        if depth > 0.0:
            n = collider_rows.outward(own, inner)
            x[i, 0] += depth * lane0(n)
            x[i, 1] += depth * lane1(n)
            x[i, 2] += depth * lane2(n)
            found = True
    return found
