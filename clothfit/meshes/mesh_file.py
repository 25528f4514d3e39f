"""A mesh from another tool's file, in the scene's axes: the first frame of what the file holds, with its triangles."""

from __future__ import annotations

import os
from collections.abc import Sequence

import numpy as np

from clothfit.base.arrays import Array
from clothfit.base.errors import InvalidInput
from clothfit.formats import obj
from clothfit.formats.axes import Axes, facing, to_scene
from clothfit.formats.registry import foreign, module_of, suffix_of
from clothfit.meshes.mesh import Mesh

FARTHEST_VERTEX = 1e9
"""m from the origin, where a position is no longer known to a micrometre."""

MESHES = (".obj", ".glb", ".ply", ".usd", ".usda", ".usdc")
"""Suffixes of files that hold triangles."""


def read_mesh(
    path: str | os.PathLike[str],
    up: str | None = None,
    handedness: str | None = None,
    scale: float | None = None,
) -> tuple[Mesh, tuple[str, ...]]:
    """Read a mesh into the scene's axes and metres; returns it with sentences on what was assumed.

    Vertices keep the file's order. `up` ("y", "z"), `handedness` ("left", "right") and `scale`, m per unit, replace
    what the file or its format says. Raises InvalidInput when the file holds no mesh or cannot be read.
    """
    name = os.fspath(path)
    suffix, found = suffix_of(name), foreign(name)
    if found is None or suffix not in MESHES:
        raise InvalidInput(f"{name}: meshes are not read from files of that suffix; known are {', '.join(MESHES)}")
    if scale is not None and not 0 < scale < np.inf:
        raise InvalidInput(f"scale must be above 0 and finite; {scale:g} m was given")
    animation = module_of(found).read(sources(name)[0])
    told = {"up": up, "handedness": handedness, "scale": scale}
    axes: Axes = animation.axes._replace(**{key: value for key, value in told.items() if value is not None})
    if animation.triangles is None or not len(animation.triangles):
        raise InvalidInput(f"{name}: has no faces; a cloth is made of triangles")
    positions = to_scene(np.asarray(animation.positions[0], float), axes)
    near = (np.abs(positions) <= FARTHEST_VERTEX).all(axis=1)  # False for what is no number
    if not near.all():
        wrong = int(near.argmin())
        raise InvalidInput(
            f"{name}: vertex {wrong} has no place within {FARTHEST_VERTEX:g} m of the origin; is the unit right?"
        )
    triangles = np.ascontiguousarray(facing(np.asarray(animation.triangles), axes), np.int32)
    return Mesh(positions, triangles), (f"read as {axes}", *animation.notes)


def sources(path: str) -> list[str]:
    """The files that a name stands for: of a sequence `name_*.obj` all, and of these the first is the mesh."""
    return obj.frames_of(path) if obj.ANY in path and suffix_of(path) == ".obj" else [path]


def turned(positions: Array, degrees: Sequence[float]) -> Array:
    """Positions (n, 3) turned about the scene's axes by angles in degrees, as Unity does: about z, then x, then y."""
    x, y, z = np.radians(np.asarray(degrees, float))
    about_x = [[1, 0, 0], [0, np.cos(x), -np.sin(x)], [0, np.sin(x), np.cos(x)]]
    about_y = [[np.cos(y), 0, np.sin(y)], [0, 1, 0], [-np.sin(y), 0, np.cos(y)]]
    about_z = [[np.cos(z), -np.sin(z), 0], [np.sin(z), np.cos(z), 0], [0, 0, 1]]
    turn = np.array(about_y) @ np.array(about_x) @ np.array(about_z)
    found: Array = positions @ turn.T
    return found
