"""The shadow of a cloth under light from above, and that of a drape as a target: its outline, or its drape coefficient.

The drape coefficient is the part of the ring beyond what is held that the shadow covers, (A − A_h)/(A_0 − A_h), with
the areas of the shadow, of what is held and of the flat cloth (G. E. Cusick 1968). The ring of the flat cloth's mesh is
then covered by as much in every direction; nothing but areas is to be compared with it (objective "coverage").
"""

from __future__ import annotations

from typing import Any, TypeAlias

import numpy as np
from numpy.typing import NDArray

from clothfit.base.arrays import Array
from clothfit.base.errors import InvalidInput
from clothfit.motion.motion import Motion
from clothfit.scene.directions import edges_of
from clothfit.scene.scene import Scene

Integers: TypeAlias = NDArray[np.integer[Any]]

RAYS = 360
"""Directions in which an outline is compared."""


def outermost(flat: Array, edges: Integers) -> tuple[Array, Integers, Array]:
    """How far edges (E, 2) between points (n, 2) reach in directions around the origin: r (RAYS,), the ends of the
    outermost ones (RAYS, 2), and ∂r by them (RAYS, 2, 2).

    In the direction e the edge from a to b has r = n·a / n·e with n across b − a, so ∂r/∂a = (1 − t) n / n·e and
    ∂r/∂b = t n / n·e, where it is cut at t.
    """
    a, b = flat[edges[:, 0]], flat[edges[:, 1]]
    angle = 2 * np.pi * np.arange(RAYS) / RAYS
    e = np.stack([np.cos(angle), np.sin(angle)])  # (2, RAYS)
    sine_a, sine_b = a[:, 1:] * e[0] - a[:, :1] * e[1], b[:, 1:] * e[0] - b[:, :1] * e[1]
    cut = (sine_a > 0) != (sine_b > 0)
    t = np.where(cut, sine_a / np.where(cut, sine_a - sine_b, 1.0), 0.0)
    along = np.where(cut, (1 - t) * (a @ e) + t * (b @ e), -np.inf)
    edge, ray = along.argmax(axis=0), np.arange(RAYS)
    t, r = t[edge, ray][:, None], np.maximum(along[edge, ray], 0.0)
    n = (b - a)[edge][:, ::-1] * np.array([1.0, -1.0])
    n = n / np.where(r > 0, (n * e.T).sum(axis=1), np.inf)[:, None]
    return r, edges[edge], np.stack([(1 - t) * n, t * n], axis=1)


def shadow_target(scene: Scene, outline: Array | None = None, coefficient: float | None = None) -> Motion:
    """The target of a drape from the `outline` of its shadow, points (N, 2) of a polygon, x and z in m, or from its
    drape `coefficient`, a number below 1. Raises InvalidInput where the scene is no drape, or no such shadow can be.
    """
    if len(scene.cloths) != 1 or (outline is None) == (coefficient is None):
        raise InvalidInput("a shadow is that of one cloth, by its outline or by its drape coefficient")
    cloth = scene.cloths[0]
    if not cloth.fixed.any() or cloth.fixed.all():
        raise InvalidInput(f"{scene.name}: a drape has fixed vertices in its middle and others around them")
    centre = cloth.positions[cloth.fixed].mean(axis=0)[[0, 2]]
    flat = cloth.positions[:, [0, 2]] - centre
    away = np.hypot(*flat.T)
    held, rim = float(away[cloth.fixed].max()), float(away.max())
    if coefficient is not None:
        if not 0 < coefficient < 1:
            raise InvalidInput(f"the drape coefficient must be between 0 and 1; {coefficient:g} was given")
        whole = outermost(flat, edges_of(cloth.triangles.reshape(-1, 3)).ends)[0]
        radii = np.sqrt(held**2 + coefficient * (np.maximum(whole, held) ** 2 - held**2))
    else:
        points = np.asarray(outline, float)
        if points.ndim != 2 or points.shape[1] != 2 or len(points) < 8 or not np.isfinite(points).all():
            raise InvalidInput(f"an outline has at least 8 points (N, 2); one of shape {points.shape} was given")
        order = np.argsort(np.arctan2(*(points - centre).T[::-1]))
        radii = outermost(points - centre, np.column_stack([order, np.roll(order, -1)]))[0]
        if not (radii.min() > 0.5 * held and radii.max() < 1.05 * rim):
            ends = f"{radii.min():.3g} to {radii.max():.3g} m"
            raise InvalidInput(f"the outline is {ends} from the middle of {scene.name}, which is held within "
                               f"{held:.3g} m and ends at {rim:.3g} m")  # fmt: skip
    positions = np.stack([cloth.positions, cloth.positions])  # of which none is observed
    return Motion(positions, np.array([0.0, scene.delta]), scene.vertex_counts, np.zeros(positions.shape[:2], bool),
                  "shadow", radii=radii)  # fmt: skip
