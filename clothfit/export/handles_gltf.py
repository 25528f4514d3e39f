"""glTF 2.0: a node for each handle of a scene, moved by an animation.

A node is where the vertices of its pin turn about, their mean where they do not; its `extras` have the object and the
vertices. Keys are float32, linear, or steps where the scene holds its keys.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from clothfit.base.arrays import Array
from clothfit.export.handles import Handle, handles
from clothfit.formats.glb import Parts, glb
from clothfit.scene.scene import Scene


def files(scene: Scene) -> dict[str, bytes]:
    """One GLB file."""
    parts, found = Parts(), handles(scene)
    samplers: list[dict[str, Any]] = []
    channels: list[dict[str, Any]] = []
    for node, each in enumerate(found):
        add(parts, samplers, channels, node, each)
    document = {
        "asset": {"version": "2.0", "generator": "clothfit"},
        "scene": 0,
        "scenes": [{"nodes": list(range(len(found)))}],
        "nodes": [node_of(each) for each in found],
        "animations": [{"name": "handles", "samplers": samplers, "channels": channels}],
        "accessors": parts.accessors,
        "bufferViews": parts.views,
    }
    return {"handles.glb": glb(document, parts, "handles.glb")}


def node_of(handle: Handle) -> dict[str, Any]:
    """A node as it is at the start."""
    extras = {"object": handle.cloth, "vertices": handle.vertices.tolist()}
    return {"name": handle.name, "translation": handle.places[0].tolist(), "extras": extras}


def add(
    parts: Parts, samplers: list[dict[str, Any]], channels: list[dict[str, Any]], node: int, handle: Handle
) -> None:
    """The channels of a node."""
    way = "STEP" if handle.holds else "LINEAR"
    tracks = [("translation", handle.times, handle.places, "VEC3", way)]
    if len(handle.turns):
        tracks.append(("rotation", handle.turn_times, handle.turns, "VEC4", "LINEAR"))
    for name, times, values, kind, interpolation in tracks:
        own = {
            "input": parts.add(singles(times), "SCALAR", True),
            "output": parts.add(values.astype(np.float32), kind),
            "interpolation": interpolation,
        }
        channels.append({"sampler": len(samplers), "target": {"node": node, "path": name}})
        samplers.append(own)


def singles(times: Array) -> NDArray[np.float32]:
    """Times as float32, none later than it was: at the end of a step a place that is held has begun."""
    found = times.astype(np.float32)
    return np.where(found > times, np.nextafter(found, np.float32(0.0)), found)
