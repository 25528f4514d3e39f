"""Values of a whole cloth and of the air around it from balances of momentum that hold over the smooth parts of it.

Where every vertex is seen in three successive frames at equal times, its velocity v and acceleration a follow from
them, and with fields φ over the cloth that are smooth and vanish where it is held

    Σ φ m a = s Σ φ f_springs + α Σ φ d + c Σ φ Σ_faces κ₁ n (n·(W − v̄)) + Σ φ m g

in each frame: linear in one factor s on the stiffnesses, the damping α, the drag c, c W and gravity. The law "air" is
linear in c, and its dependence on W is made so around the W found before. The fields average
over what the model of the springs, noise and the frames' distance make of single vertices, and no frame depends on the
ones before: neither chaos nor what a wrong model leaves in late frames hides the wind here. A fit of whole motions may
begin from these values, and they can be told beside its own.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import NamedTuple

import numpy as np

from clothfit.base.arrays import Array, Indices
from clothfit.engine.forces.air import RATIO, SHARE
from clothfit.motion.motion import Motion
from clothfit.objective.objective import Objective
from clothfit.registration.free_fall import graph_distance
from clothfit.scene.cloth import Cloth
from clothfit.scene.fit_vector import bounds, with_parameters
from clothfit.scene.kinds import AIR
from clothfit.scene.scene import Scene
from clothfit.scene.smooth_maps import vertex_modes
from clothfit.strategy.gravity_direction import held

FIELDS = 9
"""Smooth fields."""

FEWEST_FRAMES, MOST_NUMBERS = 12, 3_000_000
"""Frames at least, and numbers of springs and faces in all frames at most; of more of them some frames are left out."""

EQUAL = 1e-3
"""Relative difference of times between frames that count as equal."""

ROUNDS, IN_AIR = 2, 6
"""How often the springs' damping, which is a product, is taken from the values before; as often as that where the law
"air" is linear only around them.
"""

USUAL = 5.0
"""m/s: the law "air" is at first as linear as if all faces met this wind."""

LEAST = {"stiffness": 1e-3, "damping": 0.0, "drag": 0.0}
"""The least of what is found, the factor s for stiffnesses."""

Unknown = tuple[str, int]
"""A kind, and the component of a vector."""


class Frames(NamedTuple):
    """A cloth in K frames."""

    x: Array  # (K, n, 3), m
    v: Array  # (K, n, 3), m/s
    a: Array  # (K, n, 3), m/s²


def values(objective: Objective, p: Array) -> Array | None:
    """The parameters p (P,) with stiffnesses times one factor, damping, drag, wind and gravity, as far as they are
    fitted, by the balances above; None where the targets do not show them, or something else pushes the cloth.
    """
    scene = objective.scene
    if len(objective.cloths) != 1 or objective.own or scene.obstacles or scene.gravity_keys:
        return None
    if scene.wind_keys and (scene.wind_keys.file or scene.gusts.any() or scene.mode("gusts") != "n"):
        return None  # it changes over time
    cloth = objective.cloths[0]
    given = [(each.scene, frames_of(each.motion, cloth, each.scene)) for each in objective.experiments]
    known = [(own, frames) for own, frames in given if frames is not None]
    if sum(len(frames.x) for _, frames in known) < FEWEST_FRAMES:
        return None
    for i in range(IN_AIR if scene.cloths[cloth].drag_law == AIR else ROUNDS):
        rows = [Terms(with_parameters(own, p), cloth, frames, i == 0).rows() for own, frames in known]
        wanted = unknowns(scene, scene.cloths[cloth])
        found = solved(wanted, *(np.concatenate([row[i] for row in rows]) for i in range(2)))
        if found is None:
            return None
        p = with_found(objective, p, found)
    return p


def frames_of(motion: Motion, cloth: int, scene: Scene) -> Frames | None:
    """Frames in which all of a cloth is seen, with the one before and after; None where there are none."""
    own = scene.cloths[cloth]
    x, times = motion.of(cloth), motion.times
    whole = np.asarray(motion.seen(cloth)[:, ~own.fixed].all(axis=1))
    gap = np.diff(times)
    even = np.abs(gap[1:] - gap[:-1]) <= EQUAL * gap[1:]
    last = times[2:] <= (scene.frames - 1 + EQUAL) * scene.delta
    places = np.flatnonzero(whole[:-2] & whole[1:-1] & whole[2:] & even & last) + 1
    if not len(places) or own.pins:
        return None
    size = 3 * (len(own.springs) + len(own.triangles))
    places = places[:: max(len(places) * size // MOST_NUMBERS, 1)]
    h = gap[places][:, None, None]
    before, now, after = x[places - 1], x[places], x[places + 1]
    return Frames(now, (after - before) / (2.0 * h), (after - 2.0 * now + before) / h**2)


def fields(cloth: Cloth) -> Array:
    """Smooth fields (M, n) that vanish at held vertices."""
    away = graph_distance(cloth)
    away = np.where(np.isfinite(away), away, 0.0) if cloth.fixed.any() else np.ones(len(away))
    return np.asarray((vertex_modes(cloth, FIELDS) * (away / max(float(away.max()), 1.0))[:, None]).T)


class Terms:
    """The terms of the balances of one cloth, with the values of a scene."""

    def __init__(self, scene: Scene, index: int, frames: Frames, first: bool = False) -> None:
        """`first`: nothing is known of the wind."""
        self.scene, self.cloth, self.frames, self.first = scene, scene.cloths[index], frames, first
        self.fields = fields(self.cloth)

    def rows(self) -> tuple[Array, Array]:
        """Columns (N, Q) of what is fitted, in the order of `unknowns`, and the rest (N,), as right sides."""
        cloth, mass = self.cloth, np.where(self.cloth.fixed, 0.0, self.cloth.mass)
        wanted, x = unknowns(self.scene, self.cloth), self.frames.x
        free = {name for name, _ in wanted}
        still, *blown = self._air()
        wind = sum(w * part for w, part in zip(self.scene.wind, blown, strict=True))
        parts: dict[str, list[Array]] = {
            "stiffness": [self._springs(x)],
            "damping": [self._damping(mass)],
            "drag": [still + (0.0 if "wind" in free else wind)],
            "wind": [(1.0 if "drag" in free else cloth.drag) * part for part in blown],
            "gravity": [self._vertices(np.broadcast_to(mass[:, None] * axis, x.shape)) for axis in np.eye(3)],
        }
        columns = [parts[name][axis] for name, axis in wanted]
        known = self._vertices(mass[:, None] * (self.frames.a - self.scene.gravity))
        for name, value in (("stiffness", 1.0), ("damping", cloth.damping), ("drag", cloth.drag)):
            if name not in free:
                known = known - value * parts[name][0]
        for name, axis in wanted:  # what the right side has of gravity's columns
            if name == "gravity":
                known = known + float(self.scene.gravity[axis]) * parts[name][axis]
        return np.stack([each.ravel() for each in columns], axis=1), np.asarray(known).ravel()

    def _vertices(self, force: Array) -> Array:
        """Σ φ f (M, K, 3) of forces (K, n, 3) of vertices."""
        return np.tensordot(self.fields, force, (1, 1))

    def _pairs(self, force: Array) -> Array:
        """The same of forces (K, S, 3) that act on the first end of each spring, and against them on the second."""
        a, b = self.cloth.springs.T
        return np.tensordot(self.fields[:, a] - self.fields[:, b], force, (1, 1))

    def _springs(self, x: Array) -> Array:
        """The springs' forces, without damping."""
        along, length = self._along(x)
        return self._pairs((self.cloth.stiffness * (length - self.cloth.rest))[..., None] * along)

    def _damping(self, mass: Array) -> Array:
        """What one unit of damping does: −m v, and along each spring k/2 times the speed of its ends."""
        along, _ = self._along(self.frames.x)
        a, b = self.cloth.springs.T
        speed = ((self.frames.v[:, b] - self.frames.v[:, a]) * along).sum(axis=2)
        return self._pairs((self.cloth.stiffness / 2.0 * speed)[..., None] * along) - self._vertices(
            mass[:, None] * self.frames.v
        )

    def _along(self, x: Array) -> tuple[Array, Array]:
        """Directions (K, S, 3) of the springs and their lengths (K, S), m."""
        a, b = self.cloth.springs.T
        edge = x[:, b] - x[:, a]
        length = np.linalg.norm(edge, axis=2)
        return edge / np.maximum(length, np.finfo(float).tiny)[..., None], length

    def _air(self) -> Iterator[Array]:
        """What one unit of drag does in still air, and beside it a wind of 1 m/s along each axis."""
        x, v, corners = self.frames.x, self.frames.v, self.cloth.triangles
        over: Indices | Array = self.fields[:, corners].sum(axis=2)  # (M, T)
        a, b, c = (x[:, corner] for corner in corners.T)
        n = np.cross(b - a, c - a)
        size, moved = np.linalg.norm(n, axis=2), v[:, corners].mean(axis=2)
        pushes = self._by_area(n, size, moved) if self.cloth.drag_law == AIR else (
            (size / 6.0 * push)[..., None] * n for push in (-(n * moved).sum(axis=2), *np.moveaxis(n, 2, 0))
        )  # fmt: skip
        for push in pushes:
            yield np.tensordot(over, push, (1, 1))

    def _by_area(self, n: Array, size: Array, moved: Array) -> Iterator[Array]:
        """The same of the law "air", linear around the wind that the scene has: forces (K, T, 3) of a corner of faces
        that move at velocities `moved`, with normals n of these sizes.
        """
        unit, flow = n / np.maximum(size, np.finfo(float).tiny)[..., None], self.scene.wind - moved
        across = (unit * flow).sum(axis=2)
        speed = np.full(across.shape, USUAL) if self.first else np.abs(across)
        slope, rub = speed if self.first else 2.0 * speed, RATIO * np.linalg.norm(flow, axis=2)
        weight = SHARE * size[..., None]
        by_wind = [
            weight * ((slope - rub)[..., None] * unit[..., i, None] * unit + np.multiply.outer(rub, axis))
            for i, axis in enumerate(np.eye(3))
        ]
        force = ((speed - rub) * across)[..., None] * unit + rub[..., None] * flow
        yield weight * force - np.tensordot(self.scene.wind, by_wind, 1)
        yield from by_wind


def solved(wanted: Sequence[Unknown], C: Array, b: Array) -> dict[Unknown, float] | None:
    """What fulfils the rows C (N, Q), b (N,) best; None where they show no air that moves."""
    from scipy.optimize import lsq_linear

    size = np.linalg.norm(C, axis=0)
    if not (len(wanted) and (size > 0).all()):
        return None
    low = np.array([LEAST.get(name, -np.inf) for name, _ in wanted])
    values = lsq_linear(C / size, b, bounds=(low * size, np.inf)).x / size
    found = dict(zip(wanted, values.tolist(), strict=True))
    drag = found.get(("drag", 0), 1.0)
    if not drag > 0:
        return None
    return {key: value / drag if key[0] == "wind" else value for key, value in found.items()}


def with_found(objective: Objective, p: Array, found: dict[Unknown, float]) -> Array:
    """The parameters p (P,) with what was found, within their bounds."""
    p = p.copy()
    for block in objective.blocks:
        for axis in range(block.count):
            if block.name == "stiffness":
                p[block.start + axis] *= found[block.name, 0] if block.constant[axis] else 1.0
            elif (block.name, axis) in found:
                p[block.start + axis] = found[block.name, axis]
    return np.asarray(np.clip(p, *bounds(objective.scene)))


def unknowns(scene: Scene, cloth: Cloth) -> list[Unknown]:
    """What is fitted: kinds, and components of vectors; gravity's as far as they are free."""
    found = [(name, 0) for name in ("stiffness", "damping", "drag") if cloth.mode(name) != "n"]
    if cloth.feels_air and scene.mode("wind") != "n":
        found += [("wind", axis) for axis in range(3)]
    if scene.mode("gravity") != "n":
        still = held(scene)
        part = next(block.part for block in scene.blocks if block.name == "gravity")
        found += [("gravity", axis) for axis in range(3) if not still[part][axis]]
    return found
