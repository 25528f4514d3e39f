"""What is around the cloths of a page: wind, spheres and other colliders, and where they are over time."""

from __future__ import annotations

from typing import Any

import numpy as np

from clothfit.base.arrays import Array
from clothfit.engine.inputs.sampling import centres_at, winds
from clothfit.pictures.solids import Solid, solids
from clothfit.report.packing import box, packed, packed_positions
from clothfit.scene.scene import Scene


def surroundings(scene: Scene, times: Array, x: Array) -> dict[str, Any]:
    """All of it, for a motion x (F, n, 3), m, at times (F,), s."""
    spheres = []
    for path, sphere in zip(np.moveaxis(centres_at(scene, times), 1, 0), scene.spheres, strict=True):
        moved = {"path": path.tolist()} if sphere.position else {}
        spheres.append({"centre": sphere.centre.tolist(), "radius": sphere.radius, **moved})
    return {
        "wind": scene.wind.tolist(),
        **({"gusts": winds(scene, times).tolist()} if scene.wind_keys else {}),
        "spheres": spheres,
        "solids": [solid(each) for each in solids(scene, times, x)],
        "pinned": any(cloth.pins for cloth in scene.cloths),
    }


def solid(found: Solid) -> dict[str, Any]:
    """A collider in triangles: where its axes are at the start, or at each frame, as a place and a quaternion, and in
    them the paths of points that go their own ways.
    """
    from scipy.spatial.transform import Rotation

    count = len(found.centre) if found.moves else 1
    turns = Rotation.from_matrix(found.turn[:count]).as_quat()
    paths = {} if found.paths is None else {"paths": packed_positions(found.paths, *box(found.paths))}
    return {
        **paths,
        "points": packed(found.points),
        "triangles": packed(found.triangles),
        "tone": packed(found.tone),
        "places": found.centre[:count].tolist(),
        "turns": turns.tolist(),
        "endless": found.endless,
    }
