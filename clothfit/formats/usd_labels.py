"""Texture coordinates and parts of the meshes of a USD stage: primvars, mesh prims, subsets of faces.

The texture coordinates are the primvar `st`, or the first with pairs of numbers; of each vertex, or of each corner of a
face. Each mesh is a part with the name of its prim, and so is each of its subsets of faces, which tools make for
materials.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
import numpy.typing as npt

from clothfit.base.arrays import Array, Indices
from clothfit.formats.animation import fans
from clothfit.formats.labels import Parts, known, parts_of

FIRST = "st"
"""The usual name of texture coordinates."""


def labels(
    shapes: Sequence[Any], mirrored: Sequence[bool], code: Any, triangles: Indices
) -> tuple[Array | None, Parts]:
    """Texture coordinates (T, 3, 2), NaN where unknown, and parts, of all shapes, whose triangles are these (T, 3)."""
    from pxr import UsdGeom

    textures: list[Array] = [np.zeros((0, 3, 2))]
    whole: list[tuple[str, npt.NDArray[np.intp]]] = []
    subsets: list[tuple[str, npt.NDArray[np.intp]]] = []
    begin = 0
    for prim, mirror in zip(shapes, mirrored, strict=True):
        mesh = UsdGeom.Mesh(prim)
        if not mesh:
            continue
        sizes, corners = (np.array(attribute.Get(code) or [], np.int64)
                          for attribute in (mesh.GetFaceVertexCountsAttr(), mesh.GetFaceVertexIndicesAttr()))
        texture = _texture(mesh, sizes, corners, code)
        left = mesh.GetOrientationAttr().Get() == UsdGeom.Tokens.leftHanded
        textures.append(texture[:, ::-1] if left != mirror else texture)
        face = np.repeat(np.arange(len(sizes)), np.maximum(sizes - 2, 0))  # of each triangle
        whole.append((prim.GetName(), begin + np.arange(len(face))))
        for subset in UsdGeom.Subset.GetAllGeomSubsets(mesh):
            if subset.GetElementTypeAttr().Get() == UsdGeom.Tokens.face:
                own = np.isin(face, np.array(subset.GetIndicesAttr().Get(code) or [], np.int64))
                subsets.append((subset.GetPrim().GetName(), begin + np.flatnonzero(own)))
        begin += len(face)
    return known(np.concatenate(textures)), parts_of([*whole, *subsets], triangles)


def _texture(mesh: Any, sizes: npt.NDArray[np.int64], corners: npt.NDArray[np.int64], code: Any) -> Array:
    """Texture coordinates (T, 3, 2) of a mesh, NaN where it has none."""
    from pxr import UsdGeom

    count = int(np.maximum(sizes - 2, 0).sum())
    nothing = np.full((count, 3, 2), np.nan)
    every = [each for each in UsdGeom.PrimvarsAPI(mesh).GetPrimvarsWithValues() if _has_pairs(each)]
    if not every:
        return nothing
    chosen = next((each for each in every if each.GetPrimvarName() == FIRST), every[0])
    values = np.array(chosen.ComputeFlattened(code) or [], np.float64)
    if values.ndim != 2 or values.shape[1] != 2:
        return nothing
    at_corners = chosen.GetInterpolation() == UsdGeom.Tokens.faceVarying
    owner = fans(sizes, np.arange(len(corners)) if at_corners else corners)
    needed = len(corners) if at_corners else int(corners.max(initial=-1)) + 1
    return values[owner] if len(values) >= needed else nothing


def _has_pairs(primvar: Any) -> bool:
    """Whether the values of a primvar are pairs of numbers, as texture coordinates are."""
    return str(primvar.GetTypeName()) in ("texCoord2f[]", "texCoord2d[]", "texCoord2h[]", "float2[]", "double2[]")
