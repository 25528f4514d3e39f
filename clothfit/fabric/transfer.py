"""The fabric of one cloth on another mesh.

Bending springs that push (`bending`) become those of the same bending stiffness. Where they are at rest, what they do
belongs to the mesh; each family of them keeps its stiffness k L² / ΣA, with the areas of both triangles, as in the
editor's rule. What differs from place to place goes along where the two meshes lie in one place: masses per area, and
stiffness around each vertex relative to that of a uniform cloth of the same fabric.

n vertices, S springs.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

from clothfit.base.arrays import Array, Indices
from clothfit.base.errors import InvalidInput
from clothfit.fabric import hinges
from clothfit.fabric.fabric import Fabric, Woven, fabric_of, material_of, with_springs_at_rest, woven
from clothfit.fabric.hinges import Material
from clothfit.scene.cloth import Cloth
from clothfit.scene.directions import Slots, keys
from clothfit.scene.families import FAMILIES, families_of
from clothfit.scene.kinds import AIR

NEAR = 1.0
"""Median distance to the nearest vertex of the other mesh, in its springs, up to which the two lie in one place."""

UNEVEN = 0.05
"""Relative spread of what is local that counts: less comes from the border of a mesh."""


class Transferred(NamedTuple):
    """A fabric on another mesh."""

    fields: dict[str, Any]  # of the object in the file
    pushes: bool  # whether its bending springs push, so that it needs two Newton iterations
    local: bool  # whether local differences went along


def transferred(source: Cloth, target: Cloth) -> Transferred:
    """`target` with the fabric, the damping and the air drag of `source`. Raises InvalidInput where one of them is no
    cloth.
    """
    own, old, mesh = fabric_of(source), material_of(source), material_of(target)
    if own is None or old is None or mesh is None or not min(own.stretch) > 0:
        raise InvalidInput("a fabric is taken from and to cloths with faces, and springs that resist all pulls")
    pushes = min(own.bending_at_rest[:2]) > 0
    made = _uniform(source, own, old, target, mesh)
    local = _local(source, own, old, target)
    if local is not None:
        mass, stiffness = made.mass * local[0], made.stiffness * local[1][made.ends].mean(axis=1)
        whole = (made.stiffness @ made.rest**2) / (stiffness @ made.rest**2)  # as in a pull that is the same everywhere
        made = made._replace(mass=mass * (made.mass.sum() / mass.sum()), stiffness=stiffness * whole)
    fields = {
        "vertMass": made.mass.tolist(), "springs": made.ends.reshape(-1).tolist(),
        "springStiffness": made.stiffness.tolist(), "springRestLength": made.rest.tolist(),
        "damping": source.damping, "dragCoefficient": _drag(source, target), "dragLaw": source.drag_law,
    }  # fmt: skip
    if target.layout.family is not None:
        used, family = np.unique(_families(target, made.ends, mesh), return_inverse=True)
        fields["families"] = {"names": [FAMILIES[k] for k in used], "springs": family.tolist()}
    return Transferred(fields, pushes, local is not None)


def _uniform(source: Cloth, own: Fabric, old: Material, target: Cloth, mesh: Material) -> Woven:
    """The fabric of a cloth, the same everywhere, on the mesh of another."""
    if min(own.bending_at_rest[:2]) > 0:
        warp = mesh.warp if target.layout.family is not None else target.layout.warp
        return woven(target.positions, target.triangles, own.density, own.stretch, own.bending_at_rest, target.fixed,
                     warp)  # fmt: skip
    over = hinges.folds(mesh)
    chords = over.vertices[:, :2]
    area = mesh.areas[over.triangle].sum(axis=1)
    stiffness = _per_area(source, old)[_families(target, chords, mesh)] * area / over.length**2
    kept = stiffness > 0
    return with_springs_at_rest(mesh, own.density, own.stretch, chords[kept], stiffness[kept])


def _families(cloth: Cloth, springs: Indices, mesh: Material) -> Slots:
    """The family (S,) of springs of a cloth, along its directions."""
    return families_of(cloth.positions, cloth.triangles, springs, mesh.warp)


def _per_area(cloth: Cloth, mesh: Material) -> Array:
    """k L² / ΣA, N/m, of the bending springs of each of FAMILIES; that of all in families without any."""
    over = hinges.folds(mesh)
    key, first = np.unique(keys(over.vertices[:, :2]), return_index=True)
    area = mesh.areas[over.triangle].sum(axis=1)[first]
    own = keys(cloth.springs)
    at = np.minimum(np.searchsorted(key, own), max(len(key) - 1, 0))
    bends = (key[at] == own) & ~np.isin(own, keys(mesh.ends)) if len(key) else np.zeros(len(own), bool)
    family = _families(cloth, cloth.springs, mesh)[bends]
    strength = np.bincount(family, (cloth.stiffness * cloth.lengths**2)[bends], len(FAMILIES))
    total = np.bincount(family, area[at[bends]] if len(key) else None, len(FAMILIES))
    whole = strength.sum() / total.sum() if total.any() else 0.0
    return np.where(total > 0, strength / np.where(total > 0, total, 1.0), whole)


def _local(source: Cloth, own: Fabric, old: Material, target: Cloth) -> tuple[Array, Array] | None:
    """Weight and stiffness around each vertex (n,) of the target, relative to a uniform cloth; None where the two
    meshes do not lie in one place, or nothing differs.
    """
    from scipy.spatial import cKDTree

    distance, nearest = cKDTree(source.positions).query(target.positions, k=3)
    edge = float(np.median(source.lengths))
    if np.median(np.asarray(distance)[:, 0]) > NEAR * edge:
        return None
    plain = _uniform(source, own, old, source, old)
    ratio = _around(source.springs, source.stiffness * source.lengths**2, len(source.mass)) / _around(
        plain.ends, plain.stiffness * np.linalg.norm(np.diff(source.positions[plain.ends], axis=1)[:, 0], axis=1) ** 2,
        len(source.mass),
    )  # fmt: skip
    weight = source.mass / plain.mass
    if max(np.std(np.log(each)) for each in (weight, np.maximum(ratio, 1e-9))) < UNEVEN:
        return None
    near = 1 / (np.asarray(distance) + 1e-6 * edge) ** 2
    near /= near.sum(axis=1, keepdims=True)
    return (weight[nearest] * near).sum(axis=1), (ratio[nearest] * near).sum(axis=1)


def _around(ends: Indices, strength: Array, count: int) -> Array:
    """What the springs (S, 2) at each vertex (n,) have together."""
    return np.asarray(np.bincount(ends.reshape(-1), np.repeat(strength, 2), count))


def _drag(source: Cloth, target: Cloth) -> float:
    """The drag coefficient: in the editor's law, which depends on the areas of faces, that of the same air."""
    if source.drag_law == AIR or not source.air_drag > 0:
        return source.drag
    return source.drag / source.air_drag * target.air_drag
