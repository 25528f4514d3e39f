"""The meshes of a glTF scene at some times: morph targets by their weights, on nodes that may move, as triangles.

Vertices are in the order of the nodes, their meshes and primitives; primitives that share vertices give them once. A
node that mirrors its mesh reverses the corners of the triangles, so that their front stays outside.
"""

from __future__ import annotations

from itertools import pairwise
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from clothfit.base.arrays import Array, Indices
from clothfit.base.errors import InvalidMotion
from clothfit.formats.animation import Parts, known, parts_of
from clothfit.formats.files import check_room
from clothfit.formats.gltf import Document
from clothfit.formats.gltf_scene import Placed, Tracks, transform

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
