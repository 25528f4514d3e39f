"""Free fall: at its start a vertex far from held ones falls freely, whatever masses and springs are.

Where springs lie across gravity and none is stretched, a vertex moves along gravity by u(t) with u' = v₀ + a t − d u,
d a damping, so that

    u = e (1 − 3⁻ⁿ) + v₀ t + a t²/2 − d ∫u dt

is linear in e, v₀, a and d: four numbers for the mean of many vertices over the first frames n. How a target was made
shows in e and v₀: implicit Euler is ahead by v₀ = a h / 2; the first step of BDF2 is one of implicit Euler, h²/2 too
far, and of e₁ the next ones make eₙ = (4 eₙ₋₁ − eₙ₋₂)/3 = 3/2 (1 − 3⁻ⁿ) e₁. Where a is not the scene's gravity, the
target's clock or its gravity is another one: with times stretched by c, a is g / c². A sheet that hangs in the
direction of gravity shows nothing of this, nor does one in wind. A later step of BDF2 that is taken by implicit Euler
sets all vertices ahead once more: what the regression leaves of their mean counts as an error of a.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from clothfit.base.arrays import Array, Flags, Indices
from clothfit.motion.motion import Motion
from clothfit.scene.cloth import Cloth
from clothfit.scene.scene import Scene

LIES_ACROSS, TAUT = 0.2, 1e-3
"""|cos| of the angle between a spring and gravity below which a vertex falls far before the spring pulls, and the
relative change of its length up to which it does not pull before.
"""

FEWEST_EDGES, FEWEST_VERTICES = 3, 6
"""Edges from a held vertex from which on one counts as far, and how many there must be."""

FEWEST_FRAMES, MOST_FRAMES = 5, 16
"""Frames after the first that the regression takes."""

DEPTH = 0.2
"""Fall, relative to the distance from held vertices, up to which springs hardly pull."""

OFF, SURE, SMOOTH = 0.135, 6.0, 0.01
"""Relative difference of an acceleration from gravity that is worth a word, in its standard errors beyond that, and
what the regression may leave, relative to the fall: more is not a free fall.
"""

STANDS, FALLS = 0.25, (0.3, 2.2)
"""The mean way, relative to that of a free fall in one frame, up to which a cloth stands still; and that after it,
relative to that of a free fall, that is one: implicit Euler is twice as fast in its first step.
"""

LATE, AFTER = 2, 3
"""Frames at least in which it stands still, and those after them that must show the fall."""


class Fall(NamedTuple):
    """How a cloth begins to fall."""

    acceleration: float  # along gravity, m/s²
    gravity: float  # of the scene, m/s²

    @property
    def rate(self) -> float:
        """How much slower than the scene's the target's clock goes, if its gravity is the same."""
        return float(np.sqrt(self.gravity / self.acceleration))


def other_fall(scene: Scene, motion: Motion) -> Fall | None:
    """The fall of the target's vertices where it is not that of the scene's gravity; None where it is, or unknown."""
    g = float(np.linalg.norm(scene.gravity))
    moving = scene.gravity_keys or scene.frame or scene.colliders
    if moving or not g > 0 or scene.mode("gravity") != "n" or not np.isclose(motion.times[0], 0.0):
        return None
    for i, cloth in enumerate(scene.cloths):
        seen = np.asarray(motion.seen(i)[: MOST_FRAMES + 1].all(axis=0))
        far = far_vertices(scene, cloth, seen)
        if len(far) >= FEWEST_VERTICES:
            fallen = (motion.of(i)[: MOST_FRAMES + 1, far] - motion.of(i)[0, far]) @ (scene.gravity / g)
            a = acceleration(motion.times, fallen, depth(cloth, far), g)
            if a is not None:
                return Fall(a, g)
    return None


def far_vertices(scene: Scene, cloth: Cloth, seen: Flags) -> Indices:
    """Those of the vertices `seen` (n,) of a cloth that fall freely at first: the farther half from held ones."""
    windy = cloth.feels_air and (scene.wind_keys or scene.wind.any() or scene.mode("wind") != "n")
    thrown = cloth.velocity.any() or cloth.mode("velocity") != "n"
    if windy or thrown or cloth.pins or not len(cloth.springs):
        return np.zeros(0, np.int32)
    edges = cloth.positions[cloth.springs[:, 0]] - cloth.positions[cloth.springs[:, 1]]
    across = np.abs(edges @ scene.gravity) <= LIES_ACROSS * cloth.lengths * np.linalg.norm(scene.gravity)
    loose = across & (np.abs(cloth.rest - cloth.lengths) <= TAUT * cloth.lengths)
    far = seen & ~cloth.fixed & (graph_distance(cloth) >= FEWEST_EDGES)
    far[cloth.springs[~loose].ravel()] = False
    for sphere in scene.spheres:
        far &= np.linalg.norm(cloth.positions - sphere.centre, axis=1) > 1.5 * sphere.radius
    order = np.flatnonzero(far)[np.argsort(-graph_distance(cloth)[far], kind="stable")]
    return np.asarray(order[: max(len(order) // 2, 2 * FEWEST_VERTICES)])


def graph_distance(cloth: Cloth) -> Array:
    """Springs (n,) from each vertex to the nearest held one; infinite where there is none."""
    from scipy.sparse import coo_array
    from scipy.sparse.csgraph import shortest_path

    n, held = len(cloth.mass), np.flatnonzero(cloth.fixed)
    a, b = cloth.springs.T
    ends = np.concatenate([a, held]), np.concatenate([b, np.full(len(held), n)])  # vertex n joins all held ones
    graph = coo_array((np.ones(len(ends[0])), ends), shape=(n + 1, n + 1)).tocsr()
    found = shortest_path(graph, directed=False, unweighted=True, indices=[n])
    return np.asarray(found).reshape(-1)[:n] - 1.0


def depth(cloth: Cloth, far: Indices) -> float:
    """How far, m, the vertices `far` fall freely."""
    nearest = float(np.min(graph_distance(cloth)[far]))
    return DEPTH * float(np.median(cloth.lengths)) * (nearest if np.isfinite(nearest) else MOST_FRAMES)


def acceleration(times: Array, fallen: Array, depth: float, g: float) -> float | None:
    """The acceleration, m/s², of vertices that have fallen so far (F, V), m, at `times`, at most to a `depth`, m, where
    it is surely not `g`.
    """
    whole = fallen.mean(axis=1)
    end = 1 + (int(np.argmax(np.abs(whole) > depth)) or len(whole) - 1)
    if end <= FEWEST_FRAMES:
        return None
    t, u = times[1:end], whole[1:end]
    passed = np.cumsum(np.diff(times[:end]) * (u + whole[: end - 1]) / 2.0)
    columns = np.stack([1.0 - 3.0 ** (-t / t[0]), t, t**2 / 2.0, -passed], axis=1)
    inverse = np.linalg.pinv(columns)
    each = inverse @ fallen[1:end]
    _, speed, a, damping = mean = each.mean(axis=1)
    left = columns @ mean - u
    shared = (left @ left) / (len(t) - len(mean)) * (inverse[2] @ inverse[2])
    error = np.sqrt(shared + each[2].var(ddof=1) / each.shape[1])
    starts = abs(speed) <= abs(a) * t[0]  # else it moves already
    free = np.abs(left).max() <= SMOOTH * np.abs(u).max()
    before = a * (1.0 + max(damping, 0.0) * t[0])  # an implicit step damps the gravity as well
    apart = max(min(a, before) - g, g - max(a, before)) - SURE * error
    return float(a) if starts and free and apart > OFF * g and a > 0 else None


def late_start(scene: Scene, motion: Motion) -> float:
    """What the motion's clock shows, s, when its cloths begin to fall, where they stand still until then; 0 where they
    do not, or something else may hold them and let them go.
    """
    g, t = float(np.linalg.norm(scene.gravity)), motion.times
    if scene.moves or scene.frame or scene.forces or not g > 0 or len(t) < LATE + AFTER + 1 or t[0] != 0.0:
        return 0.0
    x, seen, along = motion.positions, motion.seen(), scene.gravity / g
    fixed = np.concatenate([cloth.fixed for cloth in scene.cloths])
    free = np.concatenate([graph_distance(cloth) >= FEWEST_EDGES for cloth in scene.cloths]) & ~fixed

    def moved(frame: int, some: Flags) -> Array:
        """How far those of some vertices (n,) that are seen have moved, m."""
        here = some & seen[0] & seen[frame]
        return np.asarray(x[frame, here] - x[0, here])

    def way(frame: int) -> float:
        """How far what is free has fallen, m, in the mean."""
        fallen = moved(frame, free) @ along
        return float(fallen.mean()) if len(fallen) else 0.0

    least = STANDS * 0.5 * g * t[1] ** 2
    still = next((frame for frame in range(len(t)) if abs(way(frame)) > least), 0) - 1  # the last such frame
    if still < LATE or still + AFTER >= len(t):
        return 0.0
    after = range(still + 1, still + 1 + AFTER)
    falls = np.array([way(frame) / (0.5 * g * (t[frame] - t[still]) ** 2) for frame in after])
    held = max(float(np.linalg.norm(moved(frame, fixed), axis=1).max(initial=0.0)) for frame in after)
    is_fall = (FALLS[0] < falls).all() and (falls < FALLS[1]).all() and held < STANDS * abs(way(after[-1]))
    return float(t[still]) if is_fall else 0.0
