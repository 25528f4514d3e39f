"""Meshes that change over time: where their vertices are at a step, from the frames of a motion.

A place between two frames is a sum of rows, Σ wⱼ rⱼ: of two frames on a line, of one where it holds, and of two frames
and the slopes of a cubic spline at them where it is smooth. So the memory is that of the frames, however many steps.
"""

from __future__ import annotations

from collections.abc import Sequence
from math import sqrt
from typing import TYPE_CHECKING, NamedTuple, TypeAlias

import numpy as np
import numpy.typing as npt

from clothfit.base.arrays import NO_VECTORS, Array, Indices
from clothfit.engine.forces import bodies as meshes
from clothfit.engine.inputs.interpolation import splined
from clothfit.kernels.kernel import kernel
from clothfit.kernels.lanes.operations import fma, load3, mul, splat, store3, sub
from clothfit.kernels.vectors import dot

if TYPE_CHECKING:
    from clothfit.engine.inputs.body_files import Moving

Numbers: TypeAlias = npt.NDArray[np.int64]

ROWS = 4
"""Rows of a sum."""


class Poses(NamedTuple):
    """Those of M moving meshes at R times, a step apart. Q rows of frames and slopes, one for each vertex of each."""

    rows: Array = NO_VECTORS  # (Q, 3), m; slopes m/s
    body: Indices = np.zeros(0, np.int32)  # (M,), which of the meshes they are
    first: Numbers = np.zeros((0, 0, ROWS), np.int64)  # (R, M, 4), of the rows of each sum the one of the first vertex
    weight: Array = np.zeros((0, 0, ROWS))  # (R, M, 4), slopes have s


def build(moving: Sequence[Moving], interpolations: Sequence[str], times: Array) -> Poses:
    """The poses of those meshes that change at times (T,), s, as keys interpolate."""
    own = [b for b, each in enumerate(moving) if len(each.times)]
    parts, begin = [np.zeros((0, 3))], 0
    first, weight = np.zeros((len(times), len(own), ROWS), np.int64), np.zeros((len(times), len(own), ROWS))
    for m, b in enumerate(own):
        rows, count = frames_of(moving[b], interpolations[b]), moving[b].frames.shape[1]
        place, weight[:, m] = shares(moving[b].times, interpolations[b], times)
        first[:, m] = begin + place * count
        parts.append(rows.reshape(-1, 3))
        begin += len(parts[-1])
    return Poses(np.concatenate(parts), np.array(own, np.int32), first, weight)


def frames_of(moving: Moving, interpolation: str) -> Array:
    """The frames (K, V, 3), and after them the slopes of a smooth motion, (K, V, 3) again."""
    if interpolation != "smooth" or len(moving.times) == 1:
        return moving.frames
    slopes = splined(moving.times, moving.frames, moving.motion)(moving.times, 1)
    return np.concatenate([moving.frames, slopes])


def shares(own: Array, interpolation: str, times: Array) -> tuple[Numbers, Array]:
    """The rows (T, 4) among frames at times `own` (K,), and slopes after them, and their weights, at times (T,), s."""
    count = len(own)
    place, weight = np.zeros((len(times), ROWS), np.int64), np.zeros((len(times), ROWS))
    inside = np.clip(times, own[0], own[-1])
    before = np.searchsorted(own, inside, side="right") - 1
    if interpolation == "hold" or count == 1:
        place[:, 0], weight[:, 0] = before, 1.0
        return place, weight
    before = np.minimum(before, count - 2)
    span = own[before + 1] - own[before]
    s = (inside - own[before]) / span
    place[:, 0], place[:, 1] = before, before + 1
    if interpolation == "linear":
        weight[:, 0], weight[:, 1] = 1.0 - s, s
        return place, weight
    place[:, 2], place[:, 3] = count + before, count + before + 1
    late = s * s * (3.0 - 2.0 * s)
    weight[:] = np.stack([1.0 - late, late, span * s * (1.0 - s) ** 2, span * s * s * (s - 1.0)], axis=1)
    return place, weight


def places(moving: Moving, interpolation: str, times: Array) -> Array:
    """The places (T, V, 3), m, of the vertices of a mesh with a motion of its own at times (T,), s."""
    first, weight = shares(moving.times, interpolation, times)
    rows = frames_of(moving, interpolation)
    found = np.zeros((len(times), *rows.shape[1:]))
    for j in range(ROWS):
        found += weight[:, j, None, None] * rows[first[:, j]]
    return found


@kernel
def pose(poses, colliders, row, lead, h):
    """Put the meshes where they are at a row of the table, with the velocity of the step that ends there, with `lead` 0
    of the one that begins there.
    """
    bodies, step = colliders.bodies, min(max(row - lead, 0), len(poses.first) - 2)
    for m in range(len(poses.body)):
        b = poses.body[m]
        begin, change, other, fastest = bodies.vertex[b], 0.0, not bodies.moves[b], 0.0
        for k in range(begin, bodies.vertex[b + 1]):
            v = k - begin
            now, way = place_at(poses, row, m, v), sub(place_at(poses, step + 1, m, v), place_at(poses, step, m, v))
            velocity = mul(splat(1.0 / h), way)
            moved, turned = sub(now, load3(bodies.place, k)), sub(velocity, load3(bodies.velocity, k))
            change, fastest = max(change, dot(moved, moved)), max(fastest, dot(velocity, velocity))
            other = other or dot(turned, turned) > 0.0
            store3(now, bodies.place, k)
            store3(velocity, bodies.velocity, k)
        if other or change > 0.0:
            bodies.moves[b], bodies.fastest[b] = True, sqrt(fastest)
            meshes.arrange(bodies, b)
            for i in range(bodies.clear.shape[1]):
                bodies.clear[b, i, 3] -= sqrt(change) / meshes.NEAR
            colliders.posed[:] = np.nan


@kernel
def place_at(poses, row, m, v):
    """Where vertex v of the moving mesh m is at a row (lanes)."""
    first, weight = poses.first[row, m], poses.weight[row, m]
    found = mul(splat(weight[0]), load3(poses.rows, first[0] + v))
    for j in range(1, ROWS):
        if weight[j] != 0.0:
            found = fma(splat(weight[j]), load3(poses.rows, first[j] + v), found)
    return found
