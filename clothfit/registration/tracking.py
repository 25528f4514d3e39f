"""Where the vertices of a cloth are in a scan: the cloth is simulated, and drawn to the points frame by frame.

After the steps to a frame the points y are tied to the nearest places of the cloth (`motion.feet`), as far as they are
within a cap, not much farther than the points around them, and their normals agree. Where they are farther from it
than the noise of the first frame, the least change u of the vertices that brings these near,

    Σ (n·(B u + q − y))² + α |B u + q − y|² + κ |G u|² + λ Σ (e·G u + l − L)² + Σ |u + x − y|²,

G the differences along edges, is added to their positions, and u / t, t the time since the frame before, to their
velocities: an observer with full gain. α keeps points from sliding, κ carries along what is not seen, and smooths. λ
keeps edges, of directions e, as long as they came, L: cloth hardly stretches, so that where it is held, and where it
ends, says where along itself all of it is. The last sum ties vertices x of hems to points, each the nearest of the
other kind, as a point says that there is cloth, but not that there is none beside it. Points are tied again, and the
change repeated, a few times; what is matched in the end belongs to the scan.

J. Schulman et al., Tracking deformable objects with point clouds, 2013, ties points softly and lets an engine draw.
"""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np

from clothfit.base import interrupts
from clothfit.base.arrays import Array, Flags, Indices
from clothfit.base.limits import FIT_TOLERANCE
from clothfit.engine import rollout
from clothfit.engine.rollout import Rollout
from clothfit.engine.step import implicit
from clothfit.engine.system import System, build
from clothfit.motion.correspondence import Correspondence, roughness, weights_of_corners
from clothfit.motion.feet import Faces, Feet
from clothfit.motion.markers import rigid, turns, way_of
from clothfit.motion.motion import in_scene, in_world
from clothfit.motion.times import frame_places
from clothfit.objective.experiment import Experiment
from clothfit.objective.measures import rows_of
from clothfit.scene.directions import edges_of
from clothfit.scene.kinds import REST
from clothfit.scene.scene import Scene, with_places

CAP = 3.0
"""Distance, in median edges, beyond which a point is tied to nothing."""

TRIM, NEAR, FINE = 8.0, 7, 0.05
"""Distance, in medians of those within the cap, or of so many points around if that is more, beyond which a point
counts as an outlier: a part of a cloth that lags does so as a whole. And in median edges, up to which none does.
"""

AGREE = 0.5
"""Cosine of the angle, 60°, up to which the normals of a point and of the cloth agree."""

ALONE = 3.0
"""Mean distance of a point from those around it, in medians of all, beyond which it is an outlier wherever the cloth is
(statistical outlier removal, R. B. Rusu, 2008).
"""

ROUNDS, CONVERGED, SLIDING, SMOOTH, LASTING = 5, 0.01, 0.1, 0.3, 10.0
"""Times that points are tied in each frame, and change, in median edges, at which that ends; α; and κ and λ relative to
the weight of the points of a vertex.
"""

FREE = 1.5
"""Mean square distance of the points of a frame, relative to that of the first one from a cloth that is drawn to it, up
to which a cloth that moves is not drawn: it is where the points are, and noise would shake it.
"""

RESTING = 30
"""Times that points are tied to a cloth at rest, whose shape by other values may have other folds."""

TOLERANCE = 1e-5
"""Of the linear systems of changes, relative; edges and points condition them well."""

MOSTLY = 0.75
"""Share of the points of a first frame that must be within an edge of a mesh that lies there."""

ITERATIONS, POINTS, ALIKE, RELAXING = 20, 300, 1.5, 60
"""Closest points for each turn with so many points, distance relative to the least that is as good, and steps of
relaxing.
"""

SEEN_WEIGHT = 0.25
"""Weight of matched points from which on a vertex counts as seen."""


class State:
    """The objects that are simulated together, step by step."""

    def __init__(self, scene: Scene, first: int, steps: int) -> None:
        self.system: System = build(scene, first, steps=steps)
        self.part = slice(scene.vertices(first).start, scene.vertices(scene.together(first)[-1]).stop)
        self.whole: Rollout = rollout.empty(self.system, steps)
        self.work = implicit.workspace(self.system)

    def advance(self, begin: int, end: int) -> Array:
        """The positions (n, 3) after the steps to `end`; as they were where these diverge."""
        part = self.whole.part(begin, end)
        if rollout.fill(self.system, FIT_TOLERANCE, self.work, part) < end - begin:
            part.x[:] = part.x[0]
            part.w[:] = 0.0
        return np.asarray(part.x[-1])

    def put(self, at: int, change: Array, seconds: float) -> None:
        """Move the vertices after step `at` by a change (n, 3), m, that took so many seconds, and those a step before
        by their part of it, which a BDF2 step goes on from as well.
        """
        self.whole.x[at] += change
        self.whole.x[at - 1] += (1.0 - self.system.h / seconds) * change
        self.whole.w[at - 1, self.whole.used[at - 1] - 1] += change / seconds
        if at > 1:
            self.whole.w[at - 2, self.whole.used[at - 2] - 1] += change / seconds
        else:
            self.whole = self.whole._replace(v=self.whole.v + change / seconds)


def tracked(given: Experiment, rounds: int | None = None) -> Experiment:
    """A scan as a motion of its scene, with the points that are matched; other targets as they are. Points are tied so
    many times in each frame.
    """
    motion, scene = given
    mesh = motion.correspondence.mesh
    if mesh is None:
        return given
    rounds = (RESTING if scene.method == REST else ROUNDS) if rounds is None else rounds
    own = in_world(motion, scene).correspondence
    step, fraction = frame_places(motion, scene.delta)
    at = np.rint(step + fraction).astype(int)
    states = [State(scene, group[0], int(at[-1])) for group in scene.groups]
    draw = Drawing(mesh, scene, ~np.concatenate([cloth.fixed for cloth in scene.cloths]))
    x = np.concatenate([state.whole.x[0] for state in states])
    faces, matched = np.full_like(own.faces, -1), np.zeros_like(own.seen)
    positions, observed = np.tile(x, (len(at), 1, 1)), np.zeros((len(at), len(x)), bool)
    before, noise = 0, 0.0
    for frame, end in enumerate(at):
        seen = own.seen[frame]
        points = own.points[frame, seen]
        normals = None if own.normals is None else own.normals[frame, seen]
        if end > before:
            x = np.concatenate([state.advance(before, end) for state in states])
        _, found, good = draw(x, points, normals, 0)
        if not end and rounds and scene.method != REST:
            noise = left_by(*draw(x, points, normals, rounds)[1:])  # of the first frame, which shows where the cloth is
        elif end > before and rounds and not left_by(found, good) <= FREE * noise:
            drawn, found, good = draw(x, points, normals, rounds)
            for state in states:
                state.put(end, (drawn - x)[state.part], (end - before) * scene.delta)
            x = drawn
        faces[frame, seen], matched[frame, seen] = found.faces, good
        positions[frame] = x
        weight = weights_of_corners(mesh.triangles[found.faces[good]], found.weights[good], len(x)).sum(axis=0)
        observed[frame] = np.asarray(weight).ravel() > SEEN_WEIGHT
        before = end
        interrupts.check()
    share = float(matched.sum() / max(own.seen.sum(), 1))
    bound = motion.correspondence._replace(share=share, seen=matched, faces=faces)
    made = in_scene(replace(motion, positions=positions, observed=None, correspondence=Correspondence()), scene)
    return Experiment(replace(made, observed=observed, correspondence=bound), scene)


def left_by(found: Feet, good: Flags) -> float:
    """The mean square distance, m², of the points that are tied; 0 without any."""
    return float(np.mean(found.gaps[good] ** 2)) if good.any() else 0.0


def placed(given: Experiment) -> Scene:
    """The scene with its mesh on the first frame of a scan, placed rigidly and then relaxed under its own weight while
    it is drawn there; the same object where it lies there already, or would come no nearer. A cloth at rest lies there
    where what is held does.
    """
    motion, scene = given
    scan = motion.correspondence
    if scan.mesh is None or scene.frame is not None or not scan.seen[0].any() or motion.times[0] != 0:
        return scene
    start = np.concatenate([cloth.positions for cloth in scene.cloths])
    draw = Drawing(scan.mesh, scene, np.ones(len(start), bool))
    points = scan.points[0, scan.seen[0]]
    before = np.quantile(np.abs(scan.feet(start, 0).gaps), MOSTLY)
    held = np.concatenate([cloth.fixed for cloth in scene.cloths])
    if before <= draw.edge or (scene.method == REST and not lies_off(start[held], points, draw.edge)):
        return scene
    few = points[:: max(len(points) // POINTS, 1)]
    found = sorted((moved_to(scan.mesh, few, start, R) for R in turns(start, few)), key=lambda each: each[0])
    near = [each for each in found if each[0] <= ALIKE * found[0][0]]  # a square sheet fits in eight ways
    own, size = start[held] if held.any() else start, float(np.linalg.norm(np.ptp(start, axis=0)))
    _, R, d = min(near, key=lambda each: way_of(each[1], each[2], own, size))
    x = start @ R.T + d
    still = with_places(scene, x)
    states = [State(still, group[0], RELAXING) for group in scene.groups]
    for t in range(RELAXING):
        x = np.concatenate([state.advance(t, t + 1) for state in states])
        drawn = draw(x, points, None if scan.normals is None else scan.normals[0, scan.seen[0]], ROUNDS)[0]
        for state in states:
            state.put(t + 1, (drawn - x)[state.part], np.inf)
            state.whole.w[t] = 0.0
        x = drawn
    after = np.quantile(np.abs(scan.feet(x, 0).gaps), MOSTLY)
    return with_places(scene, x) if after < before else scene


def lies_off(held: Array, points: Array, edge: float) -> bool:
    """Whether most held vertices (k, 3) of a cloth, which is elsewhere before it hangs, are more than an edge, m, from
    the points (m, 3) of its scan.
    """
    from scipy.spatial import KDTree

    return len(held) > 0 and float(np.median(KDTree(points).query(held)[0])) > edge


def moved_to(mesh: Faces, points: Array, start: Array, R: Array) -> tuple[float, Array, Array]:
    """The trimmed distance, m, of points (m, 3) from a mesh at R x + d, x = `start` (n, 3), with R and d where iterated
    closest points lead.
    """
    d = points.mean(axis=0) - R @ start.mean(axis=0)
    faces, left = np.full(len(points), -1, np.int32), np.inf
    for _ in range(ITERATIONS):
        x = start @ R.T + d
        found = mesh.feet(points, faces, x)
        away = np.abs(found.gaps)
        left = float(np.quantile(away, MOSTLY))
        near = away <= left
        places = (points + found.gaps[:, None] * found.normals)[near]
        turn, move = rigid(places, points[near])
        R, d = turn @ R, turn @ d + move
    return left, R, d


def median_edge(scene: Scene) -> float:
    """The median length of the springs of a scene, m, at its start."""
    return float(np.median(np.concatenate([cloth.lengths for cloth in scene.cloths])))


class Drawing:
    """What draws the vertices of a mesh to points."""

    def __init__(self, mesh: Faces, scene: Scene, free: Flags) -> None:
        """`mesh`: that of the scene; `free` (n,): which vertices may move."""
        from scipy.sparse import csr_array, diags_array, eye_array, kron

        edges = roughness(scene)  # G
        square = edges.T @ edges
        self.smooth = csr_array(kron(square / float(square.diagonal().mean()), eye_array(3)))
        self.mesh, self.free = mesh, diags_array(np.repeat(free, 3).astype(float))
        self.edge = median_edge(scene)
        sides = edges_of(mesh.triangles)
        self.sides, self.hem = sides.ends, sides.hem

    def __call__(self, x: Array, points: Array, normals: Array | None, rounds: int) -> tuple[Array, Feet, Flags]:
        """Vertices at x (n, 3) after they were drawn to points (m, 3) with normals (m, 3), tied so many times; what is
        nearest to the points then, and which are tied.
        """
        from scipy.spatial import KDTree

        lengths, lost = np.linalg.norm(self.along(x), axis=1), np.full(len(points), -1, np.int32)
        if not len(points):
            found = self.mesh.feet(points, lost, x)
            return x, found, found.inside
        tree = KDTree(points)
        away, around = map(np.asarray, tree.query(points, k=np.arange(1, min(NEAR, len(points)) + 1)))
        spaces = away.mean(axis=1)
        dense = spaces <= ALONE * np.median(spaces)
        change = np.inf
        for left in range(rounds, -1, -1):
            found = self.mesh.feet(points, lost, x)
            good = dense & self.good(found, normals, around)
            if not left or not good.any() or change <= CONVERGED * self.edge:
                break
            moved = x + self.change(x, found, good, points, tree, lengths)
            change, x = float(np.abs(moved - x).max()), moved
        return x, found, good

    def along(self, x: Array) -> Array:
        """The vectors (E, 3) along the edges."""
        return np.asarray(x[self.sides[:, 1]] - x[self.sides[:, 0]])

    def good(self, found: Feet, normals: Array | None, around: Indices) -> Flags:
        """Which of the points are tied to their nearest places; `around` (m, k) are the points near each."""
        away = np.abs(found.gaps)
        near = away <= CAP * self.edge
        if normals is not None:
            near &= np.abs((normals * found.normals).sum(axis=1)) >= AGREE
        if near.any():
            usual = np.maximum(np.median(away[near]), np.median(away[around], axis=1))
            near &= away <= np.maximum(TRIM * usual, FINE * self.edge)
        return np.asarray(near)

    def change(self, x: Array, found: Feet, good: Flags, points: Array, tree: Any, lengths: Array) -> Array:
        """The least change (n, 3) that brings tied points near, and leaves edges their lengths (E,)."""
        from scipy.sparse import csr_array, diags_array, eye_array, kron, vstack
        from scipy.sparse.linalg import cg

        corners, weights = self.mesh.triangles[found.faces[good]], found.weights[good]
        B, e = weights_of_corners(corners, weights, len(x)), self.along(x)
        square, own = B.T @ B, np.linalg.norm(e, axis=1)
        unit, e = float(square.diagonal().mean()), e / np.maximum(own, 1e-300)[:, None]
        root = np.sqrt(LASTING * unit)
        near = rows_of(corners, weights[:, :, None] * found.normals[good][:, None], x.size)
        J = csr_array(vstack([near, rows_of(self.sides, root * np.stack([-e, e], axis=1), x.size)]))
        way = self.to_points(x, points, tree, good)
        flat = SLIDING * square + diags_array(way.any(axis=1).astype(float))
        A = self.free @ (J.T @ J + kron(flat, eye_array(3), format="csr") + SMOOTH * unit * self.smooth)
        left = np.concatenate([(1.0 + SLIDING) * found.gaps[good], root * (own - lengths)])
        scale = diags_array(1.0 / np.maximum(A.diagonal(), 1e-300))
        out = cg(A, -(self.free @ (J.T @ left + way.ravel())), rtol=TOLERANCE, M=scale)[0]
        return np.asarray(out.reshape(x.shape))

    def to_points(self, x: Array, points: Array, tree: Any, good: Flags) -> Array:
        """How far vertices of hems are from the points (m, 3) that they are tied to (n, 3); 0 for all others."""
        from scipy.spatial import KDTree

        out, hem = np.zeros_like(x), x[self.hem]
        if len(hem):
            point = tree.query(hem)[1]
            way = hem - points[point]
            both = good[point] & (KDTree(hem).query(points[point])[1] == np.arange(len(hem)))
            out[self.hem[both]] = way[both]
        return out
