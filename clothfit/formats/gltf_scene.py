"""The contents of a glTF scene: the nodes with meshes, and the tracks of its animation.

The nodes form a tree. The channels of an animation say which track drives which part of which node: values over time
between keys, by steps, straight lines, or cubic splines with given tangents (glTF 2.0 specification, appendix C).
Rotations are unit quaternions (x, y, z, w), on great arcs between their keys.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any, NamedTuple, TypeAlias

import numpy as np
from numpy.typing import NDArray

from clothfit.base.arrays import Array
from clothfit.base.errors import InvalidMotion
from clothfit.formats.animation import increasing
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
        curve: Array = (1 - rise) * a + rise * b + bend * (u - 1) * out + bend * u * into
        return curve


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
        where = f"{doc.name}: {place}: times"
        raise InvalidMotion(f"{where}: must be finite and increasing")
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
    between: Array = np.where(near, 1 - u, first) * a + np.where(near, u, second) * b
    return between


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
