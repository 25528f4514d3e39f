"""What a new scene says of how its cloth is woven and divided, from what the mesh and the user say.

Families of springs follow the texture coordinates where the mesh has some: u along the cloth, v across it. Garments are
unfolded into their patterns for that, so these are the directions of the cloth. The families are written only where
they are not those that the scene would show anyway.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
import numpy.typing as npt

from clothfit.base.arrays import Array, Indices
from clothfit.base.errors import InvalidInput
from clothfit.formats.labels import unused
from clothfit.meshes.mesh import Mesh
from clothfit.scene.families import FAMILIES, families_of
from clothfit.scene.weave.layout import ELSEWHERE

FLAT = 1e-9
"""Sine of the angle at a corner of a triangle in the texture below which it has no area there."""


def fields(
    mesh: Mesh, springs: Indices, warp: Sequence[float] | None, regions: Mapping[str, npt.ArrayLike]
) -> dict[str, Any]:
    """The fields `warp`, `regions` and `families` of the object of a mesh, those that are needed. Raises InvalidInput.
    """
    made: dict[str, Any] = {}
    if warp is not None:
        made["warp"] = _direction(warp)
    named = _regions(mesh, regions)
    if named:
        made["regions"] = [{"name": name, "vertices": own.tolist()} for name, own in named.items()]
    if warp is None and mesh.texture is not None:
        own, shown = (families_of(mesh.positions, mesh.triangles, springs, given) for given in (along(mesh), None))
        used, family = np.unique(own, return_inverse=True)
        if not np.array_equal(own, shown):
            made["families"] = {"names": [FAMILIES[k] for k in used], "springs": family.tolist()}
    return made


def along(mesh: Mesh) -> Array:
    """The direction (T, 3) in which u grows in each triangle, 0 where nobody knows."""
    if mesh.texture is None:
        return np.zeros((len(mesh.triangles), 3))
    at = mesh.positions[mesh.triangles]
    first, second = at[:, 1] - at[:, 0], at[:, 2] - at[:, 0]
    (a, b), (c, d) = (mesh.texture[:, 1] - mesh.texture[:, 0]).T, (mesh.texture[:, 2] - mesh.texture[:, 0]).T
    area = a * d - b * c
    with np.errstate(invalid="ignore", over="ignore"):
        size = np.hypot(a, b) * np.hypot(c, d)
        good = np.isfinite(area) & (np.abs(area) > FLAT * size)
        u = (first * d[:, None] - second * b[:, None]) * np.sign(area)[:, None]  # dP/du · |area|
    return np.where((good & np.isfinite(u).all(axis=1))[:, None], u, 0.0)


def _direction(warp: Sequence[float]) -> dict[str, float]:
    """The field of a direction. Raises InvalidInput."""
    vector = np.asarray(warp, float)
    if vector.shape != (3,) or not np.isfinite(vector).all() or not vector.any():
        raise InvalidInput(f"warp: {list(warp)} is not a direction; give three finite numbers that are not all 0")
    return dict(zip("xyz", vector.tolist(), strict=True))


def _regions(mesh: Mesh, given: Mapping[str, npt.ArrayLike]) -> dict[str, Indices]:
    """The vertices of each region: those that are given, then the parts of the mesh. Raises InvalidInput."""
    made: dict[str, Indices] = {}
    for name, vertices in given.items():
        own = np.unique(np.asarray(vertices)).astype(np.int64)
        if not name.strip() or name == ELSEWHERE:
            raise InvalidInput(f"region: {name!r} cannot be a name; give another one")
        if not len(own):
            raise InvalidInput(f"region: {name!r} has no vertices")
        if not 0 <= own[0] <= own[-1] < len(mesh.positions):
            wrong = int(own[0] if own[0] < 0 else own[-1])
            raise InvalidInput(f"region: {name!r}: there is no vertex {wrong}; there are {len(mesh.positions)}")
        made[name] = own.astype(np.int32)
    for name, vertices in mesh.parts:
        if name not in given and len(vertices) < len(mesh.positions):  # one may have come to be all of it
            made[unused(name, [*made, ELSEWHERE])] = vertices
    return made
