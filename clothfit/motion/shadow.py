"""The shadow of a drape as a target: its outline, or the drape coefficient alone.

The drape coefficient is the part of the ring beyond what is held that the shadow covers, (A − A_h)/(A_0 − A_h), with
the areas of the shadow, of what is held and of the flat cloth (G. E. Cusick 1968). Either is made into a shape of the
cloth that throws such a shadow, of which nothing else is compared (the objectives "outline" and "coverage"): each
vertex as far from what is held, along the cloth, as in the flat cloth, hanging down where it is nearer in the shadow.
From there the search for the shape at rest begins, so an outline has the folds of the target.
"""

from __future__ import annotations

import numpy as np

from clothfit.base.arrays import Array
from clothfit.base.errors import InvalidInput
from clothfit.motion.motion import Motion
from clothfit.scene.scene import Scene


def shadow_target(scene: Scene, outline: Array | None = None, coefficient: float | None = None) -> Motion:
    """The target of a drape from the `outline` of its shadow, points (N, 2) of a polygon, x and z in m, or from its
    drape `coefficient`, a number below 1. Raises InvalidInput where the scene is no drape, or no such shadow can be.
    """
    if len(scene.cloths) != 1 or (outline is None) == (coefficient is None):
        raise InvalidInput("a shadow is that of one cloth, by its outline or by its drape coefficient")
    cloth = scene.cloths[0]
    if not cloth.fixed.any() or cloth.fixed.all():
        raise InvalidInput(f"{scene.name}: a drape has fixed vertices in its middle and others around them")
    centre = cloth.positions[cloth.fixed].mean(axis=0)
    flat = (cloth.positions - centre)[:, [0, 2]]
    away, angle = np.hypot(*flat.T), np.arctan2(flat[:, 1], flat[:, 0])
    held, rim = float(away[cloth.fixed].max()), float(away.max())
    if outline is None:
        assert coefficient is not None
        if not 0 < coefficient < 1:
            raise InvalidInput(f"the drape coefficient must be between 0 and 1; {coefficient:g} was given")
        radius = np.full(len(flat), np.sqrt(held**2 + coefficient * (rim**2 - held**2)))
    else:
        radius = _radii(np.asarray(outline, float), centre[[0, 2]], angle)
        if not (radius.min() > 0.5 * held and radius.max() < 1.05 * rim):
            ends = f"{radius.min():.3g} to {radius.max():.3g} m"
            raise InvalidInput(f"the outline is {ends} from the middle of {scene.name}, which is held within "
                               f"{held:.3g} m and ends at {rim:.3g} m")  # fmt: skip
    beyond = np.maximum(away - held, 0.0)
    inward = np.clip((radius - held) / (rim - held), -0.99, 1.0)
    share = (np.minimum(away, held) + inward * beyond) / np.maximum(away, 1e-300)
    shape = np.array(cloth.positions)
    shape[:, [0, 2]] = centre[[0, 2]] + flat * share[:, None]
    shape[:, 1] -= beyond * np.sqrt(1.0 - inward**2)
    positions = np.stack([cloth.positions, shape])
    return Motion(positions, np.array([0.0, scene.delta]), scene.vertex_counts, np.zeros(positions.shape[:2], bool),
                  "shadow")  # fmt: skip


def _radii(points: Array, centre: Array, angle: Array) -> Array:
    """How far a polygon (N, 2) around a centre is from it in the directions of some angles (n,). Raises InvalidInput.
    """
    if points.ndim != 2 or points.shape[1] != 2 or len(points) < 8 or not np.isfinite(points).all():
        raise InvalidInput(f"an outline has at least 8 points (N, 2); one of shape {points.shape} was given")
    points = points - centre
    own, far = np.arctan2(points[:, 1], points[:, 0]), np.hypot(*points.T)
    order = np.argsort(own)
    return np.asarray(np.interp(angle, own[order], far[order], period=2 * np.pi))
