"""Motions in Alembic files (.abc): meshes whose points have samples over time, below transforms.

Alembic is right-handed and usually y up, as Blender and Maya write it; it names no unit. No Python library that reads
it is maintained on PyPI, so this module reads its container itself (`ogawa`): meshes (PolyMesh, SubD) with points,
faces, texture coordinates, and the transforms above them. Of several meshes those whose points move are the cloth;
where none does, the times are those of the transforms. Faces go clockwise there, so their corners are reversed. Files
in the older HDF5 container are refused.
"""

from __future__ import annotations

import os
from collections.abc import Iterator, Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from clothfit.base.arrays import Array, Indices
from clothfit.base.errors import InvalidMotion
from clothfit.base.messages import named
from clothfit.formats.animation import Animation, fans, increasing, known, parts_of
from clothfit.formats.axes import RIGHT
from clothfit.formats.files import check_room, content, name_of
from clothfit.formats.ogawa import Object, Ogawa, Property

MESH_SCHEMAS = ("AbcGeom_PolyMesh_v1", "AbcGeom_SubD_v1")
XFORM_SCHEMA = "AbcGeom_Xform_v3"

LEVELS, MOST_OBJECTS = 100, 100_000
"""The most levels of objects, and objects in all."""

CHANNELS = {0: 3, 1: 3, 2: 4, 3: 16, 4: 1, 5: 1, 6: 1}
"""Numbers of each operation of a transform: scale, translate, rotate about an axis, matrix, rotate about x, y, z."""


class Shape(NamedTuple):
    """A mesh, and the transforms above it."""

    name: str
    properties: dict[str, Property]
    above: tuple[dict[str, Property], ...]  # of the transforms, from the top

    @property
    def points(self) -> Property:
        """The positions of its vertices."""
        return self.properties["P"]


def read(path: str | os.PathLike[str]) -> Animation:
    """The meshes of a file; one frame where nothing moves. Raises InvalidMotion."""
    name, data = name_of(path), content(path)
    if data.startswith(b"\x89HDF"):
        advice = f"convert it with: abcconvert -toOgawa {name} new.abc"
        raise InvalidMotion(f"{name}: it is in Alembic's older container, HDF5; {advice}")
    if not data.startswith(b"Ogawa") or len(data) < 16:
        raise InvalidMotion(f"{name}: it is not an Alembic file, which begins with Ogawa")
    try:
        with np.errstate(all="ignore"):  # what overflows is reported below
            return _animation(Ogawa(data), name)
    except InvalidMotion:
        raise
    except ValueError as error:
        raise InvalidMotion(f"{name}: cannot be read as Alembic: {error}") from None


def _animation(file: Ogawa, name: str) -> Animation:
    shapes = list(_shapes(file))
    if not shapes:
        raise InvalidMotion(f"{name}: there is no mesh in it")
    notes = []
    moving = [each for each in shapes if each.points.moves]
    if moving and len(moving) < len(shapes):
        notes.append(f"{len(shapes) - len(moving)} of its meshes do not change their shape and are left out")
    chosen = moving or shapes
    times = _times(file, chosen, bool(moving), name)
    positions, mirrored = _positions(file, chosen, times, name)
    faces = _faces(file, chosen, mirrored, name)
    if not np.isfinite(positions).all():
        raise InvalidMotion(f"{name}: some of its positions are not finite numbers")
    triangles = np.concatenate([each for each, _ in faces])
    texture = np.concatenate([each for _, each in faces])
    ends = np.cumsum([0, *(len(each) for each, _ in faces)])
    own = ((each.name, np.arange(a, b)) for each, a, b in zip(chosen, ends, ends[1:], strict=False))
    return Animation(
        positions, RIGHT, times if len(times) > 1 else None, triangles if len(triangles) else None, notes=tuple(notes),
        texture=known(texture), parts=parts_of(own, triangles),
    )  # fmt: skip


def _shapes(file: Ogawa) -> Iterator[Shape]:
    """The meshes of a file, in its order."""
    waiting: list[tuple[Object, tuple[dict[str, Property], ...]]] = [(file.top, ())]
    met = 0
    while waiting:
        own, above = waiting.pop()
        met += 1
        if len(above) > LEVELS or met > MOST_OBJECTS:
            raise ValueError(f"its objects are not a tree of at most {LEVELS} levels; it is damaged, export it again")
        groups = file.children(own.place)
        properties = file.properties(groups[0]) if groups else {}
        if own.schema in MESH_SCHEMAS and ".geom" in properties:
            mesh = file.properties(properties[".geom"].place)
            if "P" in mesh and mesh["P"].samples:
                yield Shape(own.name, mesh, above)
        inner = above
        if own.schema == XFORM_SCHEMA and ".xform" in properties:
            inner = (*above, file.properties(properties[".xform"].place))
        elif own is not file.top:
            inner = (*above, {})
        waiting += [(each, inner) for each in reversed(list(file.objects(own)))]


def _times(file: Ogawa, shapes: Sequence[Shape], moving: bool, name: str) -> Array:
    """The times (frames,), s. Raises InvalidMotion where those of shapes differ."""
    if moving:
        each = [file.times(shape.points) for shape in shapes]
        for shape, own in zip(shapes, each, strict=True):
            if not np.array_equal(own, each[0]):
                both = f"{named(shapes[0].name)} and {named(shape.name)}"
                raise InvalidMotion(f"{name}: {both} have samples at different times; export one of them alone")
        times = each[0]
    else:
        values = (place[".vals"] for shape in shapes for place in shape.above if ".vals" in place)
        every = [file.times(own) for own in values if own.moves]
        times = np.unique(np.concatenate(every)) if every else np.zeros(1)
    if not increasing(times):
        raise InvalidMotion(f"{name}: times: must be finite and increasing")
    return times


def _positions(file: Ogawa, shapes: Sequence[Shape], times: Array, name: str) -> tuple[Array, list[bool]]:
    """Positions (frames, n, 3) of all shapes, and which of them are mirrored."""
    counts = [len(file.sample(shape.points, 0)) for shape in shapes]
    check_room(len(times) * sum(counts) * 3 * 8 * 2, name)
    found = np.empty((len(times), sum(counts), 3))
    mirrored, start = [], 0
    for shape, count in zip(shapes, counts, strict=True):
        matrices = _matrices(file, shape, times)
        mirrored.append(bool(np.linalg.det(matrices[0, :3, :3]) < 0))
        for frame, matrix in enumerate(matrices):
            points = file.sample(shape.points, frame)
            if points.shape != (count, 3):
                place = f"{name}: {named(shape.name)}"
                raise InvalidMotion(f"{place}: its number of points changes over time; it must stay the same")
            found[frame, start : start + count] = points @ matrix[:3, :3] + matrix[3, :3]
        start += count
    return found, mirrored


def _matrices(file: Ogawa, shape: Shape, times: Array) -> Array:
    """Matrices (frames, 4, 4) for row vectors, from the axes of a shape to those of the file."""
    product = np.broadcast_to(np.eye(4), (len(times), 4, 4))
    for place in shape.above:
        if ".inherits" in place and place[".inherits"].samples and not file.sample(place[".inherits"], 0).any():
            product = np.broadcast_to(np.eye(4), product.shape)
        if ".ops" in place and ".vals" in place and place[".ops"].samples:
            product = _local(file, place[".ops"], place[".vals"], times) @ product
    return product


def _local(file: Ogawa, ops: Property, values: Property, times: Array) -> Array:
    """Matrices (frames, 4, 4) of one transform, with a straight line between its samples."""
    codes = file.sample(ops, 0).reshape(-1).astype(int) >> 4
    own = file.times(values)
    count = len(own) if values.moves else 1
    made = np.array([_product(codes, file.sample(values, i).reshape(-1)) for i in range(count)])
    if count == 1:
        return np.broadcast_to(made[0], (len(times), 4, 4))
    after = np.clip(np.searchsorted(own, times), 1, count - 1)
    u = np.clip((times - own[after - 1]) / (own[after] - own[after - 1]), 0.0, 1.0)[:, None, None]
    return np.asarray((1 - u) * made[after - 1] + u * made[after])


def _product(codes: NDArray[np.int_], values: Array) -> Array:
    """The matrix of operations, of which the first is applied last."""
    product, at = np.eye(4), 0
    for code in codes:
        if code not in CHANNELS or at + CHANNELS[code] > len(values):
            raise ValueError("a transform in it is not understood; it is damaged, export it again")
        product = _operation(code, values[at : at + CHANNELS[code]]) @ product
        at += CHANNELS[code]
    return product


def _operation(code: int, values: Array) -> Array:
    """The matrix of an operation, for row vectors."""
    matrix = np.eye(4)
    if code == 0:
        matrix[[0, 1, 2], [0, 1, 2]] = values
    elif code == 1:
        matrix[3, :3] = values
    elif code == 3:
        matrix = values.reshape(4, 4)
    else:
        axis, degrees = (values[:3], values[3]) if code == 2 else (np.eye(3)[code - 4], values[0])
        matrix[:3, :3] = _turn(axis, np.radians(degrees)).T
    return matrix


def _turn(axis: Array, angle: float) -> Array:
    """The rotation by an angle about an axis of any length (Rodrigues' formula)."""
    length = np.linalg.norm(axis)
    x, y, z = axis / length if length > 0 else np.zeros(3)
    cross = np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]])
    return np.asarray(np.eye(3) + np.sin(angle) * cross + (1 - np.cos(angle)) * cross @ cross)


def _faces(file: Ogawa, shapes: Sequence[Shape], mirrored: Sequence[bool], name: str) -> list[tuple[Indices, Array]]:
    """Triangles (T, 3) of each shape, numbered through, and texture coordinates (T, 3, 2) of their corners."""
    made, start = [], 0
    for shape, mirror in zip(shapes, mirrored, strict=True):
        count = len(file.sample(shape.points, 0))
        lengths, corners = (_constant(file, shape, key, name) for key in (".faceCounts", ".faceIndices"))
        if (lengths < 0).any() or lengths.sum() != len(corners):
            raise ValueError(f"its faces need {lengths.sum()} corners and have {len(corners)}")
        if len(corners) and not 0 <= corners.min() <= corners.max() < count:
            raise ValueError(f"a face names a vertex beyond the {count} of its mesh")
        triangles = start + fans(lengths, corners)
        texture = _texture(file, shape, len(corners))[fans(lengths, np.arange(len(corners)))]
        made.append((triangles, texture) if mirror else (triangles[:, ::-1], texture[:, ::-1]))
        start += count
    return made


def _constant(file: Ogawa, shape: Shape, key: str, name: str) -> NDArray[np.int64]:
    """Whole numbers that must not change. Raises InvalidMotion where they do."""
    own = shape.properties.get(key)
    if own is None or not own.samples:
        return np.zeros(0, np.int64)
    first = file.sample(own, 0).reshape(-1)
    changing = range(own.first, own.last + 1) if own.moves else ()
    if any(not np.array_equal(file.sample(own, index).reshape(-1), first) for index in changing):
        place = f"{name}: {named(shape.name)}"
        raise InvalidMotion(f"{place}: its faces change over time; export it without triangulating each frame")
    return first.astype(np.int64)


def _texture(file: Ogawa, shape: Shape, corners: int) -> Array:
    """Texture coordinates (corners, 2), NaN where there are none for each corner."""
    nothing = np.full((corners, 2), np.nan)
    own = shape.properties.get("uv")
    if own is None:
        return nothing
    try:
        parts = file.properties(own.place) if not own.width else {".vals": own}
        values = file.sample(parts[".vals"], 0)
        if ".indices" in parts:
            values = values[file.sample(parts[".indices"], 0).reshape(-1).astype(np.int64)]
    except (ValueError, KeyError, IndexError):
        return nothing
    return values if values.shape == nothing.shape else nothing
