"""Where the vertices of a cloth are in a scan: the cloth is simulated, and drawn to the points frame by frame.

After the steps to a frame the points y are tied to the nearest places of the cloth (`motion.feet`), as far as they are
within a cap, not among the farthest and their normals agree. The least change u of the vertices that brings these near,

    Σ (n·(B u + q − y))² + α |B u + q − y|² + κ |G u|²,

G the differences along edges, is added to their positions, and u / t, t the time since the frame before, to their
velocities: an observer with full gain. α keeps points from sliding, κ carries along what is not seen, and smooths.
Points are tied again, and the change repeated, a few times; what is matched in the end belongs to the scan.

J. Schulman et al., Tracking deformable objects with point clouds, 2013, ties points softly and lets an engine draw.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from clothfit.base import interrupts
from clothfit.base.arrays import Array, Flags
from clothfit.engine import rollout
from clothfit.engine.rollout import Rollout
from clothfit.engine.step import implicit
from clothfit.engine.system import System, build
from clothfit.motion.correspondence import Correspondence, roughness, weights_of_corners
from clothfit.motion.feet import Faces, Feet
from clothfit.motion.motion import in_scene, in_world, rms
from clothfit.motion.times import frame_places
from clothfit.objective.experiment import Experiment
from clothfit.registration.record import rigid
from clothfit.scene.kinds import REST
from clothfit.scene.scene import Scene, with_places

CAP = 3.0
"""Distance, in median edges, beyond which a point is tied to nothing."""

TRIM, FINE = 8.0, 0.05
"""Distance, in medians of those within the cap, beyond which a point counts as an outlier; and in median edges, up to
which none does.
"""

AGREE = 0.5
"""Cosine of the angle, 60°, up to which the normals of a point and of the cloth agree."""

ROUNDS, SLIDING, SMOOTH = 3, 0.1, 0.3
"""Times that points are tied in each frame; α; and κ relative to the weight of the points of a vertex."""

RESTING = 30
"""Times that points are tied to a cloth at rest, whose shape by other values may have other folds."""

TOLERANCE = 1e-5
"""Of the linear systems of the steps, relative."""

MOSTLY = 0.75
"""Share of the points of a first frame that must be within an edge of a mesh that lies there."""

TURNS, ITERATIONS, POINTS, ALIKE, RELAXING = 3, 20, 300, 1.5, 60
"""Angles about the last axis that are tried, closest points for each with so many points, distance relative to the
least that is as good, and steps of relaxing.
"""

SHOWN = 0.25
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
        part = self.whole.part(begin, end)._replace(ready=False)
        if rollout.fill(self.system, TOLERANCE, self.work, part) < end - begin:
            part.x[:] = part.x[0]
            part.w[:] = 0.0
        return np.asarray(part.x[-1])

    def put(self, at: int, change: Array, seconds: float) -> None:
        """Move the vertices after step `at` by a change (n, 3), m, that took so many seconds."""
        self.whole.x[at] += change
        self.whole.w[at - 1, self.whole.used[at - 1] - 1] += change / seconds


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
    before = 0
    for frame, end in enumerate(at):
        seen = own.seen[frame]
        points = own.points[frame, seen]
        normals = None if own.normals is None else own.normals[frame, seen]
        if end > before:
            x = np.concatenate([state.advance(before, end) for state in states])
            change = draw(x, points, normals, rounds)
            for state in states:
                state.put(end, change[state.part], (end - before) * scene.delta)
            x = x + change
        found = mesh.feet(points, np.full(len(points), -1, np.int32), x)
        good = draw.good(found, normals)
        faces[frame, seen], matched[frame, seen] = found.faces, good
        positions[frame] = x
        weight = weights_of_corners(mesh.triangles[found.faces[good]], found.weights[good], len(x)).sum(axis=0)
        observed[frame] = np.asarray(weight).ravel() > SHOWN
        before = end
        interrupts.check()
    share = float(matched.sum() / max(own.seen.sum(), 1))
    bound = motion.correspondence._replace(share=share, seen=matched, faces=faces)
    made = in_scene(replace(motion, positions=positions, observed=None, correspondence=Correspondence()), scene)
    return Experiment(replace(made, observed=observed, correspondence=bound), scene)


def placed(given: Experiment) -> Scene:
    """The scene with its mesh on the first frame of a scan, placed rigidly and then relaxed under its own weight while
    it is drawn there; the same object where it lies there already, or would come no nearer.
    """
    motion, scene = given
    scan = motion.correspondence
    if scan.mesh is None or scene.frame is not None or not scan.seen[0].any() or motion.times[0] != 0:
        return scene
    start = np.concatenate([cloth.positions for cloth in scene.cloths])
    draw = Drawing(scan.mesh, scene, np.ones(len(start), bool))
    points, lost = scan.points[0, scan.seen[0]], scan.faces[0, scan.seen[0]]
    before = np.quantile(np.abs(scan.mesh.feet(points, lost, start).gaps), MOSTLY)
    if before <= draw.edge:
        return scene
    few = points[:: max(len(points) // POINTS, 1)]
    found = sorted((moved_to(scan.mesh, few, start, R) for R in turns(start, few)), key=lambda each: each[0])
    near = [each for each in found if each[0] <= ALIKE * found[0][0]]  # a square sheet fits in eight ways
    held = np.concatenate([cloth.fixed for cloth in scene.cloths])
    own, size = start[held] if held.any() else start, float(np.linalg.norm(np.ptp(start, axis=0)))

    def way(each: tuple[float, Array, Array]) -> float:
        """By how much it turns the mesh, in radians, and moves what is held, relative to the mesh."""
        _, R, d = each
        return float(np.arccos(np.clip(0.5 * np.trace(R) - 0.5, -1.0, 1.0)) + rms(own @ R.T + d - own) / size)

    _, R, d = min(near, key=way)
    x = start @ R.T + d
    still = with_places(scene, x)
    states = [State(still, group[0], RELAXING) for group in scene.groups]
    for t in range(RELAXING):
        x = np.concatenate([state.advance(t, t + 1) for state in states])
        change = draw(x, points, None if scan.normals is None else scan.normals[0, scan.seen[0]])
        x = x + change
        for state in states:
            state.put(t + 1, change[state.part], np.inf)
            state.whole.w[t] = 0.0
    after = np.quantile(np.abs(scan.mesh.feet(points, lost, x).gaps), MOSTLY)
    return with_places(scene, x) if after < before else scene


def turns(start: Array, points: Array) -> list[Array]:
    """Rotations (3, 3) that may bring a mesh at `start` (n, 3) to points (m, 3): none, and those between principal
    axes, turned about the last one as well.
    """
    own, other = (np.linalg.eigh(np.cov(each.T))[1][:, ::-1] for each in (start, points))
    found = [np.eye(3)]
    for a, b in ((1.0, 1.0), (1.0, -1.0), (-1.0, 1.0), (-1.0, -1.0)):
        signs = np.diag([a, b, a * b * np.linalg.det(own) * np.linalg.det(other)])
        for angle in np.linspace(0.0, 0.5 * np.pi, TURNS, endpoint=False):
            c, s = np.cos(angle), np.sin(angle)
            found.append(other @ np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]]) @ signs @ own.T)
    return found


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


class Drawing:
    """What draws the vertices of a mesh to points."""

    def __init__(self, mesh: Faces, scene: Scene, free: Flags) -> None:
        """`mesh`: that of the scene; `free` (n,): which vertices may move."""
        edges = roughness(scene)  # G
        self.mesh, self.smooth = mesh, edges.T @ edges
        self.edge = float(np.median(np.concatenate([cloth.lengths for cloth in scene.cloths])))  # m
        self.free = np.flatnonzero(np.repeat(free, 3))

    def __call__(self, x: Array, points: Array, normals: Array | None, rounds: int = ROUNDS) -> Array:
        """The change (n, 3) of vertices at x (n, 3) to points (m, 3) with normals (m, 3), tied so many times."""
        start, faces = x.copy(), np.full(len(points), -1, np.int32)
        for _ in range(rounds if len(points) else 0):
            found = self.mesh.feet(points, faces, x)
            faces = found.faces
            x = x + self.change(found, self.good(found, normals), x)
        return x - start

    def good(self, found: Feet, normals: Array | None) -> Flags:
        """Which of the points are tied to their nearest places."""
        away = np.abs(found.gaps)
        near = away <= CAP * self.edge
        if normals is not None:
            near &= np.abs((normals * found.normals).sum(axis=1)) >= AGREE
        if near.any():
            near &= away <= max(TRIM * float(np.median(away[near])), FINE * self.edge)
        return np.asarray(near)

    def change(self, found: Feet, good: Flags, x: Array) -> Array:
        """The least change (n, 3) that brings tied points near."""
        from scipy.sparse import csc_array, csr_array, eye_array, kron
        from scipy.sparse.linalg import splu

        out = np.zeros_like(x)
        if not good.any():
            return out
        corners, weights = self.mesh.triangles[found.faces[good]], found.weights[good]
        n, r = found.normals[good], found.gaps[good]
        B = weights_of_corners(corners, weights, len(x))
        rows = np.repeat(np.arange(len(r)), 9)
        columns = (3 * corners[:, :, None] + np.arange(3)).ravel()
        J = csr_array(((weights[:, :, None] * n[:, None]).ravel(), (rows, columns)), shape=(len(r), x.size))
        square = B.T @ B
        kappa = SMOOTH * float(square.diagonal().mean()) / float(self.smooth.diagonal().mean())
        free = csr_array(eye_array(x.size))[self.free]
        A = J.T @ J + kron(SLIDING * square + kappa * self.smooth, eye_array(3))
        g = np.asarray((free @ J.T) @ r)
        out.reshape(-1)[self.free] = splu(csc_array(free @ A @ free.T)).solve(-(1.0 + SLIDING) * g)
        return out
