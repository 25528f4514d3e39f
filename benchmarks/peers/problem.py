"""What every peer starts from: one cloth of a scene as plain arrays, in SI units. n vertices, S springs, T faces."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from clothfit.scene.scene import Scene


class Problem(NamedTuple):
    """One cloth, all that its implicit steps depend on."""

    x0: NDArray[np.float64]  # (n, 3), positions at the start, m
    v0: NDArray[np.float64]  # (n, 3), velocities at the start, m/s; 0 at fixed vertices
    free: NDArray[np.bool_]  # (n,)
    mass: NDArray[np.float64]  # (n,), kg
    ends: NDArray[np.int32]  # (S, 2), the vertices each spring joins
    rest: NDArray[np.float64]  # (S,), m
    stiffness: NDArray[np.float64]  # (S,), N/m
    corners: NDArray[np.int32]  # (T, 3), the vertices of each face
    drag: float  # of the faces, kg/(m⁶ s)
    damping: float  # α: α m at the vertices, (α/2) k along the springs
    wind: NDArray[np.float64]  # (3,), m/s
    gravity: NDArray[np.float64]  # (3,), m/s²
    h: float  # time step, s


def problem(scene: Scene, index: int = 0) -> Problem:
    """Cloth `index` of a scene. Raises ValueError for what the peers leave out: spheres, other steps."""
    if scene.spheres or scene.method != 2 or scene.newton_iterations != 1:
        raise ValueError(f"{scene.name}: the peers know no spheres and only the linearised implicit step")
    cloth = scene.cloths[index]
    return Problem(
        np.array(cloth.positions),
        np.where(cloth.fixed[:, None], 0.0, cloth.velocity),
        ~cloth.fixed,
        np.array(cloth.mass),
        np.array(cloth.springs),
        np.array(cloth.rest),
        np.array(cloth.stiffness),
        np.array(cloth.triangles),
        float(cloth.drag),
        float(cloth.damping),
        np.array(scene.wind),
        np.array(scene.gravity),
        float(scene.delta),
    )


def block_pattern(problem: Problem) -> tuple[NDArray[np.int32], NDArray[np.int32], NDArray[np.int32]]:
    """Both halves of the matrix without its diagonal, block by block: row starts (n + 1,), columns (E,), and the slots
    (S, 2) of the blocks (a, b) and (b, a) of each spring.
    """
    n = len(problem.mass)
    a, b = problem.ends[:, 0].astype(np.int64), problem.ends[:, 1].astype(np.int64)
    keys, slots = np.unique(np.concatenate([a * n + b, b * n + a]), return_inverse=True)
    row = np.searchsorted(keys, np.arange(n + 1) * n)
    return row.astype(np.int32), (keys % n).astype(np.int32), slots.reshape(2, -1).T.astype(np.int32).copy()
