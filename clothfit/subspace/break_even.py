"""From how many vertices on a subspace is faster than full steps: predicted, without compiling anything.

µs of one thread of a processor of 2023 (AMD EPYC), of cloths of about six springs and two faces to a vertex. Another
machine is faster or slower at both; where both were measured, the prediction is scaled by that.
"""

from __future__ import annotations

from bisect import bisect_left
from math import exp, log
from typing import NamedTuple

import numpy as np

from clothfit.engine.system import BDF2, IMPLICIT
from clothfit.scene.scene import Scene

FULL = ((100, 31.0), (256, 75.0), (625, 221.0), (1444, 740.0), (2916, 2250.0), (5041, 6000.0), (14400, 28800.0))
"""Vertices, and a full step of implicit Euler or BDF2 with one iteration at a tolerance of 1e-8."""

ITERATION = 0.8
"""Each further Newton iteration, relative to the first."""

VECTORS = 64

STATE = {"physics": 100.0, "network": 20.0}
"""A step with so many vectors; that of physics is in proportion to the iterations."""

LEAST = 3.0
"""Of any step: it begins and ends."""

ENTRY, FACE = 6.5e-5, 7.7e-3
"""Decoding for each entry of the basis, and normals for each face."""

MOST = 10_000_000
"""Vertices that nobody has."""


class BreakEven(NamedTuple):
    """What is predicted for a scene, all its cloths together."""

    full_us: float  # a full step
    physics_us: float  # a frame in a subspace: state, positions and normals
    network_us: float  # the same of a network
    vertices_from: int  # of one cloth, from which on physics is faster
    network_from: int

    @property
    def pays(self) -> bool:
        """Whether any of them is faster."""
        return min(self.physics_us, self.network_us) < self.full_us


def break_even(scene: Scene) -> BreakEven | None:
    """The prediction; None where a subspace does not know what the scene has."""
    if scene.method not in (IMPLICIT, BDF2) or scene.self_contact is not None:
        return None
    k = scene.newton_iterations
    frames: list[float] = [sum(frame(len(c.mass), len(c.triangles), way, k) for c in scene.cloths) for way in STATE]
    full = sum(full_step(len(c.mass), k) for c in scene.cloths)
    return BreakEven(full, frames[0], frames[1], *(vertices_from(way, k) for way in STATE))


def pays_from(scene: Scene, c: int, vectors: int, way: str, frame_us: float, full_us: float) -> int:
    """From how many vertices on a model like one of object c pays, whose frame and full step were measured."""
    n, k = len(scene.cloths[c].mass), scene.newton_iterations
    predicted = frame(n, len(scene.cloths[c].triangles), way, k, vectors)
    return vertices_from(way, k, vectors, full_us / full_step(n, k), frame_us / predicted)


def sentence(found: BreakEven) -> str:
    """The prediction, for people."""
    own = f"a full step takes about {rounded(found.full_us)} µs"
    other = f"about {rounded(found.physics_us)} by physics, {rounded(found.network_us)} by a network"
    return (
        f"{own}, a frame in a subspace of {VECTORS} vectors {other}; that pays from about {found.vertices_from} "
        f"vertices on, a network from about {found.network_from} (clothfit subspace)"
    )


def rounded(us: float) -> str:
    """A time with two digits."""
    return f"{float(f'{us:.2g}'):,.0f}"


def full_step(vertices: int, iterations: int = 1) -> float:
    """The µs of a full step, between the measured ones in proportion to a power of the number of vertices."""
    sizes, times = (np.log([row[c] for row in FULL]) for c in range(2))
    at = log(max(vertices, 1))
    part = slice(-2, None) if at > sizes[-1] else slice(0, 2)
    slope = (times[part][1] - times[part][0]) / (sizes[part][1] - sizes[part][0])
    beyond = at - float(np.clip(at, sizes[0], sizes[-1]))
    return exp(float(np.interp(at, sizes, times)) + slope * beyond) * (1.0 + ITERATION * (iterations - 1))


def frame(vertices: int, faces: int, way: str, iterations: int = 1, vectors: int = VECTORS) -> float:
    """The µs of a frame in a subspace, with positions and exact normals, stepped by a `way` of STATE."""
    size = min(vectors, 3 * vertices)
    state = max(LEAST, STATE[way] * (size / VECTORS) ** 2) * (iterations if way == "physics" else 1)
    return state + ENTRY * 3 * vertices * size + FACE * faces


def vertices_from(
    way: str, iterations: int = 1, vectors: int = VECTORS, step_scale: float = 1.0, frame_scale: float = 1.0
) -> int:
    """The least number of vertices of a cloth for which a frame takes less than a full step; the scales are those of
    what was measured to what is predicted.
    """

    def pays(count: int) -> bool:
        own = frame_scale * frame(count, 2 * count, way, iterations, vectors)
        return own < step_scale * full_step(count, iterations)

    return int(float(f"{1 + bisect_left(range(1, MOST), True, key=pays):.2g}"))
