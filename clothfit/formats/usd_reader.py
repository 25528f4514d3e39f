"""What is in a USD file, read by a process of its own: `python -m clothfit.formats.usd_reader FILE OUT NAME [JOINT]`.

Pixar's library trusts its files: a damaged one can abort the process that reads it, or take all memory. So the user's
process does not read them. This process writes the arrays that it finds to a file, or prints, as JSON, why there are
none. It reads only the file's own layer: it first removes the references, so that the library opens no other file, here
or on a network.

Texture coordinates are a primvar of each vertex, or of each corner of a face. Each mesh is a part with the name of its
prim, and so is each of its subsets of faces, which tools make for materials.
"""

from __future__ import annotations

import json
import os
import sys
from collections.abc import Sequence
from contextlib import suppress
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from clothfit.base.arrays import Array, Indices
from clothfit.base.errors import InvalidMotion
from clothfit.base.messages import named, shown
from clothfit.formats.animation import Animation, Parts, fans, known, parts_of
from clothfit.formats.axes import UPS, Axes
from clothfit.formats.files import check_room
from clothfit.formats.joints import of_stage

CUT = ("clips", "clipSets")
"""Fields of a prim, beside its references, that name other files: those that hold values of attributes."""

BOUND = ("skel:blendShapes", "skel:skeleton", "primvars:skel:jointIndices")
"""What binds a mesh to a skeleton."""

TEXTURE_NAME = "st"
"""The usual name of the primvar with texture coordinates; else the first with pairs of numbers counts."""

PAIRS = ("texCoord2f[]", "texCoord2d[]", "texCoord2h[]", "float2[]", "double2[]")
"""The types of primvars whose values are pairs of numbers, as texture coordinates are."""

OPENING_BYTES, OPENING_RATIO = 1 << 29, 100
"""Bytes that opening a file may take: a fixed number, and some for each byte of the file, whose arrays are packed."""


def parsed(path: str, name: str) -> Animation:
    """The meshes of a file, or its points where it has none. Raises InvalidMotion, and what the library raises."""
    from pxr import Usd, UsdGeom

    stage, notes = _opened(path)
    every = list(Usd.PrimRange(stage.GetPseudoRoot(), Usd.TraverseInstanceProxies()))
    shapes = [prim for prim in every if prim.IsA(UsdGeom.Mesh)] or [prim for prim in every if prim.IsA(UsdGeom.Points)]
    if not shapes:
        others = ", only the names of other files; flatten it first" if notes else ""
        raise InvalidMotion(f"{name}: there is no mesh in it{others}")
    _check_bones(every, shapes, name)
    moving = [prim for prim in shapes if UsdGeom.PointBased(prim).GetPointsAttr().GetNumTimeSamples() > 1]
    if moving and len(moving) < len(shapes):
        notes.append(f"{len(shapes) - len(moving)} of its meshes do not change their shape and are left out")
    chosen = moving or shapes
    codes = _codes(chosen, name) if moving else _codes_of_places(chosen)
    positions, mirrored = _positions(chosen, codes, name)
    triangles = _all_triangles(chosen, codes, mirrored, name, notes)
    axes, rate = units(stage, len(codes) > 1, name, notes)
    times = np.array([code.GetValue() / rate for code in codes]) if len(codes) > 1 else None
    if not np.isfinite(positions).all() or not (times is None or np.isfinite(times).all()):
        raise InvalidMotion(f"{name}: some of its positions are not finite numbers")
    texture, parts = labels(chosen, mirrored, codes[0], triangles)
    return Animation(
        positions, axes, times, triangles if len(triangles) else None, notes=tuple(notes), texture=texture, parts=parts
    )


def joint(path: str, name: str, wanted: str) -> dict[str, Any]:
    """Times, matrices and axes, as text, of a joint of a skeleton, as `joints` has them. Raises InvalidMotion."""
    stage, notes = _opened(path)
    axes, rate = units(stage, True, name, notes)
    times, matrices = of_stage(stage, rate, name, wanted)
    return {"times": times, "matrices": matrices, "axes": np.array([*map(str, axes)])}


def _opened(path: str) -> tuple[Any, list[str]]:
    """The stage of a file's own layer, and notes on what it left out."""
    from pxr import Sdf, Usd

    layer = Sdf.Layer.OpenAsAnonymous(path)
    notes = alone(layer)
    return Usd.Stage.Open(layer, Usd.Stage.LoadNone), notes


def alone(layer: Any) -> list[str]:
    """Remove from a layer all that names other files; returns the notes on that."""
    others = list(layer.GetCompositionAssetDependencies())
    for each in others:
        layer.UpdateCompositionAssetDependency(each, "")
    paths: list[Any] = []
    layer.Traverse(layer.pseudoRoot.path, paths.append)
    clips = 0
    for path in paths:
        spec = layer.GetObjectAtPath(path)
        for key in CUT:
            if spec is not None and spec.HasInfo(key):
                spec.ClearInfo(key)
                clips += 1
    return ["it refers to other files, which are not read"] if others or clips else []


def _check_bones(every: Sequence[Any], shapes: Sequence[Any], name: str) -> None:
    """Raise InvalidMotion where joints or blend shapes move a mesh over time: its points do not show that."""
    animations = [prim for prim in every if prim.GetTypeName() == "SkelAnimation"]
    moved = any(each.GetNumTimeSamples() > 1 for prim in animations for each in prim.GetAttributes())
    bound = [prim for prim in shapes if any(prim.HasProperty(key) for key in BOUND)]
    if moved and bound:
        raise InvalidMotion(
            f"{name}: a skeleton or blend shapes move {named(str(bound[0].GetPath()))}; bake the motion into its "
            "points, as Blender does without Shape Keys and Armatures among its export options"
        )


def _codes(shapes: Sequence[Any], name: str) -> list[Any]:
    """The time codes at which shapes have samples. Raises InvalidMotion where they differ."""
    from pxr import Usd, UsdGeom

    each = [UsdGeom.PointBased(prim).GetPointsAttr().GetTimeSamples() for prim in shapes]
    for prim, codes in zip(shapes, each, strict=True):
        if codes != each[0]:
            both = f"{named(str(shapes[0].GetPath()))} and {named(str(prim.GetPath()))}"
            raise InvalidMotion(f"{name}: {both} have samples at different times; export one of them alone")
    return [Usd.TimeCode(code) for code in each[0]]


def _codes_of_places(shapes: Sequence[Any]) -> list[Any]:
    """The time codes at which the transforms of shapes have samples; the earliest time where nothing moves."""
    from pxr import Usd, UsdGeom

    found: set[float] = set()
    for prim in shapes:
        while prim:
            if own := UsdGeom.Xformable(prim):
                found.update(own.GetTimeSamples())
            prim = prim.GetParent()
    return [Usd.TimeCode(code) for code in sorted(found)] or [Usd.TimeCode.EarliestTime()]


def _positions(shapes: Sequence[Any], codes: Sequence[Any], name: str) -> tuple[Array, list[bool]]:
    """Positions (frames, n, 3) of all shapes in the axes of the stage, and which shapes are mirrored there."""
    from pxr import UsdGeom

    frames: list[list[NDArray[Any]]] = []
    mirrored: list[bool] = []
    for code in codes:
        cache = UsdGeom.XformCache(code)
        points = [_points(prim, code, name) for prim in shapes]
        matrices = [np.array(cache.GetLocalToWorldTransform(prim)) for prim in shapes]
        counts, first = [len(each) for each in points], [len(each) for each in (frames or [points])[0]]
        if counts != first:
            other = next(prim for prim, a, b in zip(shapes, counts, first, strict=True) if a != b)
            place = f"{name}: {named(str(other.GetPath()))}"
            raise InvalidMotion(f"{place}: its number of points changes over time; it must stay the same")
        if not frames:
            needed = len(codes) * sum(counts) * 3 * 8 * 3
            check_room(needed, name)
            limit_memory(OPENING_BYTES + needed, only_if_limited=True)  # one array may stand for many samples
            mirrored = [bool(np.linalg.det(matrix[:3, :3]) < 0) for matrix in matrices]
        # row vectors: the translation is the last row
        frames.append([p @ m[:3, :3] + m[3, :3] for p, m in zip(points, matrices, strict=True)])
    return np.stack([np.concatenate(each) for each in frames]), mirrored


def _points(prim: Any, code: Any, name: str) -> Array:
    from pxr import UsdGeom

    value = UsdGeom.PointBased(prim).GetPointsAttr().Get(code)
    points = np.array(value if value is not None else [], np.float64)
    if points.ndim != 2 or points.shape[1] != 3:
        raise InvalidMotion(f"{name}: {named(str(prim.GetPath()))}: it has no points")
    return points


def _all_triangles(
    shapes: Sequence[Any], codes: Sequence[Any], mirrored: Sequence[bool], name: str, notes: list[str]
) -> Indices:
    """Triangles of all shapes, with the front that right-handed corners give them."""
    from pxr import UsdGeom

    faces: list[Indices] = [np.zeros((0, 3), np.int32)]
    start = 0
    for prim, mirror in zip(shapes, mirrored, strict=True):
        count = len(_points(prim, codes[0], name))
        if mesh := UsdGeom.Mesh(prim):
            left = mesh.GetOrientationAttr().Get() == UsdGeom.Tokens.leftHanded
            triangles = start + _triangles(mesh, codes, count, name)
            faces.append(triangles[:, ::-1] if left != mirror else triangles)
            if left:
                notes.append(f"the faces of {named(str(prim.GetPath()))} are left-handed and are turned round")
        start += count
    return np.concatenate(faces)


def _triangles(mesh: Any, codes: Sequence[Any], count: int, name: str) -> Indices:
    """Triangles (T, 3) of a mesh of `count` points; polygons become fans."""
    place = f"{name}: {named(str(mesh.GetPath()))}"
    attributes = mesh.GetFaceVertexCountsAttr(), mesh.GetFaceVertexIndicesAttr()
    sizes, corners = (_whole(each, codes[0]) for each in attributes)
    for attribute, first in zip(attributes, (sizes, corners), strict=True):
        for code in attribute.GetTimeSamples()[1:]:
            if not np.array_equal(_whole(attribute, code), first):
                raise InvalidMotion(f"{place}: its faces change over time; they must stay the same")
    if (sizes < 0).any() or sizes.sum() != len(corners):
        raise InvalidMotion(f"{place}: its faces need {sizes.sum()} corners and have {len(corners)}")
    if len(corners) and not 0 <= corners.min() <= corners.max() < count:
        raise InvalidMotion(f"{place}: a triangle names a vertex beyond the {count} of its mesh")
    return fans(sizes, corners)


def _whole(attribute: Any, code: Any) -> NDArray[np.int64]:
    value = attribute.Get(code)
    return np.zeros(0, np.int64) if value is None else np.array(value, np.int64)


def labels(
    shapes: Sequence[Any], mirrored: Sequence[bool], code: Any, triangles: Indices
) -> tuple[Array | None, Parts]:
    """Texture coordinates (T, 3, 2), NaN where unknown, and parts, of all shapes, whose triangles are these (T, 3)."""
    from pxr import UsdGeom

    textures: list[Array] = [np.zeros((0, 3, 2))]
    whole, subsets = list[tuple[str, NDArray[np.intp]]](), list[tuple[str, NDArray[np.intp]]]()
    begin = 0
    for prim, mirror in zip(shapes, mirrored, strict=True):
        mesh = UsdGeom.Mesh(prim)
        if not mesh:
            continue
        sizes, corners = _whole(mesh.GetFaceVertexCountsAttr(), code), _whole(mesh.GetFaceVertexIndicesAttr(), code)
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


def _texture(mesh: Any, sizes: NDArray[np.int64], corners: NDArray[np.int64], code: Any) -> Array:
    """Texture coordinates (T, 3, 2) of a mesh, NaN where it has none."""
    from pxr import UsdGeom

    count = int(np.maximum(sizes - 2, 0).sum())
    nothing = np.full((count, 3, 2), np.nan)
    every = [each for each in UsdGeom.PrimvarsAPI(mesh).GetPrimvarsWithValues() if str(each.GetTypeName()) in PAIRS]
    if not every:
        return nothing
    chosen = next((each for each in every if each.GetPrimvarName() == TEXTURE_NAME), every[0])
    values = np.array(chosen.ComputeFlattened(code) or [], np.float64)
    if values.ndim != 2 or values.shape[1] != 2:
        return nothing
    at_corners = chosen.GetInterpolation() == UsdGeom.Tokens.faceVarying
    owner = fans(sizes, np.arange(len(corners)) if at_corners else corners)
    needed = len(corners) if at_corners else int(corners.max(initial=-1)) + 1
    return values[owner] if len(values) >= needed else nothing


def units(stage: Any, moves: bool, name: str, notes: list[str]) -> tuple[Axes, float]:
    """Axes and time codes per second. Raises InvalidMotion where they make no sense."""
    from pxr import UsdGeom

    up, scale = str(UsdGeom.GetStageUpAxis(stage)), UsdGeom.GetStageMetersPerUnit(stage)
    rate = stage.GetTimeCodesPerSecond()
    if up.lower() not in UPS or not 0 < scale < np.inf or not 0 < rate < np.inf:
        given = f"upAxis {shown(up)}, metersPerUnit {scale:g}, timeCodesPerSecond {rate:g}"
        raise InvalidMotion(f"{name}: {given} cannot be; up is Y or Z, and the others are above 0")
    if not UsdGeom.StageHasAuthoredMetersPerUnit(stage):
        notes.append(f"it does not name its unit, so it is {scale:g} m, as USD says")
    if not stage.HasAuthoredMetadata("upAxis"):
        notes.append(f"it does not say which axis is up, so it is {up.lower()}, as USD says")
    if moves and not any(stage.HasAuthoredMetadata(key) for key in ("timeCodesPerSecond", "framesPerSecond")):
        notes.append(f"it does not name its rate, so it is {rate:g} frames per second, as USD says")
    return Axes(up.lower(), "right", float(scale)), float(rate)


def limit_memory(room: int, only_if_limited: bool = False) -> None:
    """Let this process take no more than `room` bytes more: a damaged file may ask for all memory there is, and filling
    that takes half a minute.
    """
    with suppress(ImportError, OSError, ValueError, IndexError):
        import resource  # not on Windows

        soft, hard = resource.getrlimit(resource.RLIMIT_AS)
        if only_if_limited and soft == resource.RLIM_INFINITY:
            return
        pages = int(Path("/proc/self/statm").read_text().split()[0])
        most = pages * os.sysconf("SC_PAGE_SIZE") + room
        resource.setrlimit(resource.RLIMIT_AS, (most if hard == resource.RLIM_INFINITY else min(most, hard), hard))


def main(path: str, arrays: str, name: str, *wanted: str) -> int:
    """Read a file, or the joint `wanted` of it, into an `.npz` of arrays; returns 3, with the reason on standard
    output, when that fails.
    """
    from pxr import Usd, UsdGeom, UsdSkel  # noqa: F401  they take some hundred MB of addresses before they read anything

    limit_memory(OPENING_BYTES + OPENING_RATIO * os.path.getsize(path))
    try:
        made = joint(path, name, *wanted) if wanted else _arrays(parsed(path, name))
    except InvalidMotion as error:
        print(json.dumps(str(error)))
        return 3
    np.savez(arrays, **made)
    return 0


def _arrays(found: Animation) -> dict[str, Any]:
    """What an animation has, for `usd.read`."""
    made = {name: getattr(found, name) for name in ("positions", "times", "triangles", "texture")}
    present: dict[str, Any] = {key: array for key, array in made.items() if array is not None}
    present |= {f"part {name}": own for name, own in found.parts}
    return {"axes_and_notes": json.dumps([*found.axes, *found.notes]), **present}


if __name__ == "__main__":
    sys.exit(main(*sys.argv[1:]))
