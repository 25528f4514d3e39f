"""The contents of a glTF scene: the nodes with meshes, and the tracks of its animation.

The nodes form a tree. The channels of an animation say which track drives which part of which node.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any, NamedTuple, TypeAlias

from clothfit.base.errors import InvalidMotion
from clothfit.formats.animation import increasing
from clothfit.formats.gltf import Document
from clothfit.formats.tracks import Track

ANIMATED_TYPES = {"translation": "VEC3", "rotation": "VEC4", "scale": "VEC3", "weights": "SCALAR"}
INTERPOLATIONS = ("LINEAR", "STEP", "CUBICSPLINE")

LEVELS = 100
"""The most levels of nodes."""

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
    """The tracks of the first animation that changes shapes, else of the first; and notes on it."""
    count = len(doc.items(doc.root, "animations"))
    skinned = any("skin" in doc.item("nodes", node.node) for node in nodes)
    if not count:
        return {}, ("its skeleton is left out, which does not move",) if skinned else ()
    if skinned:
        raise InvalidMotion(f"{doc.name}: a skeleton moves its mesh; bake the motion into shape keys or a point cache")
    shapes = {node.node for node in nodes}
    each = [_animation(doc, index) for index in range(count)]
    changing = [i for i in range(count) if any(n in shapes and what == "weights" for n, what in each[i])]
    chosen = (changing or [0])[0]
    return each[chosen], (f"of its {count} animations number {chosen + 1} is read",) if count > 1 else ()


def _animation(doc: Document, index: int) -> Tracks:
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
