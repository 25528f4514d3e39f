"""Motions in glTF 2.0 files (.glb, .gltf): a base shape, and morph targets that are added to it by animated weights.

glTF is y up, right-handed and in metres; numbers are float32. A target for each frame would be large and slow, so a
motion is written with the fewest targets (`reduced`) that keep every vertex within `LARGEST_ERROR`, in the file's unit,
or within that share of the cloth's size where that is less. The `extras` of the mesh hold their number and the largest
error. For reading, the frames are the keys of the animation; of several meshes those with animated weights are the
cloth. Skeletons are not followed.

As few shapes: positions(t) ≈ base + Σ_k w_k(t) d_k, with weights within 0 … 1, to which viewers clamp them.
The displacements D (frames, 3 n) from the first frame x₀ are projected on the K leading eigenvectors U of their Gram
matrix D Dᵀ, the left singular vectors of D (Eckart and Young, Psychometrika 1, 1936): amounts a = U_K, vectors
v = U_Kᵀ D, the best that K shapes can do in the mean square. With more frames than coordinates, the eigenvectors V of
Dᵀ D take their place: a = D V_K, v = V_Kᵀ. With l_k and h_k the least and the largest amount of a shape,

    base = x₀ + Σ_k l_k v_k,      d_k = (h_k − l_k) v_k,      w_k = (a_k − l_k) / (h_k − l_k)

The sign of a vector is free: the one with |l_k| ≤ h_k keeps the base nearer to the first frame. K is the smallest
number that keeps every vertex of every frame within a tolerance, with all numbers rounded to float32 as they are
stored. The Gram matrix loses half of the digits, but only in the choice of the space: with all vectors the projection
is exact.
"""

from __future__ import annotations

import base64
import json
import os
import struct
from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from clothfit.base.arrays import Array
from clothfit.base.errors import InvalidMotion
from clothfit.base.memory import human
from clothfit.base.writing import Data
from clothfit.formats.animation import Animation, check_finite, moving, times_of, unrounded
from clothfit.formats.animation import chosen as selected
from clothfit.formats.axes import RIGHT
from clothfit.formats.files import check_room, name_of
from clothfit.formats.gltf import (
    BIN_CHUNK,
    GLB_MAGIC,
    JSON_CHUNK,
    Document,
    Placed,
    Tracks,
    animated,
    meshes_at,
    path_of,
    pins,
    placed,
)
from clothfit.formats.joints import baked

LARGEST_ERROR = 1e-5
"""The largest error of a position: in m, and as a share of the diagonal of the box around the motion."""

DATA_URI = "data:application/octet-stream;base64,"
"""Before the numbers in the document of a .gltf file."""

ARRAY_BUFFER, ELEMENT_ARRAY_BUFFER = 34962, 34963  # targets of buffer views: vertices, indices
POINTS_MODE, TRIANGLES_MODE = 0, 4  # kinds of primitives
FLOAT, UINT = 5126, 5125  # types of components

MOST_GLB_BYTES = 2**32 - 1
"""Bytes of a GLB file, whose length has 32 bits."""

NUMBERS_AT_ONCE = 4_000_000
"""Numbers to compare at a time."""

Singles = NDArray[np.float32]


def read(path: str | os.PathLike[str], wanted: str = "") -> Animation:
    """The meshes of a file, or those that are `wanted`; one frame where nothing moves. Raises InvalidMotion."""
    doc = Document(path)
    nodes = list(placed(doc))
    every, notes = animated(doc, nodes)
    if wanted:
        chosen: Sequence[Placed] = selected(nodes, [path_of(doc, node) for node in nodes], wanted, doc.name)
        notes = []
    else:
        chosen, _ = moving(nodes, lambda node: (node.node, "weights") in every, notes)
    used = {each for node in chosen for each in (*node.above, node.node)}
    tracks = {key: track for key, track in every.items() if key[0] in used}
    if any(track.kind != "LINEAR" for track in tracks.values()):
        notes.append("between the keys of its animation the motion is not straight; the keys are the frames")
    times = _times(tracks)
    if wanted and len(times) and not any(what == "weights" for _, what in tracks):  # between the keys it turns
        times = baked(_times(every))
    with np.errstate(all="ignore"):  # what overflows is reported below
        positions, faces = meshes_at(doc, chosen, tracks, times if len(times) else np.zeros(1))
    check_finite(doc.name, positions)
    own_times, held = unrounded(times) if len(times) else None, pins(doc, chosen).found(notes)
    return Animation(positions, RIGHT, own_times, notes=tuple(notes), pins=held, **faces.found())


def paths(path: str | os.PathLike[str]) -> list[str]:
    """The paths of all meshes of a file. Raises InvalidMotion."""
    doc = Document(path)
    return [path_of(doc, node) for node in placed(doc)]


def _times(tracks: Tracks) -> Array:
    return np.unique(np.concatenate([np.zeros(0), *(track.times for track in tracks.values())]))


def encoded(path: str | os.PathLike[str], animation: Animation) -> dict[str, Data]:
    """The file, with the reduced motion; every position must be known. Raises InvalidMotion where it gets too long."""
    positions = animation.positions
    check_room(4 * positions.nbytes, path)
    size = float(np.linalg.norm(np.ptp(positions.reshape(-1, 3), axis=0)))
    morphs = reduced(positions, LARGEST_ERROR * min(size, 1 / animation.axes.scale))
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
        times = times_of(animation)
        shifted = (times - min(times[0], 0.0)).astype(np.float32)  # glTF has no times before 0
        sampler = {"input": parts.add(shifted, "SCALAR", True), "output": parts.add(morphs.weights, "SCALAR")}
        channel = {"sampler": 0, "target": {"node": 0, "path": "weights"}}
        linear = {**sampler, "interpolation": "LINEAR"}
        document["animations"] = [{"name": "motion", "samplers": [linear], "channels": [channel]}]
    return document


class Parts:
    """The numbers for the second chunk, with the views and accessors that describe them."""

    def __init__(self) -> None:
        self.pieces: list[bytes] = []
        self.views: list[dict[str, Any]] = []
        self.accessors: list[dict[str, Any]] = []
        self._length = 0  # a multiple of 4, as all numbers have 4 bytes

    def add(self, values: NDArray[Any], kind: str, bounds: bool = False, **view: int) -> int:
        """Append an array; returns the index of its accessor."""
        data = values.tobytes()
        self.views.append({"buffer": 0, "byteOffset": self._length, "byteLength": len(data), **view})
        self.pieces.append(data)
        self._length += len(data)
        described: dict[str, Any] = {
            "bufferView": len(self.views) - 1,
            "componentType": FLOAT if values.dtype == np.float32 else UINT,
            "count": values.size if kind == "SCALAR" else len(values),
            "type": kind,
        }
        if bounds:
            table = values.reshape(described["count"], -1)
            described |= {"min": table.min(axis=0).tolist(), "max": table.max(axis=0).tolist()}
        self.accessors.append(described)
        return len(self.accessors) - 1


def glb(document: dict[str, Any], parts: Parts, path: str | os.PathLike[str]) -> bytes:
    """A GLB file; the document gets its buffer. Raises InvalidMotion where it gets too long."""
    numbers = b"".join(parts.pieces)
    document["buffers"] = [{"byteLength": len(numbers)}]
    text = json.dumps(document, separators=(",", ":")).encode()
    text += b" " * (-len(text) % 4)
    length = 12 + 8 + len(text) + 8 + len(numbers)
    if length > MOST_GLB_BYTES:
        raise InvalidMotion(f"{name_of(path)}: {human(length)} are more than a GLB file can have; keep fewer frames")
    header = struct.pack("<4sII", GLB_MAGIC, 2, length)
    chunks = struct.pack("<I4s", len(text), JSON_CHUNK), text, struct.pack("<I4s", len(numbers), BIN_CHUNK), numbers
    return b"".join([header, *chunks])


class Morphs(NamedTuple):
    """A base shape and others that are added to it."""

    base: Singles  # (n, 3)
    targets: Singles  # (K, n, 3), K at least 1
    weights: Singles  # (frames, K), within 0 … 1
    error: float  # the largest distance of a vertex from where it should be


def reduced(positions: Array, tolerance: float) -> Morphs:
    """The fewest shapes for positions (frames, n, 3) without NaN: all of them where, because of the rounding, even all
    do not come within the tolerance.
    """
    count = positions.shape[1]
    amounts, vectors = _factors((positions - positions[0]).reshape(len(positions), -1))
    least, most = amounts.min(axis=0), amounts.max(axis=0)
    turned = -least > most
    sign = np.where(turned, -1.0, 1.0)
    low, range_ = np.where(turned, -most, least), np.maximum(most - least, np.finfo(np.float32).tiny)
    vectors *= sign[:, None]
    shapes = (vectors * range_[:, None]).astype(np.float32)
    weights = np.clip((amounts * sign - low) / range_, 0.0, 1.0).astype(np.float32)

    def of(k: int) -> Morphs:
        base = (positions[0] + (low[:k] @ vectors[:k]).reshape(count, 3)).astype(np.float32)
        made = Morphs(base, shapes[:k].reshape(k, count, 3), weights[:, :k], 0.0)
        return made._replace(error=_error(positions, made))

    few, many = 0, len(shapes)  # `few` do not suffice, `many` must
    while many - few > 1:
        middle = (few + many) // 2
        few, many = (few, middle) if of(middle).error <= tolerance else (middle, many)
    return of(many)


def _factors(shift: Array) -> tuple[Array, Array]:
    """Amounts (frames, K) and vectors (K, 3 n) whose product are the displacements, the largest first."""
    frames, coordinates = shift.shape
    if frames <= coordinates:
        amounts = np.linalg.eigh(shift @ shift.T)[1][:, ::-1]
        return amounts, amounts.T @ shift
    vectors = np.linalg.eigh(shift.T @ shift)[1][:, ::-1].T.copy()
    return shift @ vectors.T, vectors


def _error(positions: Array, morphs: Morphs) -> float:
    """The largest distance between the positions and those of the shapes."""
    targets = morphs.targets.reshape(len(morphs.targets), -1).astype(np.float64)
    step = max(NUMBERS_AT_ONCE // max(targets.shape[1], 1), 1)
    worst = 0.0
    for first in range(0, len(positions), step):
        there: Any = morphs.weights[first : first + step].astype(np.float64) @ targets
        gap = there.reshape(-1, *morphs.base.shape) + morphs.base - positions[first : first + step]
        worst = max(worst, float(np.sqrt(np.einsum("fnc,fnc->fn", gap, gap)).max(initial=0.0)))
    return worst
