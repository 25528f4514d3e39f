"""Which places of a scene's mesh the points of a motion show: its vertices in order, in another order, or places inside
its triangles.

A point y that lies inside a triangle, or near one, is bound to the nearest one at the start: it is the mean of the
corners with weights b that sum to 1, and an offset d along the triangle's normal n, which moves with it,

    y = Σ_j b_j x_j + d n(x).

Where all vertices are estimated from the points of a frame, n is known, so that y − d n is linear in x. The estimate X
is the least of |B X − (y − d n(X))|² + ε X'ᵀ K X', with X' the change since the frame before, K the Laplacian of the
mesh, and B the weights of all points. Repeated from its own result, it forgets what ε holds back, as far as the points
determine it: iterated Tikhonov regularisation. A vertex counts as seen where the variance of its estimate, by noise of
variance 1 in the points and by that prior, is at most `DETERMINED`².
"""

from __future__ import annotations

from itertools import groupby
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from clothfit.base.arrays import Array, Flags, Indices
from clothfit.base.errors import InvalidMotion
from clothfit.base.messages import counted, metres
from clothfit.formats.axes import AUTO, ORDER, SURFACE
from clothfit.motion.feet import Faces, Feet, nearest
from clothfit.scene.mesh_numbering import triangles_of
from clothfit.scene.scene import Scene

if TYPE_CHECKING:
    from scipy.sparse import csr_array

SAME, PERMUTED, ON_SURFACE, MARKERS, SCANNED = "same", "permuted", "surface", "markers", "scan"

ELSEWHERE, MISLABELLED = 0.25, 0.25
"""How much farther than the nearest one, in median edges, the vertex of its number is from a point that is another's;
and the share of such points up to which some are mistaken, and the order is right.
"""

CLEAR = 0.5
"""Distance to the nearest vertex, relative to the next one, up to which it is that one beyond doubt."""

FAR, FEW = 0.5, 0.02
"""Distance from the nearest triangle, in its own mean edges, from which on a point is bound to none; and the share of
such points that are left out without a refusal.
"""

LEAST = 0.1
"""Extent of the points relative to the mesh: less is no picture of it."""

PRIOR, DETERMINED = 1e-4, 5.0
"""ε relative to the largest diagonal of BᵀB; and how much larger than that of points noise of a vertex may be."""

ROUNDS, CONVERGED = 30, 1e-13
"""Repetitions of an estimate, at most, and its change relative to the mesh at which they end."""

SAMPLES = 48
"""By which variances are estimated, to 10 %."""


class Correspondence(NamedTuple):
    """What the points of a motion show of a scene with N vertices."""

    kind: str = SAME
    share: float = 1.0  # of the points that are used
    weights: csr_array | None = None  # B (m, N) of points inside triangles; None: the points are vertices
    points: Array = np.zeros((0, 0, 3))  # y − d n, (frames, m, 3), m; of a scan y, in no order
    seen: Flags = np.zeros((0, 0), bool)  # (frames, m)
    faces: Indices = np.zeros((0, 0), np.int32)  # (frames, m), triangles of `mesh` that points of a scan are near to
    mesh: Faces | None = None  # of a scan, all objects of the scene; None: it is none
    normals: Array | None = None  # (frames, m, 3), of the surface at points of a scan; None: not known
    figures: dict[str, Any] | None = None  # of a scan: one-sided distances, m, and the share of vertices never seen

    def summary(self) -> dict[str, Any]:
        """As --json gives it."""
        return {"kind": self.kind, "share": self.share, **(self.figures or {})}

    def feet(self, s: Array, frame: int) -> Feet:
        """The places of a state s (n, 3) that are nearest to the points that a frame of a scan shows."""
        assert self.mesh is not None
        seen = self.seen[frame]
        return self.mesh.feet(self.points[frame, seen], self.faces[frame, seen], s)

    def at(self, frames: slice) -> Correspondence:
        """The same at some frames only."""
        if not len(self.seen):
            return self
        normals = None if self.normals is None else self.normals[frames]
        return self._replace(
            points=self.points[frames], seen=self.seen[frames], faces=self.faces[frames], normals=normals
        )


IN_ORDER = Correspondence()


class Bound(NamedTuple):
    """Positions of a scene's vertices by what the points of a motion show."""

    positions: Array  # (frames, N, 3), m
    observed: Flags  # (frames, N)
    correspondence: Correspondence
    order: Indices | None = None  # (N,), the points that are the vertices
    note: str | None = None  # a sentence on how the points were bound


class TooFar(InvalidMotion):
    """Points that are too far from a mesh to be bound to it."""


class Places(NamedTuple):
    """Places of m points on a mesh."""

    corners: Indices  # (m, 3), vertices
    weights: Array  # (m, 3), which sum to 1
    offset: Array  # d (m,), m, along the normal
    distance: Array  # (m,), m, from the triangle
    edge: Array  # (m,), m, mean edge of the triangle

    def some(self, kept: Flags) -> Places:
        """The places of some of the points."""
        return Places(
            self.corners[kept], self.weights[kept], self.offset[kept], self.distance[kept], self.edge[kept]
        )


def bind(points: Array, seen: Flags, scene: Scene, start: Array, how: str, chosen: Indices | None, name: str) -> Bound:
    """Bind points (frames, m, 3), m, `seen` (frames, m), to a scene whose vertices are at `start` (N, 3).

    `how`: one of `BINDINGS`. `chosen` (N,): the points that are the vertices in order, where there may be such; None:
    their numbers are other ones. Raises TooFar.
    """
    ordered = None if chosen is None else Bound(points[:, chosen], seen[:, chosen], Correspondence(), chosen)
    if ordered is not None and how != SURFACE and (how == ORDER or in_order(ordered, start, scene)):
        return ordered
    if how == AUTO and points.shape[1] == len(start):
        order = other_order(points[0], seen[0], start)
        if order is not None:
            note = "its vertices are the scene's in another order, which its first frame shows"
            return Bound(points[:, order], seen[:, order], Correspondence(PERMUTED), order, note)
    try:
        return on_surface(points, seen, scene, start, name)
    except TooFar:
        if ordered is None or how != AUTO:
            raise
        return ordered  # in another place or unit, of which `foreign.alignment` speaks


def in_order(given: Bound, start: Array, scene: Scene) -> bool:
    """Whether the first frame does not show most vertices where others are."""
    from scipy.spatial import KDTree

    seen = given.observed[0]
    lengths = [cloth.lengths for cloth in scene.cloths if len(cloth.lengths)]
    if not seen.any() or not lengths:
        return True
    points = given.positions[0][seen]
    gap = np.linalg.norm(points - start[seen], axis=1) - KDTree(start).query(points)[0]
    return bool((gap > ELSEWHERE * np.median(np.concatenate(lengths))).mean() <= MISLABELLED)


def other_order(points: Array, seen: Flags, start: Array) -> Indices | None:
    """The point (N,) that is each of the vertices at `start` (N, 3), by a frame (N, 3); None where that is not plain.
    """
    from scipy.spatial import KDTree

    if not seen.all() or len(start) < 2:
        return None
    found = KDTree(start).query(points, k=2)
    distance, vertex = np.asarray(found[0]), np.asarray(found[1])
    if (distance[:, 0] > CLEAR * distance[:, 1]).any() or len(np.unique(vertex[:, 0])) < len(start):
        return None
    return np.asarray(np.argsort(vertex[:, 0]), np.int32)


def on_surface(points: Array, seen: Flags, scene: Scene, start: Array, name: str) -> Bound:
    """Bind points inside triangles by the first frame. Raises TooFar."""
    triangles = triangles_of(scene)
    there = np.flatnonzero(seen[0])
    size = f"{name}: has {points.shape[1]} points, {scene.name} has {len(start)} vertices"
    if not len(there) or not len(triangles):
        why = "is seen in the first frame" if len(triangles) else "could be bound: the scene has no faces"
        raise TooFar(f"{size}, and none of the points {why}")
    extents = [float(np.linalg.norm(np.ptp(x, axis=0))) for x in (points[0, there], start)]
    if extents[0] < LEAST * extents[1]:
        raise TooFar(f"{size}; in the first frame they span {metres(extents[0])} of the mesh's {metres(extents[1])}")
    found = places(points[0, there], start, triangles)
    near = near_enough(found, size)
    there, found = there[near], found.some(near)
    share = len(there) / points.shape[1]
    offsets = metres(float(np.sqrt(np.mean(found.offset**2))))
    note = f"{counted(len(there), 'point', 'points')} bound inside triangles of the mesh, {offsets} off it (RMS)"
    if len(there) < points.shape[1]:
        note += f"; {points.shape[1] - len(there)} are left out, as they lie off the mesh or start unseen"
    shown = np.ascontiguousarray(seen[:, there])
    x, known, plain = estimated(points[:, there], shown, found, scene, start)
    return Bound(x, known, Correspondence(ON_SURFACE, share, weights_of(found, len(start)), plain, shown), None, note)


def near_enough(found: Places, size: str) -> Flags:
    """Which of the points (m,) are near their triangles. Raises TooFar, which begins with their `size`, where too many
    are not.
    """
    near = found.distance <= FAR * found.edge
    if not near.mean() >= 1.0 - FEW:
        raise TooFar(
            f"{size}; {100 * (1 - near.mean()):.3g} % of the points lie more than half an edge "
            f"({metres(FAR * float(np.median(found.edge)))}) from the mesh in the first frame, up to "
            f"{metres(float(found.distance.max()))}; at most {100 * FEW:.0f} % may"
        )
    return np.asarray(near)


def embedded(x: Array, scene: Scene, points: Array, name: str) -> Array:
    """Where a motion x (frames, N, 3) of a scene takes points (m, 3) of another mesh that lies on it in its first
    frame (frames, m, 3); each with the triangle that is nearest there. Raises TooFar.
    """
    triangles = triangles_of(scene)
    if not len(triangles):
        raise TooFar(f"{scene.name}: has no faces to bind {name} to")
    found = places(points, x[0], triangles)
    near_enough(found, f"{name}: has {len(points)} points, {scene.name} has {x.shape[1]} vertices")
    B = weights_of(found, x.shape[1])
    return np.stack([B @ each + found.offset[:, None] * normals(each, found.corners) for each in x])


def weights_of(found: Places, vertices: int) -> csr_array:
    """B (m, N)."""
    return weights_of_corners(found.corners, found.weights, vertices)


def weights_of_corners(corners: Indices, weights: Array, vertices: int) -> csr_array:
    """B (m, N) of points with weights (m, 3) of corners (m, 3)."""
    from scipy.sparse import csr_array

    rows = np.repeat(np.arange(len(corners)), 3)
    return csr_array((weights.ravel(), (rows, corners.ravel())), shape=(len(corners), vertices))


def places(points: Array, start: Array, triangles: Indices) -> Places:
    """The places of points (m, 3) in the nearest of the triangles (T, 3) of a mesh at `start` (N, 3)."""
    edge, area = edges(start, triangles), np.linalg.norm(np.cross(*sides(start, triangles)[:2]), axis=1)
    whole = triangles[area > 1e-9 * edge.max(axis=1) ** 2]
    corners, away = nearest(points, start, whole)
    weights = barycentric(points, *start[corners].transpose(1, 0, 2))
    offset = ((points - start[corners[:, 0]]) * normals(start, corners)).sum(axis=1)
    return Places(corners, weights, offset, away, edges(start, corners).mean(axis=1))


def sides(x: Array, triangles: Indices) -> Array:
    """The vectors (3, m, 3) along the sides of triangles (m, 3) at x (N, 3)."""
    return np.stack([x[triangles[:, (k + 1) % 3]] - x[triangles[:, k]] for k in range(3)])


def edges(x: Array, triangles: Indices) -> Array:
    """The lengths (m, 3) of the sides of triangles."""
    return np.asarray(np.linalg.norm(sides(x, triangles), axis=2).T)


def normals(x: Array, corners: Indices) -> Array:
    """Unit normals (m, 3) of triangles with these corners (m, 3) at positions x (N, 3)."""
    a, b, c = x[corners].transpose(1, 0, 2)
    found = np.cross(b - a, c - a)
    return np.asarray(found / np.maximum(np.linalg.norm(found, axis=1, keepdims=True), 1e-300))


def barycentric(p: Array, a: Array, b: Array, c: Array) -> Array:
    """Weights (m, 3) of the corners a, b, c (m, 3) for the points p (m, 3) on the planes of triangles, of any sign."""
    e, g, away = b - a, c - a, p - a
    ee, eg, gg, pe, pg = ((u * v).sum(axis=1) for u, v in ((e, e), (e, g), (g, g), (away, e), (away, g)))
    whole = ee * gg - eg * eg
    second, third = (gg * pe - eg * pg) / whole, (ee * pg - eg * pe) / whole
    return np.stack([1.0 - second - third, second, third], axis=1)


def estimated(points: Array, seen: Flags, found: Places, scene: Scene, start: Array) -> tuple[Array, Flags, Array]:
    """The vertices (frames, N, 3) by points (frames, m, 3) that are `seen`, which of them these determine (frames, N),
    and the points without their offsets.
    """
    B, prior = weights_of(found, len(start)), roughness(scene)
    x, known = np.empty((len(points), *start.shape)), np.zeros((len(points), len(start)), bool)
    plain, size = points.copy(), float(np.ptp(start, axis=0).max())
    for rows, frames in groupby(range(len(points)), key=lambda frame: seen[frame].tobytes()):
        shown = np.frombuffer(rows, bool)
        solve, here = estimator(B[shown], prior)
        for frame in frames:
            now = x[frame - 1].copy() if frame else start.copy()
            for _ in range(ROUNDS):
                plain[frame] = points[frame] - found.offset[:, None] * normals(now, found.corners)
                change = solve(B[shown].T @ (plain[frame] - B @ now)[shown])
                now += change
                if np.abs(change).max(initial=0.0) <= CONVERGED * size:
                    break
            x[frame], known[frame] = now, here
    return x, known, plain


def roughness(scene: Scene) -> csr_array:
    """G of K = GᵀG: a row for each spring and each edge, and little for where each vertex is."""
    from scipy.sparse import csr_array, eye_array, vstack

    triangles, n = triangles_of(scene), sum(scene.vertex_counts)
    springs = [cloth.springs + scene.vertices(i).start for i, cloth in enumerate(scene.cloths)]
    ends = np.concatenate([*springs, *(triangles[:, [k, (k + 1) % 3]] for k in range(3))])
    ends = np.unique(np.sort(ends, axis=1), axis=0)
    rows, signs = np.repeat(np.arange(len(ends)), 2), np.tile([1.0, -1.0], len(ends))
    return csr_array(vstack([csr_array((signs, (rows, ends.ravel())), shape=(len(ends), n)), 1e-2 * eye_array(n)]))


def estimator(B: csr_array, prior: csr_array) -> tuple[Any, Flags]:
    """What gives A⁻¹ times a right-hand side, A = BᵀB + ε K, and which vertices (N,) the points determine."""
    from scipy.sparse import csc_array
    from scipy.sparse.linalg import splu

    square = B.T @ B
    root = np.sqrt(PRIOR * max(float(square.diagonal().max()), 1e-300) / float((prior.T @ prior).diagonal().max()))
    solve = splu(csc_array(square + root**2 * (prior.T @ prior))).solve
    generator = np.random.default_rng(0)
    noise, held = (generator.standard_normal((each.shape[0], SAMPLES)) for each in (B, prior))
    drawn = solve(B.T @ noise + root * (prior.T @ held))  # of the covariance A⁻¹
    return solve, np.asarray((drawn**2).mean(axis=1) <= DETERMINED**2)
