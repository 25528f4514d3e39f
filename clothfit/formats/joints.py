"""One joint of an animation: where a named node of a glTF file, or a joint of a USD skeleton, is over time.

A node moves with all nodes above it, each by its own tracks. Between keys a joint goes on the path that the file says;
it is sampled at all keys of these tracks and at least `FINEST` apart, so that straight lines and even turns between
the samples are near it. What scales is left out: of the matrix's linear part the nearest rotation counts.
"""

from __future__ import annotations

import os
from itertools import pairwise
from typing import Any, NamedTuple

import numpy as np

from clothfit.base.arrays import Array
from clothfit.base.errors import InvalidInput, InvalidMotion
from clothfit.base.messages import named
from clothfit.formats.axes import RIGHT, Axes, to_scene
from clothfit.formats.files import check_room, name_of
from clothfit.formats.gltf import LEVELS, Document, Placed, Tracks, matrix_of, tracks_of
from clothfit.formats.registry import foreign, module_of, suffix_of

FINEST = 1.0 / 60.0
"""Longest time between two samples, s."""

SPARSE = 0.1
"""Time between two keys, s, above which they are no frames."""

MOST_BETWEEN = 100_000
"""Samples between two keys, at most."""

MOST_LISTED = 8
"""Names of joints in a message."""


class Joint(NamedTuple):
    """A joint at K times, in the axes of its file."""

    times: Array  # (K,), s
    matrices: Array  # (K, 4, 4), from its own axes to the file's
    axes: Axes

    def moved(self, axes: Axes) -> tuple[Array, Array]:
        """Its places (K, 3), m, and turns (K, 3, 3) in the scene's axes, where the file's are these."""
        basis = to_scene(np.eye(3), axes._replace(scale=1.0)).T
        u, _, v = np.linalg.svd(self.matrices[:, :3, :3])
        flip = np.linalg.det(u @ v)  # −1 where the joint mirrors
        u[:, :, 2] *= flip[:, None]
        return to_scene(self.matrices[:, :3, 3], axes), basis @ (u @ v) @ basis.T


def read(path: str | os.PathLike[str], name: str) -> Joint:
    """The joint of that name. Raises InvalidMotion; InvalidInput where the file cannot have joints."""
    found = foreign(path)
    if found is not None and found.name == "USD":
        module_of(found)  # that the library is there
        from clothfit.formats.usd import arrays_of

        arrays = arrays_of(path, "joint", name)
        up, handedness, scale = arrays["axes"].tolist()
        return Joint(arrays["times"], arrays["matrices"], Axes(up, handedness, float(scale)))
    if found is None or found.name != "glTF":
        suffix = suffix_of(path) or "no suffix"
        raise InvalidInput(f"{name_of(path)}: joints are in .glb, .gltf and .usd files; this one has {suffix}")
    return of_gltf(Document(path), name)


def of_gltf(doc: Document, name: str) -> Joint:
    """The node of that name."""
    node = node_named(doc, name)
    line = (*node.above, node.node)
    tracks = moving(doc, line)
    own = [track.times for (index, _), track in tracks.items() if index in line]
    times = sampled(np.unique(np.concatenate(own))) if own else np.zeros(1)
    check_room(len(times) * 16 * 8 * 4, doc.path)
    matrices = np.broadcast_to(matrix_of(doc, node, tracks, times), (len(times), 4, 4))
    return Joint(times, matrices, RIGHT)


def sampled(keys: Array) -> Array:
    """Times with these (K,) among them, s, and others where they lie far apart."""
    parts = [
        np.linspace(a, b, max(2, 1 + min(int(np.ceil((b - a) / FINEST)), MOST_BETWEEN)))[:-1]
        for a, b in pairwise(keys.tolist())
    ]
    return np.concatenate([*parts, keys[-1:]])


def baked(keys: Array) -> Array:
    """The same, where keys (K,) are as dense as frames as they are."""
    return sampled(keys) if len(keys) > 1 and np.diff(keys).max() > SPARSE else keys


def node_named(doc: Document, name: str) -> Placed:
    """The node of that name, with those above it. Raises InvalidMotion where there is none, or several are."""
    nodes = [doc.item("nodes", index) for index in range(len(doc.items(doc.root, "nodes")))]
    above: dict[int, int] = {}
    for index, node in enumerate(nodes):
        above |= {each: index for each in doc.items(node, "children") if type(each) is int}
    matching = [index for index, node in enumerate(nodes) if node.get("name") == name]
    if len(matching) != 1:
        raise InvalidMotion(absent(doc.name, name, len(matching), [node.get("name") for node in nodes]))
    line = [matching[0]]
    while line[-1] in above:
        line.append(above[line[-1]])
        if len(line) > LEVELS:
            raise InvalidMotion(f"{doc.name}: its nodes are not a tree of at most {LEVELS} levels")
    return Placed(line[0], tuple(reversed(line[1:])))


def absent(file: str, name: str, count: int, others: list[Any]) -> str:
    """That there is no joint of a name, or that several have it."""
    if count:
        return f"{file}: {count} joints are named {named(name)}; a name must be that of one"
    known = [named(each) for each in others if isinstance(each, str) and each]
    more = f" and {len(known) - MOST_LISTED} more" if len(known) > MOST_LISTED else ""
    listed = f"; there are {', '.join(known[:MOST_LISTED])}{more}" if known else "; it names none"
    return f"{file}: there is no joint {named(name)}{listed}"


def moving(doc: Document, line: tuple[int, ...]) -> Tracks:
    """The tracks of the first animation that moves one of these nodes; none where nothing does."""
    for index in range(len(doc.items(doc.root, "animations"))):
        found = tracks_of(doc, index)
        if any(node in line for node, _ in found):
            return found
    return {}
