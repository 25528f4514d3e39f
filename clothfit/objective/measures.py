"""What of a motion is compared: objectives, and what they share.

An objective takes the states s (F, n, 3) of one cloth at the times of the target's F frames (`target.sample`) and gives
their differences from the target's in R groups of c numbers each. It is a class like `Measure`, made from (goal,
system, name): a Target, the cloth's System and the name of the motion for messages.

J is exact. A robust loss takes the norm of a group. A weight is a factor of the loss, so that a weight of 2 is the same
as observing twice.

To add an objective, write such a class and a line in `comparison.OBJECTIVES`.

Positions: each observed vertex should be where the target has it. d = s − s*, m; a group is a vertex in a frame. Where
the target's points are bound inside triangles (`motion.correspondence`), it is a point in a frame, and d = B s − y;
where they are those of a scan, d is the distance of a point from the cloth (`motion.feet`).

Velocities: from frame to frame, each vertex should move as the target does, wherever it is.

d = ((s_{f+1} − s_f) − (s*_{f+1} − s*_f)) / (t_{f+1} − t_f), m/s, where both frames are observed; a group is a vertex
between two successive frames. A constant offset of the whole target changes nothing.

Lengths of springs: each should be as long as in the target, wherever the cloth is and however it is rotated.

d = |s_a − s_b| − |s*_a − s*_b|, m, for each spring both of whose ends are observed; a group is a spring in a frame.
With e = s_a − s_b the derivative is e/|e| at a and −e/|e| at b; 0 where the length is 0.

Spectra: each vertex should swing as strongly at each frequency as in the target, at whatever phase.

With y_f = w_f (s_f − x₀), w the Hann window over the F frames scaled to Σ w² = F, and q = 0 … F/2 the frequencies,

    C_q = c_q Σ_f y_f cos(2π q f / F),   S_q = c_q Σ_f y_f sin(2π q f / F),   A_q = sqrt(C_q² + S_q² + ε²) − ε

for each coordinate; d = A − A*, m; a group is a vertex at a frequency. c_q² = 2/F (1/F at q = 0 and F/2, which have no
mirror image), so that by Parseval's theorem Σ_q C_q² + S_q² = Σ_f y_f²: the numbers are as large as those of positions.
ε rounds off the tip at amplitude 0, where a length has no derivative.

The cost does not depend on the phase, so it is smoother than that of positions where two motions are out of step. The
frames must be equally spaced, and a vertex that is not observed in all of them is left out.
Reference: F. J. Harris, On the use of windows for harmonic analysis with the discrete Fourier transform,
Proceedings of the IEEE 66 (1978).
"""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING, NamedTuple, Protocol

import numpy as np

from clothfit.base.arrays import Array, Flags, Indices
from clothfit.base.errors import InvalidMotion
from clothfit.engine.system import System
from clothfit.motion.feet import UNKNOWN, Faces, Feet
from clothfit.motion.motion import Motion
from clothfit.motion.shadow import RAYS, Integers, outermost
from clothfit.motion.times import TIME_SLACK
from clothfit.objective.target import Target
from clothfit.scene.directions import edges_of

if TYPE_CHECKING:
    from scipy.sparse import csr_array


class Measure(Protocol):
    """One objective for one cloth and one target."""

    groups: int  # R
    reach: int  # how many vertices at how many times a group depends on
    linear: bool  # whether J is the same for all s
    weights: Array | None  # (R,), how often each group counts; None where all count once
    seen: Flags  # (n,), the vertices that are compared at some time after the initial state

    def residual(self, s: Array) -> Array:
        """d (R, c) of the states s (F, n, 3); 0 where s is the target."""

    def pullback(self, s: Array, r: Array) -> Array:
        """Jᵀ r (F, n, 3) for r (R, c), J = ∂d/∂s."""

    def jacobian(self, s: Array) -> csr_array:
        """J as a sparse matrix (R·c, F·n·3), rows and columns in the order of the arrays."""


Maker = Callable[[Target, System, str], Measure]


def both(weights: Array, other: Array) -> Array:
    """The weight of the difference of two values of these weights.

    Weights are inverse variances, and variances add. The factor 2 lets two values of one weight keep that weight.
    """
    return np.asarray(2.0 * weights * other / (weights + other))


def marked(pairs: Integers, n: int) -> Flags:
    """Flags (n,), set at the vertices that are listed."""
    flags = np.zeros(n, bool)
    flags[pairs] = True
    return flags


def coordinates(frame: Integers, vertex: Integers, n: int) -> Integers:
    """Columns (R, 3) of the coordinates of vertices (R,) in frames (R,)."""
    return np.asarray(3 * (frame * n + vertex)[:, None] + np.arange(3))


def matrix(rows: Integers, columns: Integers, values: Array, shape: tuple[int, int]) -> csr_array:
    """A sparse matrix from its entries, arrays of one shape."""
    from scipy.sparse import csr_array

    entries = [np.ravel(part) for part in np.broadcast_arrays(values, rows, columns)]
    return csr_array((entries[0], (entries[1], entries[2])), shape=shape)


def rows_of(vertices: Integers, by: Array, size: int) -> csr_array:
    """A sparse matrix (m, size) of rows with factors `by` (m, k, 3) of the coordinates of vertices (m, k)."""
    columns = 3 * vertices[:, :, None].astype(int) + np.arange(3)
    return matrix(np.arange(len(vertices))[:, None, None], columns, by, (len(vertices), size))


class Position:
    """Differences of the positions; R observed positions, c = 3."""

    linear = True
    reach = 1

    def __init__(self, goal: Target, system: System, name: str) -> None:
        self.observed, self.seen, self._target = goal.observed, goal.seen, goal.positions
        self.groups = int(goal.observed.sum())
        self.weights = goal.weights[goal.observed] if len(goal.weights) else None

    def residual(self, s: Array) -> Array:
        """s − s* (R, 3), m."""
        return np.asarray(s[self.observed] - self._target[self.observed])

    def pullback(self, s: Array, r: Array) -> Array:
        """Jᵀ r (F, n, 3)."""
        out = np.zeros_like(s)
        out[self.observed] = r
        return out

    def jacobian(self, s: Array) -> csr_array:
        """J (3 R, 3 F n)."""
        frame, vertex = np.nonzero(self.observed)
        columns = coordinates(frame, vertex, s.shape[1])
        return matrix(np.arange(columns.size).reshape(columns.shape), columns, np.ones(1), (columns.size, s.size))


class Surface(NamedTuple):
    """Points inside triangles of one cloth, in F frames."""

    weights: csr_array  # B (m, n), of the cloth's vertices
    points: Array  # (F, m, 3), m
    seen: Flags  # (F, m)

    def points_of(self, s: Array) -> Array:
        """B s (F, m, 3) of states s (F, n, 3)."""
        return np.stack([self.weights @ each for each in s]) if len(s) else self.points[:0]

    def measure(self, goal: Target) -> OnSurface:
        """What compares them."""
        return OnSurface(goal, self)

    def within(self, goal: Target, start: bool) -> Surface:
        """The same in the frames of a target, with those of the `start` or without."""
        count = len(goal.step)
        return self._replace(points=self.points[:count], seen=self.seen[:count] & (start | (goal.places > 0))[:, None])


def surface_of(motion: Motion, cloth: int) -> Surface | Cloud | None:
    """The points of a motion inside triangles of one cloth, or of a scan; None where they are vertices."""
    part = motion.correspondence
    if part.mesh is not None:
        return cloud_of(motion, cloth, part.mesh)
    weights, points, seen = part[2:5]
    if weights is None:
        return None
    own = weights.tocsc()[:, motion.part(cloth)].tocsr()
    rows = np.flatnonzero(np.diff(own.indptr))
    return Surface(own[rows], np.ascontiguousarray(points[:, rows]), seen[:, rows])


class Cloud(NamedTuple):
    """Points of a scan of one cloth, others in each of F frames."""

    mesh: Faces
    points: Array  # (F, m, 3), m
    seen: Flags  # (F, m)
    faces: Indices  # (F, m), of the mesh, where the nearest place is sought from

    def feet(self, s: Array, frame: int) -> Feet:
        """The places of a state s (n, 3) that are nearest to the points that a frame shows."""
        own = self.seen[frame]
        return self.mesh.feet(self.points[frame, own], self.faces[frame, own], s)

    def by_vertex(self, s: Array, frame: int) -> tuple[Array, Flags]:
        """What is left of a frame at a state s (n, 3), each point in a triangle with the corner that is nearest to its
        place: Σ r n over the root of their number (n, 3), which is as large as r where that is noise, and which have
        any (n,). What lies beyond a hem is left out, as it lies there on one side alone.
        """
        found, sums = self.feet(s, frame), np.zeros_like(s)
        vertex = self.mesh.triangles[found.faces, found.weights.argmax(axis=1)]
        vertex, left = vertex[found.inside], found.gaps[:, None] * found.normals
        np.add.at(sums, vertex, left[found.inside])
        count = np.bincount(vertex, minlength=len(s))
        return sums / np.sqrt(np.maximum(count, 1))[:, None], count > 0

    def points_of(self, s: Array) -> Array:
        """The nearest places (F, m, 3) of states s (F, n, 3)."""
        out = self.points.copy()
        for frame, x in enumerate(s):
            found = self.feet(x, frame)
            out[frame, self.seen[frame]] += found.gaps[:, None] * found.normals
        return out

    def measure(self, goal: Target) -> OnCloud:
        """As of a `Surface`."""
        return OnCloud(goal, self)

    def within(self, goal: Target, start: bool) -> Cloud:
        """As of a `Surface`."""
        count = len(goal.step)
        seen = self.seen[:count] & (start | (goal.places > 0))[:, None]
        return self._replace(points=self.points[:count], seen=seen, faces=self.faces[:count])


def cloud_of(motion: Motion, cloth: int, mesh: Faces) -> Cloud:
    """The points of a scan that are near one cloth; those near to nothing yet may be anyone's."""
    part, bound = motion.part(cloth), motion.correspondence
    if part == slice(0, motion.positions.shape[1]):
        return Cloud(mesh, bound.points, bound.seen, bound.faces)
    own = (mesh.triangles >= part.start).all(axis=1) & (mesh.triangles < part.stop).all(axis=1)
    place = np.where(own, np.cumsum(own) - 1, UNKNOWN).astype(np.int32)
    faces = np.where(bound.faces >= 0, place[bound.faces], UNKNOWN)
    own_mesh = Faces.of(mesh.triangles[own] - part.start, part.stop - part.start)
    return Cloud(own_mesh, bound.points, bound.seen & ((faces >= 0) | (bound.faces < 0)), faces)


class OnCloud:
    """Distances of points of a scan from the cloth; R seen points, c = 1."""

    linear = False
    reach = 3
    weights: Array | None = None

    def __init__(self, goal: Target, cloud: Cloud) -> None:
        self.cloud, self.groups = cloud, int(cloud.seen.sum())
        near = np.unique(cloud.faces[cloud.seen & (goal.places > 0)[:, None]])
        corners = cloud.mesh.triangles if UNKNOWN in near else cloud.mesh.triangles[near]
        self.seen = marked(corners, goal.observed.shape[1])
        self._known: tuple[Array, list[Feet]] = np.zeros((0, 0, 3)), []

    def _feet(self, s: Array) -> list[Feet]:
        if not np.array_equal(s, self._known[0]):
            self._known = s.copy(), [self.cloud.feet(x, frame) for frame, x in enumerate(s)]
        return self._known[1]

    def residual(self, s: Array) -> Array:
        """r (R, 1), m."""
        return np.concatenate([each.gaps for each in self._feet(s)])[:, None]

    def pullback(self, s: Array, r: Array) -> Array:
        """Jᵀ r (F, n, 3)."""
        return np.asarray((self.jacobian(s).T @ r.ravel()).reshape(s.shape))

    def jacobian(self, s: Array) -> csr_array:
        """J (R, 3 F n)."""
        found, n = self._feet(s), s.shape[1]
        corners = self.cloud.mesh.triangles
        vertex = np.concatenate([k * n + corners[each.faces].astype(int) for k, each in enumerate(found)])
        weights, normals = (np.concatenate([getattr(each, key) for each in found]) for key in ("weights", "normals"))
        return rows_of(vertex, weights[:, :, None] * normals[:, None], s.size)


class OnSurface:
    """Differences of points inside triangles from where the target has them; R seen points, c = 3."""

    linear = True
    reach = 3
    weights: Array | None = None

    def __init__(self, goal: Target, surface: Surface) -> None:
        self.surface, self.groups = surface, int(surface.seen.sum())
        later = np.flatnonzero(surface.seen[goal.places > 0].any(axis=0))
        self.seen = marked(surface.weights[later].indices, surface.weights.shape[1])

    def residual(self, s: Array) -> Array:
        """B s − y (R, 3), m."""
        return np.asarray((self.surface.points_of(s) - self.surface.points)[self.surface.seen])

    def pullback(self, s: Array, r: Array) -> Array:
        """Jᵀ r (F, n, 3)."""
        each = np.zeros_like(self.surface.points)
        each[self.surface.seen] = r
        return np.stack([self.surface.weights.T @ frame for frame in each])

    def jacobian(self, s: Array) -> csr_array:
        """J (3 R, 3 F n)."""
        from scipy.sparse import csr_array, eye_array, kron

        rows = np.flatnonzero(self.surface.seen)
        whole = kron(eye_array(len(s)), self.surface.weights, format="csr")[rows]
        return csr_array(kron(whole, eye_array(3), format="csr"))


class Velocity:
    """Differences of mean velocities; R pairs of observed positions, c = 3."""

    linear = True
    reach = 2

    def __init__(self, goal: Target, system: System, name: str) -> None:
        gaps = system.h * np.diff(goal.places)  # 0 where two frames count as one step
        self.frame, self.vertex = np.nonzero(goal.observed[1:] & goal.observed[:-1] & (gaps > 0)[:, None])
        self.groups = len(self.frame)
        self.rate = 1.0 / gaps[self.frame][:, None]
        self.goal = self._velocity(goal.positions)
        self.seen = marked(self.vertex, goal.observed.shape[1])
        first, second = ((self.frame + k, self.vertex) for k in (0, 1))
        self.weights = both(goal.weights[first], goal.weights[second]) if len(goal.weights) else None

    def _velocity(self, s: Array) -> Array:
        return np.asarray(self.rate * (s[self.frame + 1, self.vertex] - s[self.frame, self.vertex]))

    def residual(self, s: Array) -> Array:
        """Difference of the velocities (R, 3), m/s."""
        return self._velocity(s) - self.goal

    def pullback(self, s: Array, r: Array) -> Array:
        """Jᵀ r (F, n, 3)."""
        out = np.zeros_like(s)
        out[self.frame + 1, self.vertex] += self.rate * r
        out[self.frame, self.vertex] -= self.rate * r
        return out

    def jacobian(self, s: Array) -> csr_array:
        """J (3 R, 3 F n)."""
        before, after = (coordinates(self.frame + k, self.vertex, s.shape[1]) for k in (0, 1))
        rows = np.arange(before.size).reshape(before.shape)
        rate = np.broadcast_to(self.rate, before.shape)
        return matrix(
            np.stack([rows, rows]), np.stack([before, after]), np.stack([-rate, rate]), (before.size, s.size)
        )


class EdgeLength:
    """Differences of lengths; R springs in frames, c = 1."""

    linear = False
    reach = 2

    def __init__(self, goal: Target, system: System, name: str) -> None:
        ends = np.asarray(system.springs.ends)
        self.frame, spring = np.nonzero(goal.observed[:, ends].all(axis=2))
        self.groups = len(self.frame)
        self.a, self.b = ends[spring].T
        self.goal = self._edges(goal.positions)[0]
        self.seen = marked(ends[spring[goal.places[self.frame] > 0]], goal.observed.shape[1])
        first, second = (self.frame, self.a), (self.frame, self.b)
        self.weights = both(goal.weights[first], goal.weights[second]) if len(goal.weights) else None

    def _edges(self, s: Array) -> tuple[Array, Array]:
        """Lengths (R, 1) and directions (R, 3)."""
        edges = np.asarray(s[self.frame, self.a] - s[self.frame, self.b])
        lengths = np.asarray(np.linalg.norm(edges, axis=1, keepdims=True))
        return lengths, edges / np.where(lengths > 0, lengths, 1.0)

    def residual(self, s: Array) -> Array:
        """Difference of the lengths (R, 1), m."""
        return self._edges(s)[0] - self.goal

    def pullback(self, s: Array, r: Array) -> Array:
        """Jᵀ r (F, n, 3)."""
        out, pull = np.zeros_like(s), r * self._edges(s)[1]
        np.add.at(out, (self.frame, self.a), pull)
        np.add.at(out, (self.frame, self.b), -pull)
        return out

    def jacobian(self, s: Array) -> csr_array:
        """J (R, 3 F n)."""
        d = self._edges(s)[1]
        columns = np.stack([coordinates(self.frame, end, s.shape[1]) for end in (self.a, self.b)])
        return matrix(np.arange(len(d))[:, None], columns, np.stack([d, -d]), (len(d), s.size))


EPSILON = 1e-6
"""ε, m: smaller than any capture resolves."""

FEWEST_FRAMES = 4
"""With fewer frames a spectrum means nothing."""


class Spectrum:
    """Differences of amplitudes; R = frequencies × vertices seen throughout, c = 3 coordinates."""

    linear = False

    def __init__(self, goal: Target, system: System, name: str) -> None:
        check_grid(goal, name)
        throughout: Flags = np.asarray(goal.observed.all(axis=0))
        self.vertices = np.flatnonzero(throughout)
        self.start = system.x0[self.vertices]
        self.basis = basis(len(goal.step))
        self.reach = len(goal.step)
        self.groups = self.basis.shape[1] * len(self.vertices)
        self.goal = self._amplitudes(goal.positions)[0]
        self.seen: Flags = throughout & (goal.places[-1] > 0)
        self.weights: Array | None = None
        if len(goal.weights):
            self.weights = np.tile(goal.weights[:, self.vertices].mean(axis=0), self.basis.shape[1])

    def _amplitudes(self, s: Array) -> tuple[Array, Array]:
        """A (Q V, 3), and its derivative by C and S (2, Q, V, 3), for V vertices and Q frequencies."""
        parts = np.tensordot(self.basis, s[:, self.vertices] - self.start, axes=1)
        root = np.sqrt((parts**2).sum(axis=0) + EPSILON**2)
        return (root - EPSILON).reshape(-1, 3), parts / root

    def residual(self, s: Array) -> Array:
        """Difference of the amplitudes (R, 3), m."""
        return self._amplitudes(s)[0] - self.goal

    def pullback(self, s: Array, r: Array) -> Array:
        """Jᵀ r (F, n, 3)."""
        out, derivative = np.zeros_like(s), self._amplitudes(s)[1]
        pulled = derivative * r.reshape(derivative.shape[1:])
        out[:, self.vertices] = np.tensordot(self.basis, pulled, axes=((0, 1), (0, 1)))
        return out

    def jacobian(self, s: Array) -> csr_array:
        """J (3 R, 3 F n): each amplitude depends on its coordinate in all frames."""
        derivative = self._amplitudes(s)[1]
        values = np.einsum("pqf,pqvc->qvcf", self.basis, derivative)
        frames, vertices = np.meshgrid(np.arange(len(s)), self.vertices, indexing="ij")
        columns = coordinates(frames.ravel(), vertices.ravel(), s.shape[1]).reshape(len(s), -1, 3).transpose(1, 2, 0)
        rows = np.arange(derivative[0].size).reshape(*derivative.shape[1:], 1)
        return matrix(rows, columns, values, (derivative[0].size, s.size))


def basis(frames: int) -> Array:
    """c_q w_f cos and c_q w_f sin of 2π q f / F, (2, Q, F)."""
    f, q = np.arange(frames), np.arange(frames // 2 + 1)
    window = 0.5 - 0.5 * np.cos(2.0 * np.pi * f / frames)
    window /= np.sqrt((window**2).mean())
    alone = (q == 0) | (2 * q == frames)
    scale = np.sqrt(np.where(alone, 1.0, 2.0) / frames)
    angle = 2.0 * np.pi * (np.outer(q, f) % frames) / frames
    return np.asarray(scale[:, None] * window * np.stack([np.cos(angle), np.sin(angle)]))


def check_grid(goal: Target, name: str) -> None:
    """Raise InvalidMotion unless the frames are equally spaced and enough."""
    if len(goal.step) < FEWEST_FRAMES:
        raise InvalidMotion(
            f"{name}: {len(goal.step)} of its frames are compared; the spectrum needs at least {FEWEST_FRAMES}"
        )
    gaps = np.diff(goal.places)
    wrong = np.abs(gaps - gaps.mean()) > 2 * TIME_SLACK
    if wrong.any():
        raise InvalidMotion(
            f"{name}: times[{int(np.argmax(wrong)) + 1}]: the spectrum needs frames at equal distances in time"
        )


class Outline:
    """Differences of the radii of shadows in directions; R = RAYS × frames after the start, c = 1.

    The shadow is that of light from above, along y, about the centre of what is fixed (`motion.shadow`).
    """

    linear = False
    reach = 2
    weights: Array | None = None

    def __init__(self, goal: Target, system: System, name: str) -> None:
        self.edges = edges_of(np.asarray(system.faces.corners)).ends
        if not len(self.edges):
            raise InvalidMotion(f"{name}: a shadow is compared with that of a cloth that has faces")
        held = ~system.vertex.free
        self.centre = system.x0[held if held.any() else slice(None)].mean(axis=0)[[0, 2]]
        self.frames = np.flatnonzero(goal.places > 0)
        if not np.isfinite(goal.positions[self.frames]).all():
            raise InvalidMotion(f"{name}: the shadow is that of all vertices, and some are not observed")
        radii = np.tile(goal.radii, len(self.frames))  # empty where the shadow is that of positions
        self.goal = self.compared(radii if len(radii) else self.shadows(goal.positions)[0])
        self.groups = len(self.goal)
        self.seen = marked(self.edges, len(held))
        if len(goal.weights):
            self.weights = np.repeat(goal.weights[self.frames].mean(axis=1), self.groups // max(len(self.frames), 1))

    def shadows(self, s: Array) -> tuple[Array, Integers, Array]:
        """`outermost` of states s (F, n, 3) in all frames."""
        found = [outermost(s[frame][:, [0, 2]] - self.centre, self.edges) for frame in self.frames]
        r, ends, by = (np.concatenate(each) for each in zip(*found, strict=True))
        return r, ends, by

    def compared(self, r: Array) -> Array:
        """What is compared (R, 1) of radii in all frames."""
        return r[:, None]

    def _values(self, s: Array) -> tuple[Array, Integers, Integers, Array]:
        """What is compared (R, 1) of states s (F, n, 3); frames and vertices (R, k) that it depends on, and its
        derivative (R, k, 2) by their places in the plane.
        """
        r, ends, by = self.shadows(s)
        return r[:, None], np.broadcast_to(np.repeat(self.frames, RAYS)[:, None], ends.shape), ends, by

    def residual(self, s: Array) -> Array:
        """Differences (R, 1), m."""
        return self._values(s)[0] - self.goal

    def pullback(self, s: Array, r: Array) -> Array:
        """Jᵀ r (F, n, 3)."""
        out, (_, frame, vertex, by) = np.zeros_like(s), self._values(s)
        for k, axis in enumerate((0, 2)):
            np.add.at(out[..., axis], (frame, vertex), r * by[..., k])
        return out

    def jacobian(self, s: Array) -> csr_array:
        """J (R, 3 F n)."""
        _, frame, vertex, by = self._values(s)
        columns = coordinates(frame.ravel(), vertex.ravel(), s.shape[1]).reshape(*vertex.shape, 3)[..., [0, 2]]
        rows = np.arange(len(by))[:, None, None]
        return matrix(rows, columns, by, (len(by), s.size))


class Coverage(Outline):
    """Differences of the radii of circles that cover as much as shadows do, √(A/π) = √(mean of r²); R = frames after
    the start, c = 1.
    """

    reach = 2 * RAYS

    def compared(self, r: Array) -> Array:
        """The radii of the circles (R, 1)."""
        return np.asarray(np.sqrt((r.reshape(-1, RAYS) ** 2).mean(axis=1, keepdims=True)))

    def _values(self, s: Array) -> tuple[Array, Integers, Integers, Array]:
        """The same of a whole shadow."""
        r, frame, ends, by = super()._values(s)
        mean, r = self.compared(r), r.reshape(-1, RAYS)
        share = r / (RAYS * np.maximum(mean, 1e-300))
        by = share[:, :, None, None] * by.reshape(len(r), RAYS, 2, 2)
        return mean, frame.reshape(len(r), -1), ends.reshape(len(r), -1), by.reshape(len(r), -1, 2)
