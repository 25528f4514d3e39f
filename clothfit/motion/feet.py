"""Points of scans, and where the faces of a cloth are nearest to them.

No point of a scan is a point of another frame. What of it is compared is how far each point y is from the cloth, by the
nearest place q = Σ_j b_j x_j of its triangles, b ≥ 0:

    r = n·(q − y),    ∂r/∂x_j = b_j n

with n the normal of the triangle where q is inside it, so that r has a sign, else the direction of q − y. As q is the
nearest place, its own change along the surface changes r by nothing: the derivative is exact with q held. Gauss–Newton
with it is the point-to-plane step of registration (Y. Chen, G. Medioni, 1992), in which points may slide.

q is sought from the triangle on which a point was before, else from the nearest of some around, over those that share a
vertex, as long as one is nearer.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from clothfit.base.arrays import Array, Flags, Indices
from clothfit.engine.forces import bodies, triangle
from clothfit.kernels.kernel import kernel
from clothfit.kernels.lanes.operations import load3, mul, splat, store3, sub
from clothfit.kernels.vectors import cross, dot

UNKNOWN = -1
"""The face of a point that is on none yet."""

CANDIDATES = 12
"""Triangles with the nearest centres, of which the nearest one is that of a point: a fold has some layers."""

NO_DIRECTION = 1e-12
"""Distance, m, of a place on an edge below which the normal of its triangle stands for the direction to it."""


class Feet(NamedTuple):
    """The places of a cloth that are nearest to m points."""

    faces: Indices  # (m,), triangles
    weights: Array  # b (m, 3), of their corners
    normals: Array  # n (m, 3)
    gaps: Array  # r (m,), m
    inside: Flags  # (m,), which are inside triangles; at a hem r has no sign


class Faces(NamedTuple):
    """The triangles of a mesh, and which of them share a vertex."""

    triangles: Indices  # (T, 3)
    begin: Indices  # (T + 1,), where the neighbours of each begin in `near`
    near: Indices

    @classmethod
    def of(cls, triangles: Indices, vertices: int) -> Faces:
        """Those of triangles (T, 3) of so many vertices."""
        from scipy.sparse import csr_array

        count = len(triangles)
        corner = np.repeat(np.arange(count, dtype=np.int32), 3), np.ascontiguousarray(triangles).ravel()
        of = csr_array((np.ones(3 * count), corner), shape=(count, vertices))
        shared = csr_array(of @ of.T)
        return cls(
            np.ascontiguousarray(triangles, np.int32), shared.indptr.astype(np.int32), shared.indices.astype(np.int32)
        )

    def feet(self, points: Array, faces: Indices, x: Array) -> Feet:
        """The places nearest to points (m, 3) of a cloth at x (n, 3), sought from their faces (m,)."""
        from scipy.spatial import KDTree

        found, x = np.array(faces, np.int32), np.ascontiguousarray(x)
        if (lost := found < 0).any():
            tree = KDTree(np.nan_to_num(x[self.triangles].mean(axis=1)))
            near = np.asarray(tree.query(points[lost], k=np.arange(1, min(CANDIDATES, len(self.triangles)) + 1))[1])
            chosen = near[:, 0].astype(np.int32)
            choose(np.ascontiguousarray(points[lost]), x, self.triangles, near, chosen)
            found[lost] = chosen
        weights, normals = np.empty((2, len(found), 3))
        made = Feet(found, weights, normals, np.empty(len(found)), np.empty(len(found), bool))
        find(np.ascontiguousarray(points), x, *self, *made)
        return made


@kernel
def corners(x, triangles, f):
    """The corners of triangle f."""
    return load3(x, triangles[f, 0]), load3(x, triangles[f, 1]), load3(x, triangles[f, 2])


@kernel
def away(p, x, triangles, f):
    """The part of triangle f that is nearest to p, its weights, and the way there from p."""
    a, b, c = corners(x, triangles, f)
    part, wb, wc = triangle.nearest(p, a, b, c)
    return part, wb, wc, sub(triangle.weighted(wb, wc, a, b, c), p)


@kernel
def choose(points, x, triangles, near, faces):
    """Write the triangles into `faces` (m,) that are nearest to points, of those `near` each (m, k)."""
    for i in range(len(points)):
        p, least = load3(points, i), np.inf
        for f in near[i]:
            way = away(p, x, triangles, f)[3]
            if dot(way, way) < least:
                faces[i], least = f, dot(way, way)


@kernel
def find(points, x, triangles, begin, near, faces, weights, normals, gaps, inside):
    """What `Feet` has, from the triangles in `faces` (m,), which are replaced."""
    for i in range(len(points)):
        p, best = load3(points, i), faces[i]
        part, wb, wc, way = away(p, x, triangles, best)
        least, before = dot(way, way), -1
        while before != best:
            before = best
            for k in range(begin[before], begin[before + 1]):
                other, other_b, other_c, other_way = away(p, x, triangles, near[k])
                square = dot(other_way, other_way)
                if square < least:
                    part, wb, wc, way, least, best = other, other_b, other_c, other_way, square, near[k]
        size = np.sqrt(least)
        if part == triangle.FACE or size < NO_DIRECTION:
            a, b, c = corners(x, triangles, best)
            n = cross(sub(b, a), sub(c, a))
            n = mul(splat(1.0 / max(np.sqrt(dot(n, n)), 1e-300)), n)
        else:
            n = mul(splat(1.0 / size), way)
        faces[i], gaps[i], inside[i] = best, dot(n, way), part == triangle.FACE
        weights[i, 0], weights[i, 1], weights[i, 2] = 1.0 - wb - wc, wb, wc
        store3(n, normals, i)


def nearest(points: Array, x: Array, triangles: Indices) -> tuple[Indices, Array]:
    """The corners (m, 3) of those triangles (T, 3) of a mesh at x (N, 3) that points (m, 3) are nearest to, of all of
    them, and how far the points are from them (m,), m.
    """
    mesh = bodies.build([bodies.Surface(x, triangles, np.zeros_like(triangles))], len(points))
    distances = np.empty(len(points))
    measure(mesh, np.ascontiguousarray(points), distances)
    return mesh.triangles[mesh.last[0]], distances


@kernel
def measure(mesh, points, distances):
    """Write the distances of points; `mesh.last` then has the triangle that each is nearest to."""
    for i in range(len(points)):
        p = load3(points, i)
        distances[i] = np.sqrt(bodies.nearest_part(mesh, bodies.nearest(mesh, 0, i, p)[0], p)[3])
