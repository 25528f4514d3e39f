"""Free fall: at its start a vertex far from held ones falls freely, whatever masses and springs are.

Where springs lie across gravity and none is stretched, a vertex moves along gravity by u(t) with u' = v₀ + a t − d u,
d a damping, so that

    u = v₀ t + a t²/2 − d ∫u dt

is linear in v₀, a and d: three numbers for the mean of many vertices over the first frames. Where a is not the scene's
gravity, for near and far vertices alike, the target's clock or its gravity is another one: with times stretched by c,
a is g / c². A sheet that hangs in the direction of gravity shows nothing of this, nor does one in wind.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from clothfit.base.arrays import Array, Flags, Indices
from clothfit.motion.motion import Motion
from clothfit.scene.cloth import Cloth
from clothfit.scene.scene import Scene

LIES_ACROSS = 0.2
"""|cos| of the angle between a spring and gravity below which a vertex falls far before the spring pulls."""

FEWEST_EDGES, FEWEST_VERTICES, ENOUGH, GROUPS = 3, 6, 12, 3
"""Edges from a held vertex from which on one counts as far, how many there must be, how many of the farthest suffice,
and groups of them that agree.
"""

FALL_FRAMES, MOST_FRAMES = 4, 16
"""Frames after the first that the regression takes."""

DEPTH = 0.2
"""Fall, relative to the distance from held vertices, up to which springs hardly pull."""

OFF, AGREEMENT, SURE, LIKELY = 0.135, 0.06, 6.0, 2.0
"""Relative difference of an acceleration from gravity that is worth a word, the largest one between groups, the least
difference from gravity in standard errors, and how many of these count for what else the target may mean.
"""

ALIKE = 0.01
"""Relative error of an acceleration below which groups count alike."""

LATER = 2
"""Frames after the first from which on the start no longer counts: how a target was made is a mere shift then."""

SMOOTH = 0.01
"""What the regression may leave, relative to the fall: more is not a free fall."""

UNLIKELY, SHORT_UNLIKELY, LONG = 2.5, 10.0, 6
"""How much more than a free fall's own another way to make it may leave that made it: in more frames than so many, and
in fewer, where it shows less.
"""

RANGE = (0.05, 20.0)
"""Accelerations relative to gravity that another clock or gravity can mean."""


class Fall(NamedTuple):
    """How a cloth begins to fall."""

    acceleration: float  # along gravity, m/s²
    gravity: float  # of the scene, m/s²

    @property
    def rate(self) -> float:
        """How much slower than the scene's the target's clock goes, if its gravity is the same."""
        return float(np.sqrt(self.gravity / self.acceleration))


class Measured(NamedTuple):
    """The regression of some groups of vertices."""

    values: Array  # (G,), a, m/s²
    errors: Array  # (G,), their standard errors
    others: tuple[tuple[float, float], ...]  # what else may be meant, m/s², and its standard error
    left: float  # of the mean fall, relative to it

    @property
    def acceleration(self) -> float:
        """Of all groups, m/s², by how well each is known."""
        return float(np.average(self.values, weights=1.0 / (self.errors**2 + (ALIKE * self.values) ** 2)))

    def differs(self, g: float) -> bool:
        """Whether all groups fall alike, and not by `g`, m/s², whatever made the target."""
        low, high = zip(*((a - LIKELY * error, a + LIKELY * error) for a, error in self.others), strict=True)
        apart = max(min(self.values[0], *low) - g, g - max(self.values[0], *high))
        alike = np.ptp(self.values) <= AGREEMENT * abs(self.values[0]) and self.left <= SMOOTH
        sure = SURE * self.errors.max() <= apart and self.errors.max() <= AGREEMENT * abs(self.values[0])
        return bool(alike and sure and apart > OFF * g and RANGE[0] <= self.values[0] / g <= RANGE[1])


def other_fall(scene: Scene, motion: Motion) -> Fall | None:
    """The fall of the target's vertices where it is not that of the scene's gravity; None where it is, or unknown."""
    g = float(np.linalg.norm(scene.gravity))
    if not g > 0 or scene.mode("gravity") != "n" or not np.isclose(motion.times[0], 0.0):
        return None
    for i, cloth in enumerate(scene.cloths):
        groups = far_groups(scene, cloth, np.asarray(motion.seen(i)[: FALL_FRAMES + 1].all(axis=0)))
        found = None if groups is None else measured(motion, i, scene.gravity / g, *groups, scene.delta)
        if found is not None and found.differs(g):
            return Fall(found.acceleration, g)
    return None


def far_groups(scene: Scene, cloth: Cloth, seen: Flags) -> tuple[list[Indices], float] | None:
    """Those of the vertices `seen` (n,) of a cloth that fall freely at first, in groups, the farthest from held ones
    first, and how far, m, they may fall; None where that is not known.
    """
    windy = cloth.feels_air and (scene.wind_keys or scene.wind.any() or scene.mode("wind") != "n")
    thrown = cloth.velocity.any() or cloth.mode("velocity") != "n"
    if windy or thrown or scene.gravity_keys or scene.frame or scene.colliders or cloth.pins or not len(cloth.springs):
        return None
    down = scene.gravity / np.linalg.norm(scene.gravity)
    edges = cloth.positions[cloth.springs[:, 0]] - cloth.positions[cloth.springs[:, 1]]
    lengths = np.maximum(cloth.lengths, np.finfo(float).tiny)
    loose = (np.abs(edges @ down) <= LIES_ACROSS * lengths) & (np.abs(cloth.rest - cloth.lengths) <= 1e-3 * lengths)
    far = np.ones(len(cloth.mass), bool)
    far[cloth.springs[~loose].ravel()] = False
    for sphere in scene.spheres:
        far &= np.linalg.norm(cloth.positions - sphere.centre, axis=1) > 1.5 * sphere.radius
    away = graph_distance(cloth)
    far &= ~cloth.fixed & (away >= FEWEST_EDGES) & seen
    if far.sum() < FEWEST_VERTICES:
        return None
    order = np.flatnonzero(far)[np.argsort(-away[far], kind="stable")]
    order = order[: max(len(order) // 2, ENOUGH)]
    finite = away[order][np.isfinite(away[order])]
    depth = DEPTH * float(np.median(lengths)) * float(finite.min() if len(finite) else MOST_FRAMES)
    return np.array_split(order, GROUPS), depth


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


def measured(
    motion: Motion, cloth: int, down: Array, groups: list[Indices], depth: float, step: float
) -> Measured | None:
    """How each group falls along `down`, at most `depth`, m; None where the target shows too little. `step`, s, is one
    that may have made it.
    """
    positions, seen = motion.of(cloth)[: MOST_FRAMES + 1], motion.seen(cloth)[: MOST_FRAMES + 1]
    groups = [group[np.asarray(seen[:, group].all(axis=0))] for group in groups]
    vertices = np.concatenate(groups)
    if len(vertices) < FEWEST_VERTICES or min(map(len, groups)) < 2:
        return None
    whole = fallen(positions, vertices, down).mean(axis=1)
    deep = np.flatnonzero(np.abs(whole) > depth)
    last = int(deep[0]) if len(deep) else len(whole) - 1
    if last < FALL_FRAMES:
        return None
    times, u = motion.times[: last + 1], whole[: last + 1]
    passed = np.concatenate([[0.0], np.cumsum(np.diff(times) * (u[1:] + u[:-1]) / 2.0)])
    columns = np.stack([times, times**2 / 2.0, -passed], axis=1)[1:]
    solve = np.linalg.pinv(columns)
    velocity, acceleration, damping = solve @ u[1:]
    if abs(velocity) > abs(acceleration) * times[1]:  # it moves already
        return None
    own = [solve[1] @ fallen(positions[: last + 1], group, down)[1:] for group in groups]
    values, spread = np.array([a.mean() for a in own]), np.array([a.std(ddof=1) for a in own])
    pooled = np.sqrt(np.mean(spread**2))  # of a few vertices chance alone may show hardly any
    errors = np.maximum(spread, pooled) / np.sqrt([len(a) for a in own])
    left = float(np.abs(columns @ (velocity, acceleration, damping) - u[1:]).max() / np.abs(u).max())
    interval = float(times[1])
    others = [(float(values[0]) * (1.0 + 0.5 * damping * interval), 0.0)]
    later = slice(LATER if len(times) - LATER > LONG else 0, None)
    if not later.start and len(vertices) < ENOUGH:
        return None
    unlikely = UNLIKELY if later.start else SHORT_UNLIKELY
    made = [(columns + ahead(times[1:], h)[:, None] * (0.0, 1.0, 0.0), slice(None)) for h in (interval, step)]
    if later.start:
        made.append((np.concatenate([columns, np.ones((len(columns), 1))], axis=1)[later], later))
    for design, part in made:
        solve = np.linalg.pinv(design)
        if np.abs(design @ (solve @ u[1:][part]) - u[1:][part]).max() <= unlikely * left * np.abs(u).max():
            each = np.concatenate([solve[1] @ fallen(positions[: last + 1], group, down)[1:][part] for group in groups])
            others.append((float(solve[1] @ u[1:][part]), float(each.std(ddof=1) / np.sqrt(len(each)))))
    return Measured(values, errors, tuple(others), left)


def ahead(times: Array, interval: float) -> Array:
    """How far, s², of a unit acceleration, BDF2 with steps of `interval`, s, is ahead of a free fall: its first step is
    backward Euler, h²/2 too far, and of e₁ the next steps make eₙ = (4 eₙ₋₁ − eₙ₋₂)/3 = 3/2 (1 − 3⁻ⁿ) e₁.
    """
    return np.asarray(0.75 * interval**2 * (1.0 - 3.0 ** (-times / interval)))


def fallen(positions: Array, vertices: Indices, down: Array) -> Array:
    """How far (F, V) the vertices have moved along `down`, m."""
    return np.asarray((positions[:, vertices] - positions[0, vertices]) @ down)
