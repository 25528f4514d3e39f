"""Which vertices of a moving mesh keep still, or move together as one rigid body, or on lines by one pace in time:
those that something holds.

The rigid motion of some vertices is the one that fits all their places best, frame by frame (W. Kabsch, Acta Cryst.
A32, 1976). A group is found from seeds of three vertices, along the boundary first, as cloth is mostly held there: the
motion of a seed is that of its group where others follow it. In a few frames this is quick; all frames then decide.

Single vertices that move by themselves cannot be told from free ones.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from clothfit.base.arrays import Array, Flags, Indices
from clothfit.base.eigen import connected_components
from clothfit.meshes.mesh import any_sides

TOLERANCE = 2e-5
"""Distance relative to the size of a mesh within which a vertex is where a rigid motion takes it: twice the rounding of
a glTF file.
"""

SEED_SLACK = 10.0
"""How much farther a vertex may be from the motion of a seed of three, which rounding turns."""

FEW_FRAMES, MOST_SEEDS, FEWEST = 12, 400, 4
"""Frames in which groups are looked for, seeds that are tried, and vertices of a group."""


class Held(NamedTuple):
    """Vertices that move as one."""

    vertices: Indices  # rising
    moves: bool  # False: they keep still; together else


def tolerance(frames: Array) -> float:
    """The distance, m, within which vertices of frames (F, n, 3) are where a rigid motion takes them."""
    return TOLERANCE * float(np.linalg.norm(np.ptp(frames[0], axis=0)))


def residuals(frames: Array, seed: NDArray[np.integer[Any]]) -> Array:
    """How far each vertex of frames (F, n, 3) is at most from where the rigid motion of some of them takes it, (n,), m.
    """
    own = frames[:, seed]
    middle = own.mean(axis=1, keepdims=True)
    u, _, v = np.linalg.svd(np.einsum("fki,kj->fij", own - middle, own[0] - middle[0]))
    u[:, :, 2] *= np.sign(np.linalg.det(u @ v))[:, None]
    there = np.einsum("fij,nj->fni", u @ v, frames[0] - middle[0]) + middle
    gaps: Array = np.linalg.norm(frames - there, axis=2).max(axis=0)
    return gaps


def moves_as(frames: Array) -> str:
    """How a mesh with frames (F, n, 3) moves: "still", "rigid" or "moves"."""
    near = tolerance(frames)
    if np.linalg.norm(frames - frames[0], axis=2).max() <= near:
        return "still"
    return "rigid" if residuals(frames, np.arange(frames.shape[1])).max() <= near else "moves"


def held(frames: Array, triangles: Indices) -> list[Held]:
    """The groups of vertices of frames (F, n, 3) that something holds; none where that would be most of them."""
    if len(frames) < FEWEST:
        return []
    near = tolerance(frames)
    still = np.linalg.norm(frames - frames[0], axis=2).max(axis=0) <= near
    found = [Held(np.flatnonzero(still).astype(np.int32), False)] if still.any() else []
    left = ~still
    few = frames[np.unique(np.linspace(0, len(frames) - 1, FEW_FRAMES).astype(int))]
    for seed in seeds(triangles, len(left)):
        if not left[seed].all():
            continue
        group: NDArray[np.integer[Any]] = seed
        for slack in (SEED_SLACK, 1.0, 1.0):
            group = np.flatnonzero(left & (residuals(few, group) <= slack * near))
            if len(group) < FEWEST:
                break
        else:
            group = group[residuals(frames, group)[group] <= near]
            if len(group) >= FEWEST:
                found.append(Held(group.astype(np.int32), True))
                left[group] = False
    found += [Held(group, True) for group in shifted(frames, left, near)]
    left[np.concatenate([np.zeros(0, np.int32), *(each.vertices for each in found)])] = False
    every = [*found, *(Held(group, True) for group in on_lines(frames, left, near))]
    few = (groups for groups in (every, found) if sum(len(each.vertices) for each in groups) <= frames.shape[1] // 2)
    return next(few, [])


def seeds(triangles: Indices, count: int) -> Iterator[Indices]:
    """Three vertices at a time: along the boundary, then triangles from all over the mesh."""
    sides = any_sides(triangles)
    once = sides.edge[np.bincount(sides.first, minlength=len(sides.edge))[sides.first] == 1]
    next_to: dict[int, list[int]] = {}
    for a, b in once.tolist():
        next_to.setdefault(a, []).append(b)
        next_to.setdefault(b, []).append(a)
    along = [[ends[0], vertex, ends[1]] for vertex, ends in next_to.items() if len(ends) == 2]
    for every in (np.array(along, np.int32).reshape(-1, 3), triangles):
        yield from every[:: max(1, -(-len(every) // MOST_SEEDS))]


def on_lines(frames: Array, left: Flags, near: float) -> Iterator[Indices]:
    """Groups of the vertices that are left, each of which moves on a line of its own, and all by one pace in time, as
    shape keys and drawn curtains do.
    """
    own = np.flatnonzero(left)
    ways = np.swapaxes(frames - frames[0], 0, 1)[own]
    paces, sizes, _ = np.linalg.svd(ways, full_matrices=False)
    straight = sizes[:, 1] <= near
    while straight.any():
        pace = paces[np.argmax(np.where(straight, sizes[:, 0], 0.0)), :, 0]
        other = ways - pace[:, None] * np.einsum("f,nfi->ni", pace, ways)[:, None]
        group = straight & (np.linalg.norm(other, axis=2).max(axis=1) <= near)
        straight &= ~group
        if group.sum() >= FEWEST:
            yield own[group].astype(np.int32)


def shifted(frames: Array, left: Flags, near: float) -> list[Indices]:
    """Groups of two or more of the vertices that are left, which do not turn, wherever they are."""
    from scipy.spatial import KDTree

    own = np.flatnonzero(left)
    ways = (frames - frames[0])[:, own]
    few = ways[np.unique(np.linspace(0, len(ways) - 1, FEW_FRAMES).astype(int))]
    pairs = KDTree(np.swapaxes(few, 0, 1).reshape(len(own), 3 * len(few))).query_pairs(near, output_type="ndarray")
    pairs = pairs[[bool((np.linalg.norm(ways[:, a] - ways[:, b], axis=1) <= near).all()) for a, b in pairs]]
    label = connected_components(pairs, len(own))
    return [own[label == k].astype(np.int32) for k in np.unique(label[pairs.reshape(-1)])]
