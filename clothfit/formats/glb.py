"""Motions in glTF 2.0 files (.glb, .gltf): a base shape, and morph targets that are added to it by animated weights.

glTF is y up, right-handed and in metres; numbers are float32. A target for each frame would be large and slow, so a
motion is written with the fewest targets (`morphs`) that keep every vertex within `TOLERANCE`, in the file's unit, or
within that share of the cloth's size where that is less. The `extras` of the mesh hold their number and the largest
error. For reading, the frames are the keys of the animation; of several meshes those with animated weights are the
cloth. Skeletons are not followed.
"""

from __future__ import annotations

import base64
import json
import os
from typing import Any

import numpy as np
from numpy.typing import NDArray

from clothfit.base.arrays import Array
from clothfit.base.errors import InvalidMotion
from clothfit.base.writing import Data
from clothfit.formats.animation import Animation, times_of
from clothfit.formats.axes import RIGHT
from clothfit.formats.files import check_room
from clothfit.formats.glb_parts import Parts, glb
from clothfit.formats.gltf import Document
from clothfit.formats.gltf_meshes import meshes_at
from clothfit.formats.gltf_scene import animated, placed
from clothfit.formats.morphs import Morphs, reduced

TOLERANCE = 1e-5
"""The largest error of a position: in m, and as a share of the diagonal of the box around the motion."""

DATA_URI = "data:application/octet-stream;base64,"
"""Before the numbers in the document of a .gltf file."""

ARRAY_BUFFER, ELEMENT_ARRAY_BUFFER = 34962, 34963  # targets of buffer views: vertices, indices
POINTS_MODE, TRIANGLES_MODE = 0, 4  # kinds of primitives


def read(path: str | os.PathLike[str]) -> Animation:
    """The meshes of a file; one frame where nothing moves. Raises InvalidMotion."""
    doc = Document(path)
    nodes = list(placed(doc))
    tracks, notes = animated(doc, nodes)
    moving = [node for node in nodes if (node.node, "weights") in tracks]
    if moving and len(moving) < len(nodes):
        notes = (*notes, f"{len(nodes) - len(moving)} of its meshes have no animated shape and are left out")
    used = {each for node in moving or nodes for each in (*node.above, node.node)}
    tracks = {key: track for key, track in tracks.items() if key[0] in used}
    if any(track.kind != "LINEAR" for track in tracks.values()):
        notes = (*notes, "between the keys of its animation the motion is not straight; the keys are the frames")
    times = np.unique(np.concatenate([np.zeros(0), *(track.times for track in tracks.values())]))
    with np.errstate(all="ignore"):  # what overflows is reported below
        found = meshes_at(doc, moving or nodes, tracks, times if len(times) else np.zeros(1))
    if not np.isfinite(found.positions).all():
        raise InvalidMotion(f"{doc.name}: some of its positions are not finite numbers")
    faces = found.triangles if len(found.triangles) else None
    return Animation(
        found.positions, RIGHT, times if len(times) else None, faces, notes=notes,
        texture=found.texture, parts=found.parts,
    )  # fmt: skip


def encoded(path: str | os.PathLike[str], animation: Animation) -> dict[str, Data]:
    """The file, with the reduced motion; every position must be known. Raises InvalidMotion where it gets too long."""
    positions = animation.positions
    check_room(4 * positions.nbytes, path)
    size = float(np.linalg.norm(np.ptp(positions.reshape(-1, 3), axis=0)))
    morphs = reduced(positions, TOLERANCE * min(size, 1 / animation.axes.scale))
    parts = Parts()
    document = _document(parts, morphs, animation)
    if os.fspath(path).lower().endswith(".gltf"):
        numbers = b"".join(parts.pieces)
        uri = DATA_URI + base64.b64encode(numbers).decode()
        document["buffers"] = [{"byteLength": len(numbers), "uri": uri}]
        return {os.fspath(path): json.dumps(document, separators=(",", ":")).encode()}
    return {os.fspath(path): glb(document, parts, path)}


def _document(parts: Parts, morphs: Morphs, animation: Animation) -> dict[str, Any]:
    """The JSON document, without the length of the buffer."""
    primitive: dict[str, Any] = {
        "attributes": {"POSITION": parts.add(morphs.base, "VEC3", True, target=ARRAY_BUFFER)},
        "mode": POINTS_MODE if animation.triangles is None else TRIANGLES_MODE,
    }
    if animation.triangles is not None:
        primitive["indices"] = parts.add(animation.triangles.astype(np.uint32), "SCALAR", target=ELEMENT_ARRAY_BUFFER)
    mesh: dict[str, Any] = {"name": "cloth", "primitives": [primitive]}
    document: dict[str, Any] = {
        "asset": {"version": "2.0", "generator": "clothfit", "extras": {"axes": str(animation.axes)}},
        "scene": 0,
        "scenes": [{"nodes": [0]}],
        "nodes": [{"name": "cloth", "mesh": 0}],
        "meshes": [mesh],
        "accessors": parts.accessors,
        "bufferViews": parts.views,
    }
    if len(animation.positions) > 1:
        count = len(morphs.targets)
        shapes = [parts.add(each, "VEC3", True, target=ARRAY_BUFFER) for each in morphs.targets]
        primitive["targets"] = [{"POSITION": shape} for shape in shapes]
        mesh["weights"] = morphs.weights[0].tolist()  # the first frame, where nothing plays
        mesh["extras"] = {
            "targetNames": [f"shape {k}" for k in range(count)],
            "targets": count,
            "largestError": morphs.error,
        }
        document["animations"] = [_channel(parts, morphs.weights, times_of(animation))]
    return document


def _channel(parts: Parts, weights: NDArray[Any], times: Array) -> dict[str, Any]:
    """The animation: linear between the weights at the times, which must not be negative in glTF."""
    shifted = (times - min(times[0], 0.0)).astype(np.float32)
    sampler = {"input": parts.add(shifted, "SCALAR", True), "output": parts.add(weights, "SCALAR")}
    return {
        "name": "motion",
        "samplers": [{**sampler, "interpolation": "LINEAR"}],
        "channels": [{"sampler": 0, "target": {"node": 0, "path": "weights"}}],
    }
