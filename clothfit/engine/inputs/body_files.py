"""The meshes of colliders, from their scene or from files: checked, joined at seams, and as surfaces for the forces.

A mesh must be closed, so that it has an inside: each edge is a side of two triangles, which walk it in opposite ways.
Vertices at one place, as files have them where a texture jumps, count as one. Where all triangles face inward, all are
turned.
"""

from __future__ import annotations

from collections.abc import Sequence
from functools import lru_cache
from typing import Any, NamedTuple

import numpy as np

from clothfit.base.arrays import Array, Flags, Indices
from clothfit.base.errors import InvalidInput, InvalidScene
from clothfit.base.messages import counted
from clothfit.engine.forces.bodies import Surface
from clothfit.engine.inputs.files import loaded, stamp_of
from clothfit.engine.inputs.interpolation import growth, resolved
from clothfit.meshes.mesh import Mesh, areas, read_mesh
from clothfit.meshes.problems import THIN, tiny, together
from clothfit.scene.cloth import Body, Collider
from clothfit.scene.directions import along, edges_of


class Moving(NamedTuple):
    """A closed mesh in the axes of its collider, and its vertices over time where it has a motion of its own."""

    surface: Surface
    file_vertices: int  # vertices before those at one place were joined
    times: Array  # (K,), s; empty where it has none
    frames: Array  # (K, V, 3), m
    motion: str = ""  # the field of the scene that has it, for messages


def body_of(collider: Collider) -> Moving:
    """The mesh of a collider. Raises InvalidScene, with the place, where it is none or cannot be read."""
    body = collider.body
    assert body is not None
    try:
        if body.file is None:
            kept, surface = closed(inline(body))
        else:
            kept, surface = from_file(body.file, tuple(sorted(body.said.items())), stamp_of(body.file))
        count = len(body.positions) if body.file is None else len(kept)
    except InvalidScene:
        raise
    except InvalidInput as error:
        raise InvalidScene(f"{body.place}: {error}") from None
    surface = surface._replace(place=surface.place * collider.size)
    first = np.flatnonzero(kept)
    if collider.scaling:
        keys = resolved(collider.scaling)  # between two of them its vertices move as the scale changes
        grown = growth(keys, keys.times)[:, None] * surface.place
        return Moving(surface, count, keys.times, grown, keys.place)
    if body.motion is None:
        return Moving(surface, count, np.zeros(0), np.zeros((0, *surface.place.shape)))
    own = loaded(body.motion)
    if own.values.ndim != 3 or own.values.shape[1] != count:
        have = f"{own.values.shape[1]} points" if own.values.ndim == 3 else "one signal"
        raise InvalidScene(f"{body.motion.place}.file: has {have} for the {count} vertices of the mesh")
    frames = own.values[:, first] * collider.size
    for k, frame in enumerate(frames):
        flat = without_area(frame, surface.triangles)
        if len(flat):
            raise InvalidScene(f"{body.motion.place}.file: frame {k}: triangle {flat[0]} of the mesh has no area")
    return Moving(surface._replace(place=frames[0]), count, own.times, frames, body.motion.place)


def inline(body: Body) -> Mesh:
    """The mesh in a scene. Raises InvalidScene."""
    wrong = np.flatnonzero(body.triangles.reshape(-1) >= len(body.positions))
    if len(wrong):
        vertex = body.triangles.reshape(-1)[wrong[0]]
        said = f"{vertex} is no vertex; there are {len(body.positions)}, counted from 0"
        raise InvalidScene(f"{body.place}.triangles[{wrong[0]}]: {said}")
    return Mesh(body.positions, body.triangles.astype(np.int32))


@lru_cache(maxsize=8)
def from_file(path: str, said: tuple[tuple[str, Any], ...], _stamp: Any) -> tuple[Flags, Surface]:
    """The mesh in a file that has this stamp. Raises InvalidInput."""
    mesh, _ = read_mesh(path, **dict(said))
    try:
        return closed(mesh)
    except InvalidInput as error:
        raise InvalidInput(f"{path}: {error}") from None


def closed(mesh: Mesh) -> tuple[Flags, Surface]:
    """Which vertices of a mesh are left once those at one place are joined, (n,), and the surface that they make.
    Raises InvalidInput where it is not closed.
    """
    if not len(mesh.triangles):
        raise InvalidInput("has no triangles")
    flat = without_area(mesh.positions, mesh.triangles)
    if len(flat):
        raise InvalidInput(f"triangle {flat[0]} has no area ({counted(len(flat), 'such triangle', 'such triangles')})")
    lot = together(mesh.positions, tiny(mesh))
    triangles = lot[mesh.triangles]
    a, b, c = triangles.T
    collapsed = np.flatnonzero((a == b) | (b == c) | (a == c))
    if len(collapsed):
        raise InvalidInput(f"triangle {collapsed[0]} has two corners at one place")
    across = neighbours(triangles)
    kept = np.zeros(len(mesh.positions), bool)
    kept[triangles] = True
    number = np.cumsum(kept, dtype=np.int32) - 1
    surface = Surface(mesh.positions[kept], number[triangles], across)
    corners = surface.place[surface.triangles] - surface.place.mean(axis=0)
    if np.linalg.det(corners).sum() < 0.0:  # six times the volume: the sides AB, BC, CA become AC, CB, BA
        surface = surface._replace(triangles=surface.triangles[:, [0, 2, 1]], across=across[:, [2, 1, 0]])
    return kept, surface


def without_area(place: Array, triangles: Indices) -> Indices:
    """The triangles that have only the area that rounding gives them."""
    corner = place[triangles]
    side = corner - np.roll(corner, 1, axis=1)
    longest = (side * side).sum(axis=2).max(axis=1, initial=0.0)
    found: Indices = np.flatnonzero(~(areas(Mesh(place, triangles)) > THIN * longest)).astype(np.int32)
    return found


def neighbours(triangles: Indices) -> Indices:
    """The triangle behind the sides AB, BC and CA of each, (T, 3). Raises InvalidInput where that is not one."""
    met = edges_of(triangles)
    of = met.of[:, [2, 0, 1]].reshape(-1)  # of AB, BC, CA; there side k is opposite corner k
    ways = np.bincount(met.of.reshape(-1), along(triangles).reshape(-1), len(met.uses))
    sides = "edge is a side", "edges are sides"
    for wrong, words, fault in (
        (met.uses == 1, sides, "is not closed: {} of one triangle only"),
        (met.uses > 2, sides, "{} of more than two triangles"),
        (ways != 1, ("edge", "edges"), "at {} two triangles face opposite ways"),
    ):
        if wrong.any():
            first = "between vertices {} and {}".format(*met.ends[np.flatnonzero(wrong)[0]])
            raise InvalidInput(f"{fault.format(counted(int(wrong.sum()), *words))}, the first {first}")
    pairs = np.argsort(of, kind="stable").reshape(-1, 2)
    other = np.empty(len(of), np.int32)
    other[pairs] = pairs[:, ::-1]
    return (other // 3).reshape(-1, 3)


def bodies_of(colliders: Sequence[Collider]) -> list[Moving]:
    """The meshes among some colliders, in order. Raises InvalidScene."""
    return [body_of(each) for each in colliders if each.body]
