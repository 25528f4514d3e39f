"""The contents of a glTF scene: the nodes with meshes, the tracks of its animation, and the meshes at some times.

The nodes form a tree. The channels of an animation say which track drives which part of which node: values over time
between keys, by steps, straight lines, or cubic splines with given tangents (glTF 2.0 specification, appendix C).
Rotations are unit quaternions (x, y, z, w), on great arcs between their keys.

Meshes are triangles whose morph targets are added by their weights, on nodes that may move. Vertices are in the order
of the nodes, their meshes and primitives; primitives that share vertices give them once. A node that mirrors its mesh
reverses the corners of the triangles, so that their front stays outside.
"""

from __future__ import annotations

from collections.abc import Iterator
from itertools import pairwise
from typing import Any, NamedTuple, TypeAlias

import numpy as np
from numpy.typing import NDArray

from clothfit.base.arrays import Array, Indices
from clothfit.base.errors import InvalidMotion
from clothfit.formats.animation import Parts, increasing, known, parts_of
from clothfit.formats.files import check_room
from clothfit.formats.gltf import Document

ANIMATED_TYPES = {"translation": "VEC3", "rotation": "VEC4", "scale": "VEC3", "weights": "SCALAR"}
INTERPOLATIONS = ("LINEAR", "STEP", "CUBICSPLINE")

LEVELS = 100
"""The most levels of nodes."""

NEARLY_PARALLEL = 0.9995
"""Two quaternions whose angle has a larger cosine are joined by a straight line, as the sine is near 0."""


class Track(NamedTuple):
    """The keys of an animated quantity."""

    times: Array  # (keys,), s, increasing
    values: Array  # (keys, width); of splines (keys, 3, width): tangent before, value, tangent after
    kind: str  # STEP, LINEAR or CUBICSPLINE

    def at(self, times: Array, rotation: bool = False) -> Array:
        """Values (len(times), width); constant before the first key and after the last."""
        last = len(self.times) - 1
        index = np.clip(np.searchsorted(self.times, times, side="right") - 1, 0, last)
        after = np.minimum(index + 1, last)
        span = self.times[after] - self.times[index]
        u = np.clip((times - self.times[index]) / np.where(span > 0, span, 1.0), 0.0, 1.0)[:, None]
        if self.kind == "CUBICSPLINE":
            return self._spline(index, after, span[:, None], u)
        if self.kind == "STEP":
            return self.values[index]
        a, b = self.values[index], self.values[after]
        return _arc(a, b, u) if rotation else a + u * (b - a)

    def _spline(self, index: NDArray[Any], after: NDArray[Any], span: Array, u: Array) -> Array:
        """The cubic with the values and the tangents at both ends."""
        a, out = self.values[index, 1], span * self.values[index, 2]
        b, into = self.values[after, 1], span * self.values[after, 0]
        rise, bend = u * u * (3 - 2 * u), u * (u - 1)
        return np.asarray((1 - rise) * a + rise * b + bend * (u - 1) * out + bend * u * into)


Tracks: TypeAlias = dict[tuple[int, str], Track]
"""By node and what of it is animated, one of WIDTHS."""


class Placed(NamedTuple):
    """A node with a mesh."""

    node: int
    above: tuple[int, ...]  # its ancestors, the nearest last


def placed(doc: Document) -> Iterator[Placed]:
    """The nodes of the scene that have meshes, from the top."""
    waiting: list[tuple[Any, tuple[int, ...]]] = [(each, ()) for each in reversed(_tops(doc))]
    met: set[int] = set()
    found = False
    while waiting:
        index, above = waiting.pop()
        node = doc.item("nodes", index)
        if index in met or len(above) > LEVELS:
            raise InvalidMotion(f"{doc.name}: its nodes are not a tree of at most {LEVELS} levels")
        met.add(index)
        waiting += [(each, (*above, index)) for each in reversed(doc.items(node, "children"))]
        if "mesh" in node:
            found = True
            yield Placed(index, above)
    if not found:
        raise InvalidMotion(f"{doc.name}: there is no mesh in it")


def _tops(doc: Document) -> list[Any]:
    """The root nodes of the scene; without a scene, of all nodes."""
    if doc.items(doc.root, "scenes"):
        return doc.items(doc.item("scenes", doc.root.get("scene", 0)), "nodes")
    every = range(len(doc.items(doc.root, "nodes")))
    below = {each for index in every for each in doc.items(doc.item("nodes", index), "children") if type(each) is int}
    return [index for index in every if index not in below]


def animated(doc: Document, nodes: list[Placed]) -> tuple[Tracks, tuple[str, ...]]:
    """The tracks of the first animation that changes shapes, else of the first, with those of all others that move none
    of the same: programs such as Blender write an animation for each object. And notes on it.
    """
    count = len(doc.items(doc.root, "animations"))
    skinned = any("skin" in doc.item("nodes", node.node) for node in nodes)
    if not count:
        return {}, ("its skeleton is left out, which does not move",) if skinned else ()
    if skinned:
        raise InvalidMotion(f"{doc.name}: a skeleton moves its mesh; bake the motion into shape keys or a point cache")
    shapes = {node.node for node in nodes}
    each = [tracks_of(doc, index) for index in range(count)]
    changing = [i for i in range(count) if any(n in shapes and what == "weights" for n, what in each[i])]
    chosen = (changing or [0])[0]
    tracks, taken = dict(each[chosen]), [chosen]
    for other in range(count):
        if each[other] and not tracks.keys() & each[other].keys():
            tracks |= each[other]
            taken.append(other)
    if len(taken) == count:
        return tracks, ()
    numbers = ", ".join(str(i + 1) for i in sorted(taken))
    return tracks, (f"of its {count} animations number {numbers} is read",)


def tracks_of(doc: Document, index: int) -> Tracks:
    """The tracks of an animation."""
    animation = doc.item("animations", index)
    tracks: Tracks = {}
    for channel in doc.items(animation, "channels"):
        place = f"animations[{index}].channels"
        target = doc.typed(doc.typed(channel, dict, "an object", place).get("target"), dict, "an object", place)
        node, what = target.get("node"), target.get("path")
        if node is None or not isinstance(what, str) or what not in ANIMATED_TYPES:  # extensions animate other things
            continue
        doc.item("nodes", node)
        sampler = doc.member(animation, "samplers", channel.get("sampler"), f"animations[{index}].samplers")
        tracks[node, what] = _track(doc, sampler, what, f"animations[{index}].samplers")
    return tracks


def _track(doc: Document, sampler: dict[str, Any], what: str, place: str) -> Track:
    times = doc.accessor(sampler.get("input"), "SCALAR")[:, 0]
    if not (len(times) and increasing(times)):
        raise InvalidMotion(f"{doc.name}: {place}: times: must be finite and increasing")
    values = doc.accessor(sampler.get("output"), ANIMATED_TYPES[what])
    kind = sampler.get("interpolation", "LINEAR")
    doc.insist(kind in INTERPOLATIONS, kind, "a kind of interpolation that glTF has", place)
    items = len(times) * (3 if kind == "CUBICSPLINE" else 1)
    if not len(values) or len(values) % items or (what != "weights" and len(values) != items):
        raise InvalidMotion(f"{doc.name}: {len(values)} values of an animation do not match {len(times)} times")
    return Track(times, values.reshape((len(times), 3, -1) if kind == "CUBICSPLINE" else (len(times), -1)), kind)


def _arc(a: Array, b: Array, u: Array) -> Array:
    """The rotation between two others, along the shorter way: −b is the same rotation as b."""
    cosine = np.sum(a * b, axis=-1, keepdims=True)
    b, cosine = np.where(cosine < 0, -b, b), np.clip(np.abs(cosine), 0.0, 1.0)
    angle = np.arccos(np.minimum(cosine, NEARLY_PARALLEL))
    first, second = np.sin((1 - u) * angle) / np.sin(angle), np.sin(u * angle) / np.sin(angle)
    near = cosine > NEARLY_PARALLEL
    return np.asarray(np.where(near, 1 - u, first) * a + np.where(near, u, second) * b)


def transform(translation: Array, rotation: Array, scale: Array) -> Array:
    """Matrices (n, 4, 4) that scale, then turn, then move; rotations (n, 4) of any length above 0."""
    length = np.linalg.norm(rotation, axis=1, keepdims=True)
    x, y, z, w = (rotation / np.where(length > 0, length, 1.0)).T
    turn = np.empty((max(len(translation), len(rotation), len(scale)), 4, 4))
    turn[:] = np.eye(4)
    turn[:, 0, 0], turn[:, 0, 1], turn[:, 0, 2] = 1 - 2 * (y * y + z * z), 2 * (x * y - z * w), 2 * (x * z + y * w)
    turn[:, 1, 0], turn[:, 1, 1], turn[:, 1, 2] = 2 * (x * y + z * w), 1 - 2 * (x * x + z * z), 2 * (y * z - x * w)
    turn[:, 2, 0], turn[:, 2, 1], turn[:, 2, 2] = 2 * (x * z - y * w), 2 * (y * z + x * w), 1 - 2 * (x * x + y * y)
    turn[:, :3, :3] *= scale[:, None, :]
    turn[:, :3, 3] = translation
    return turn


AT_REST = {"translation": [0.0] * 3, "rotation": [0.0, 0.0, 0.0, 1.0], "scale": [1.0] * 3}


class Meshes(NamedTuple):
    """All meshes of a scene: n vertices, T triangles."""

    positions: Array  # (frames, n, 3)
    triangles: Indices  # (T, 3)
    texture: Array | None  # (T, 3, 2), of the first texture; NaN unknown
    parts: Parts  # by nodes, then by materials


def meshes_at(doc: Document, nodes: list[Placed], tracks: Tracks, times: Array) -> Meshes:
    """All meshes at the times."""
    parts: list[Array] = []
    faces: list[Indices] = [np.zeros((0, 3), np.int32)]
    textures: list[Array] = [np.zeros((0, 3, 2))]
    names: list[tuple[str, str]] = []  # of node and material, for each of `faces` but the first
    start = 0
    for node in nodes:
        matrix = matrix_of(doc, node, tracks, times)
        mirrored = np.linalg.det(matrix[0, :3, :3]) < 0
        shared: dict[tuple[Any, ...], tuple[int, int]] = {}
        for primitive in doc.items(doc.item("meshes", doc.item("nodes", node.node)["mesh"]), "primitives"):
            doc.typed(primitive, dict, "an object", "primitives")
            key = _sources(doc, primitive)
            if key not in shared:
                shape = _shape(doc, node.node, key, tracks, times)
                check_room((start + shape.shape[1]) * len(times) * 3 * 8 * 2, doc.path)
                parts.append(shape @ np.swapaxes(matrix[:, :3, :3], 1, 2) + matrix[:, None, :3, 3])
                shared[key] = start, shape.shape[1]
                start += shape.shape[1]
            triangles = _triangles(doc, primitive, shared[key][1])
            texture = _texture(doc, primitive, shared[key][1])[triangles]
            faces.append(shared[key][0] + (triangles[:, ::-1] if mirrored else triangles))
            textures.append(texture[:, ::-1] if mirrored else texture)
            names.append((_named(doc, "nodes", node.node), _named(doc, "materials", primitive.get("material"))))
    if not start:
        raise InvalidMotion(f"{doc.name}: there is no mesh in it")
    whole = np.empty((len(times), start, 3))
    for first, part in zip(np.cumsum([0, *(part.shape[1] for part in parts)]), parts, strict=False):
        whole[:, first : first + part.shape[1]] = part
    triangles = np.concatenate(faces)
    return Meshes(whole, triangles, known(np.concatenate(textures)), _parts(names, faces[1:], triangles))


def _parts(names: list[tuple[str, str]], faces: list[Indices], triangles: Indices) -> Parts:
    """The parts by nodes and materials, of primitives with these names and triangles."""
    first = np.cumsum([0, *map(len, faces)])
    own = [np.arange(begin, end) for begin, end in pairwise(first)]
    found: dict[tuple[int, str], list[NDArray[np.intp]]] = {}
    for kind in (0, 1):
        for each, members in zip(names, own, strict=True):
            found.setdefault((kind, each[kind]), []).append(members)
    return parts_of(((name, np.concatenate(members)) for (_, name), members in found.items()), triangles)


def _named(doc: Document, kind: str, index: Any) -> str:
    """The name of a part such as `materials[2]`; empty where it has none."""
    try:
        name = "" if index is None else doc.item(kind, index).get("name", "")
    except InvalidMotion:
        return ""
    return name if isinstance(name, str) else ""


def _texture(doc: Document, primitive: dict[str, Any], count: int) -> Array:
    """Texture coordinates (count, 2) of the vertices of a primitive, NaN where there are none that can be read."""
    index = primitive.get("attributes", {}).get("TEXCOORD_0")
    nothing = np.full((count, 2), np.nan)
    try:
        found = nothing if index is None else doc.accessor(index, "VEC2")
    except InvalidMotion:
        return nothing
    return found if found.shape == nothing.shape else nothing


def matrix_of(doc: Document, node: Placed, tracks: Tracks, times: Array) -> Array:
    """The matrix of a node at the times: (frames or 1, 4, 4)."""
    product = np.eye(4)[None]
    for index in (*node.above, node.node):
        described = doc.item("nodes", index)
        if "matrix" in described:
            product = product @ doc.numbers(described, "matrix", [0.0] * 16).reshape(4, 4).T
            continue
        steps = [
            tracks[index, what].at(times, what == "rotation")
            if (index, what) in tracks
            else doc.numbers(described, what, default)[None]
            for what, default in AT_REST.items()
        ]
        product = product @ transform(*steps)
    return product


def _sources(doc: Document, primitive: dict[str, Any]) -> tuple[Any, ...]:
    """The accessors of the positions of a primitive and of its targets; None where a target has none."""
    owners = [primitive.get("attributes", {}), *doc.items(primitive, "targets")]
    for owner in owners:
        doc.typed(owner, dict, "an object", "attributes")
    return tuple(doc.typed(owner.get("POSITION", -1), int, "an index", "POSITION") for owner in owners)


def _shape(doc: Document, node: int, sources: tuple[int, ...], tracks: Tracks, times: Array) -> Array:
    """Positions (frames, n, 3) in the axes of the node."""
    base = doc.accessor(sources[0], "VEC3")
    described = doc.item("nodes", node)
    count = len(sources) - 1
    if (node, "weights") in tracks:
        weights = tracks[node, "weights"].at(times)
    else:
        owner = described if "weights" in described else doc.item("meshes", described["mesh"])
        weights = doc.numbers(owner, "weights", [0.0] * count)[None]
    if weights.shape[1] != count:
        raise InvalidMotion(f"{doc.name}: {weights.shape[1]} weights do not match the {count} targets of a mesh")
    check_room((count + 2 * len(weights)) * base.nbytes, doc.path)
    targets = np.zeros((count, base.size))
    for k, source in enumerate(sources[1:]):
        if source >= 0:
            target = doc.accessor(source, "VEC3")
            if target.shape != base.shape:
                raise InvalidMotion(f"{doc.name}: a target has {len(target)} vertices, its mesh {len(base)}")
            targets[k] = target.reshape(-1)
    return base + (weights @ targets).reshape(len(weights), *base.shape)


def _triangles(doc: Document, primitive: dict[str, Any], count: int) -> Indices:
    """Triangles (T, 3) of a primitive of `count` vertices; points and lines have none."""
    if "indices" in primitive:
        corners = doc.accessor(primitive["indices"], "SCALAR")[:, 0].astype(np.int64)
    else:
        corners = np.arange(count)
    if len(corners) and not 0 <= corners.min() <= corners.max() < count:
        raise InvalidMotion(f"{doc.name}: a triangle names a vertex beyond the {count} of its mesh")
    i = np.arange(max(len(corners) - 2, 0))
    orders = {
        4: np.arange(len(corners) // 3 * 3).reshape(-1, 3),  # separate triangles
        5: np.stack([i, i + 1 + i % 2, i + 2 - i % 2], axis=1),  # a strip
        6: np.stack([i + 1, i + 2, 0 * i], axis=1),  # a fan
    }
    mode = doc.whole(primitive, "mode", 4)
    return corners[orders[mode]].astype(np.int32) if mode in orders else np.zeros((0, 3), np.int32)
