"""What is in a USD file, read by a process of its own: `python -m clothfit.formats.usd_reader FILE OUT NAME [WHAT]`.

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
from collections.abc import Callable, Iterator, Sequence
from contextlib import suppress
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from clothfit.base.arrays import Array
from clothfit.base.errors import InvalidMotion
from clothfit.base.messages import named, spelt
from clothfit.formats import animation
from clothfit.formats.axes import UPS, Axes
from clothfit.formats.files import check_room
from clothfit.formats.joints import absent, baked, sampled

CUT = ("clips", "clipSets")
"""Fields of a prim, beside its references, that name other files: those that hold values of attributes."""

BOUND = ("skel:blendShapes", "skel:skeleton", "primvars:skel:jointIndices")
"""What binds a mesh to a skeleton."""

TEXTURE_NAME = "st"
"""The usual name of the primvar with texture coordinates; else the first with pairs of numbers counts."""

PAIRS = ("texCoord2f[]", "texCoord2d[]", "texCoord2h[]", "float2[]", "double2[]")
"""The types of primvars whose values are pairs of numbers, as texture coordinates are."""

STALE = ("normals", "velocities", "accelerations", "primvars:normals")
"""What belongs to the points that a copy has no more."""

SHORTEST_TIME, READ_SPEED = 60.0, 1e6
"""Reading may take this many seconds, and one more for so many bytes; it needs a hundredth of that."""

OPENING_BYTES, OPENING_RATIO = 1 << 29, 100
"""Bytes that opening a file may take: a fixed number, and some for each byte of the file, whose arrays are packed."""


def parsed(path: str, name: str, wanted: str = "") -> animation.Animation:
    """The meshes of a file that are `wanted`, or move, or all; its points where it has none. Raises InvalidMotion, and
    what the library raises.
    """
    stage, notes = _opened(path)
    chosen, codes, rate, axes = _chosen(stage, wanted, name, notes)
    positions, mirrored = _positions(chosen, codes, name)
    faces = _faces(chosen, codes, mirrored, name, notes)
    seconds = np.array([code.GetValue() / rate for code in codes]) if len(codes) > 1 else None
    animation.check_finite(name, positions, seconds)
    pins = _pins(chosen, codes[0]).found(notes)
    return animation.Animation(positions, axes, seconds, notes=tuple(notes), pins=pins, **faces.found())


def _chosen(stage: Any, wanted: str, name: str, notes: list[str]) -> tuple[Sequence[Any], list[Any], float, Axes]:
    """The shapes of a stage that are `wanted`, or move, or all; the time codes of their frames, codes per second, and
    axes. Raises InvalidMotion.
    """
    from pxr import Usd, UsdGeom

    every, shapes = _shapes(stage, notes, name)
    samples = {prim: UsdGeom.PointBased(prim).GetPointsAttr().GetTimeSamples() for prim in shapes}
    axes, rate = units(stage, any(len(own) > 1 for own in samples.values()), name, notes)
    if wanted:
        chosen: Sequence[Any] = animation.chosen(shapes, [str(prim.GetPath()) for prim in shapes], wanted, name)
        moves = any(len(samples[prim]) > 1 for prim in chosen)
    else:
        chosen, moves = animation.moving(shapes, lambda prim: len(samples[prim]) > 1, notes)
    _check_bones(every, chosen, name)
    if moves:
        sampled_ones = [prim for prim in chosen if len(samples[prim]) > 1]
        times = animation.common_times(name, [(str(prim.GetPath()), samples[prim]) for prim in sampled_ones])
    else:
        times = sorted({time for prim in chosen for time in _transform_times(prim)})
        if wanted and len(times) > 1:  # between the keys it turns
            times = (baked(np.array(sorted({*times, *(t for own in samples.values() for t in own)})) / rate) * rate)
    return chosen, [Usd.TimeCode(float(time)) for time in times] or [Usd.TimeCode.EarliestTime()], rate, axes


def _shapes(stage: Any, notes: Sequence[str], name: str) -> tuple[list[Any], list[Any]]:
    """All prims of a stage, and its meshes, or its points where it has none. Raises InvalidMotion."""
    from pxr import Usd, UsdGeom

    every = list(Usd.PrimRange(stage.GetPseudoRoot(), Usd.TraverseInstanceProxies()))
    shapes = [prim for prim in every if prim.IsA(UsdGeom.Mesh)] or [prim for prim in every if prim.IsA(UsdGeom.Points)]
    if not shapes:
        others = ", only the names of other files; flatten it first" if notes else ""
        raise InvalidMotion(f"{name}: there is no mesh in it{others}")
    return every, shapes


def listed(path: str, name: str) -> dict[str, Any]:
    """The paths of all meshes of a file. Raises InvalidMotion."""
    stage, notes = _opened(path)
    return {"paths": np.array([str(prim.GetPath()) for prim in _shapes(stage, notes, name)[1]])}


def joint(path: str, name: str, wanted: str) -> dict[str, Any]:
    """Times (K,), s, from the start of a file, matrices (K, 4, 4) and axes, as text, of a joint of a skeleton. Its name
    is its path below the skeleton, such as hips/leg, or the last part of it. Raises InvalidMotion.
    """
    from pxr import Usd, UsdGeom, UsdSkel

    stage, notes = _opened(path)
    axes, rate = units(stage, True, name, notes)
    cache, names, found = UsdSkel.Cache(), list[str](), list[tuple[Any, int]]()
    for prim in stage.Traverse():
        if prim.IsA(UsdSkel.Skeleton):
            query = cache.GetSkelQuery(UsdSkel.Skeleton(prim))
            own = [str(each) for each in query.GetJointOrder()]
            names += own
            found += [(query, k) for k, each in enumerate(own) if wanted in (each, each.rpartition("/")[2])]
    if len(found) != 1:
        raise InvalidMotion(absent(name, wanted, len(found), list(names)))
    query, index = found[0]
    motion = query.GetAnimQuery()
    codes = np.array(motion.GetJointTransformTimeSamples() if motion else [], float)
    begin = stage.GetStartTimeCode() if stage.HasAuthoredTimeCodeRange() or not len(codes) else codes.min()
    times = sampled(np.unique(codes - begin) / rate) if len(codes) else np.zeros(1)
    matrices = np.empty((len(times), 4, 4))
    for k, time in enumerate(times):
        place = UsdGeom.XformCache(Usd.TimeCode(float(begin + time * rate)))
        matrices[k] = np.array(query.ComputeJointWorldTransforms(place)[index]).T  # USD multiplies rows
    return {"times": times, "matrices": matrices, "axes": np.array([*map(str, axes)])}


def replaced(path: str, name: str, wanted: str, points: str, made: str) -> dict[str, Any]:
    """Write a copy of a file to `made`, in which the meshes that are `wanted`, or move, have the points of the array
    (frames, n, 3) in the file `points`, at their own time codes. Raises InvalidMotion.
    """
    from pxr import Sdf, UsdGeom, Vt

    stage, notes = _opened(path)
    chosen, codes = _chosen(stage, wanted, name, notes)[:2]
    frames, start = np.load(points, allow_pickle=False), 0
    layer = Sdf.Layer.FindOrOpen(path)
    for prim in chosen:
        count = len(_points(prim, codes[0], name))
        own = layer.GetPrimAtPath(prim.GetPath())
        for each in STALE:
            if own is not None and each in own.properties:
                del own.properties[each]
        place = prim.GetPath().AppendProperty("points")
        for k, code in enumerate(codes):
            matrix = np.linalg.inv(np.array(UsdGeom.XformCache(code).GetLocalToWorldTransform(prim)))
            local = frames[k, start : start + count] @ matrix[:3, :3] + matrix[3, :3]
            value = Vt.Vec3fArray.FromNumpy(np.ascontiguousarray(local, np.float32))
            layer.SetTimeSample(place, code.GetValue(), value)
            corners = np.ascontiguousarray([local.min(axis=0), local.max(axis=0)], np.float32)
            extent = prim.GetPath().AppendProperty("extent")
            if layer.GetAttributeAtPath(extent):
                layer.SetTimeSample(extent, code.GetValue(), Vt.Vec3fArray.FromNumpy(corners))
        start += count
    layer.Export(made)
    return {"codes": np.array([code.GetValue() for code in codes])}


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


def _transform_times(prim: Any) -> Iterator[float]:
    """The time codes at which the transforms of a shape and of what is above it have samples."""
    from pxr import UsdGeom

    while prim:
        if own := UsdGeom.Xformable(prim):
            yield from own.GetTimeSamples()
        prim = prim.GetParent()


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


def _faces(
    shapes: Sequence[Any], codes: Sequence[Any], mirrored: Sequence[bool], name: str, notes: list[str]
) -> animation.Faces:
    """The triangles of all shapes, with the front that right-handed corners give them, their texture and parts."""
    from pxr import UsdGeom

    faces, start = animation.Faces(), 0
    for prim, mirror in zip(shapes, mirrored, strict=True):
        count, place = len(_points(prim, codes[0], name)), f"{name}: {named(str(prim.GetPath()))}"
        if mesh := UsdGeom.Mesh(prim):
            attributes = mesh.GetFaceVertexCountsAttr(), mesh.GetFaceVertexIndicesAttr()
            sizes, corners = (_constant(each, codes[0], place) for each in attributes)
            animation.check_polygons(sizes, corners, count, place)
            left = mesh.GetOrientationAttr().Get() == UsdGeom.Tokens.leftHanded
            if left:
                notes.append(f"the faces of {named(str(prim.GetPath()))} are left-handed and are turned round")
            face = np.repeat(np.arange(len(sizes)), np.maximum(sizes - 2, 0))  # of each triangle
            faces.name(prim.GetName(), faces.count + np.arange(len(face)))
            for subset in UsdGeom.Subset.GetAllGeomSubsets(mesh):
                if subset.GetElementTypeAttr().Get() == UsdGeom.Tokens.face:
                    own = np.isin(face, np.array(subset.GetIndicesAttr().Get(codes[0]) or [], np.int64))
                    faces.name(subset.GetPrim().GetName(), faces.count + np.flatnonzero(own), rank=1)
            triangles = start + animation.fans(sizes, corners)
            faces.add(triangles, _texture(mesh, sizes, corners, codes[0]), turned=left != mirror)
        start += count
    return faces


def _pins(shapes: Sequence[Any], code: Any) -> animation.Pins:
    """The vertices that a primvar of the meshes marks as held."""
    from pxr import UsdGeom

    found = animation.Pins()
    for prim in shapes:
        count, weights = len(UsdGeom.PointBased(prim).GetPointsAttr().Get(code) or []), list[tuple[str, Array]]()
        for each in UsdGeom.PrimvarsAPI(prim).GetPrimvarsWithValues():
            if not animation.is_pin(str(each.GetPrimvarName())):
                continue
            with suppress(ValueError, TypeError):  # of no numbers
                values = np.array(each.ComputeFlattened(code), np.float64)
                if each.GetInterpolation() == UsdGeom.Tokens.faceVarying and UsdGeom.Mesh(prim):
                    corners = np.array(UsdGeom.Mesh(prim).GetFaceVertexIndicesAttr().Get(code), np.int64)
                    largest = np.zeros(count)
                    np.maximum.at(largest, corners, values)
                    values = largest
                weights.append((str(each.GetPrimvarName()), values))
        found.add(count, weights)
    return found


def _constant(attribute: Any, code: Any, place: str) -> NDArray[np.int64]:
    """Whole numbers that must not change. Raises InvalidMotion where they do."""
    values = [attribute.Get(each) for each in (code, *attribute.GetTimeSamples()[1:])]
    first, *others = (np.array([] if value is None else value, np.int64) for value in values)
    if not all(np.array_equal(each, first) for each in others):
        raise InvalidMotion(f"{place}: its faces change over time; they must stay the same")
    return first


def _texture(mesh: Any, sizes: NDArray[np.int64], corners: NDArray[np.int64], code: Any) -> Array:
    """Texture coordinates (T, 3, 2) of a mesh, NaN where it has none."""
    from pxr import UsdGeom

    nothing = np.full((int(np.maximum(sizes - 2, 0).sum()), 3, 2), np.nan)
    every = [each for each in UsdGeom.PrimvarsAPI(mesh).GetPrimvarsWithValues() if str(each.GetTypeName()) in PAIRS]
    if not every:
        return nothing
    chosen = next((each for each in every if each.GetPrimvarName() == TEXTURE_NAME), every[0])
    values = np.array(chosen.ComputeFlattened(code) or [], np.float64)
    if values.ndim != 2 or values.shape[1] != 2:
        return nothing
    at_corners = chosen.GetInterpolation() == UsdGeom.Tokens.faceVarying
    owner = animation.fans(sizes, np.arange(len(corners)) if at_corners else corners)
    needed = len(corners) if at_corners else int(corners.max(initial=-1)) + 1
    return values[owner] if len(values) >= needed else nothing


def units(stage: Any, moves: bool, name: str, notes: list[str]) -> tuple[Axes, float]:
    """Axes and time codes per second. Raises InvalidMotion where they make no sense."""
    from pxr import UsdGeom

    up, scale = str(UsdGeom.GetStageUpAxis(stage)), UsdGeom.GetStageMetersPerUnit(stage)
    rate = stage.GetTimeCodesPerSecond()
    if up.lower() not in UPS or not 0 < scale < np.inf or not 0 < rate < np.inf:
        given = f"upAxis {spelt(up)}, metersPerUnit {scale:g}, timeCodesPerSecond {rate:g}"
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


def limit_time(seconds: float) -> None:
    """Let this process compute no longer: a damaged file may keep the library busy. Waiting for others is no computing,
    so a busy machine reads every file.
    """
    with suppress(ImportError, OSError, ValueError):
        import resource  # not on Windows

        resource.setrlimit(resource.RLIMIT_CPU, (int(seconds), resource.getrlimit(resource.RLIMIT_CPU)[1]))


def main(path: str, arrays: str, name: str, *wanted: str) -> int:
    """Read a file, or what is `wanted` of it, such as joint and its name, into an `.npz` of arrays; returns 3, with the
    reason on standard output, when that fails.
    """
    from pxr import Usd, UsdGeom, UsdSkel  # noqa: F401  they take some hundred MB of addresses before they read anything

    limit_memory(OPENING_BYTES + OPENING_RATIO * os.path.getsize(path))
    limit_time(SHORTEST_TIME + os.path.getsize(path) / READ_SPEED)
    try:
        what, *names = wanted or ("mesh",)
        made = READ[what](path, name, *names)
    except InvalidMotion as error:
        print(json.dumps(str(error)))
        return 3
    np.savez(arrays, **made)
    return 0


def _arrays(path: str, name: str, wanted: str = "") -> dict[str, Any]:
    """What an animation has, for `usd.read`."""
    found = parsed(path, name, wanted)
    made = {name: getattr(found, name) for name in ("positions", "times", "triangles", "texture", "pins")}
    present: dict[str, Any] = {key: array for key, array in made.items() if array is not None}
    present |= {f"part {name}": own for name, own in found.parts}
    return {"axes_and_notes": json.dumps([*found.axes, *found.notes]), **present}


READ: dict[str, Callable[..., dict[str, Any]]] = {"mesh": _arrays, "joint": joint, "list": listed, "replace": replaced}
"""What can be read of a file."""


if __name__ == "__main__":
    sys.exit(main(*sys.argv[1:]))
