"""A mesh from another tool's file, in the scene's axes: the first frame of what the file holds, with its triangles."""

from __future__ import annotations

import os
from collections.abc import Sequence

import numpy as np

from clothfit.base.arrays import Array
from clothfit.base.errors import InvalidInput
from clothfit.formats import obj
from clothfit.formats.axes import Convention, facing, to_scene
from clothfit.formats.registry import foreign, mistaken, read, suffix_of
from clothfit.meshes.mesh import Mesh

FARTHEST_VERTEX = 1e9
"""m from the origin; a float64 position farther away is no longer exact to a micrometre."""

MESHES = (".obj", ".glb", ".gltf", ".ply", ".stl", ".abc", ".usd", ".usda", ".usdc")
"""Suffixes of the formats that can hold triangles."""


def read_mesh(
    path: str | os.PathLike[str], up: str | None = None, handedness: str | None = None, scale: float | None = None
) -> tuple[Mesh, tuple[str, ...]]:
    """Read a mesh into the scene's axes and metres; returns it with sentences on what was assumed.

    Vertices keep the file's order; texture coordinates and named parts come with them. `up` ("y", "z"), `handedness`
    ("left", "right") and `scale`, m per unit, replace what the file or its format says. Raises InvalidInput when the
    file holds no mesh or cannot be read.
    """
    name = os.fspath(path)
    suffix, found = suffix_of(name), foreign(name)
    if found is not None and suffix not in MESHES:
        raise InvalidInput(f"{name}: {found.name} hold no faces; a mesh is needed, in {', '.join(MESHES)}")
    if found is None:
        known = f"no mesh format has that suffix; known are {', '.join(MESHES)}; export it as one"
        raise InvalidInput(f"{name}: {mistaken(name, suffix) or known}")
    convention = Convention(scale, up, handedness)
    animation = read(found, sources(name)[0])
    axes = convention.axes(animation.axes)
    if animation.triangles is None or not len(animation.triangles):
        raise InvalidInput(f"{name}: has no faces; a cloth is made of triangles")
    positions = to_scene(np.asarray(animation.positions[0], float), axes)
    near = (np.abs(positions) <= FARTHEST_VERTEX).all(axis=1)  # False for NaN
    if not near.all():
        wrong = int(near.argmin())
        raise InvalidInput(
            f"{name}: vertex {wrong} is not within {FARTHEST_VERTEX:g} m of the origin; is the unit right?"
        )
    triangles = np.ascontiguousarray(facing(np.asarray(animation.triangles), axes), np.int32)
    order = facing(np.arange(3, dtype=np.int32)[None], axes)[0]
    texture = None if animation.texture is None else animation.texture[:, order]
    return Mesh(positions, triangles, texture, animation.parts), (f"read as {axes}", *animation.notes)


def sources(path: str) -> list[str]:
    """The files of a name: of a sequence `name_*.obj` all, the first of which is the mesh."""
    return obj.frames_of(path) if obj.ANY in path and suffix_of(path) == ".obj" else [path]


def turned(positions: Array, degrees: Sequence[float]) -> Array:
    """Positions (n, 3) turned about the scene's axes by angles in degrees, as Unity does: about z, then x, then y."""
    x, y, z = np.radians(np.asarray(degrees, float))
    about_x = [[1, 0, 0], [0, np.cos(x), -np.sin(x)], [0, np.sin(x), np.cos(x)]]
    about_y = [[np.cos(y), 0, np.sin(y)], [0, 1, 0], [-np.sin(y), 0, np.cos(y)]]
    about_z = [[np.cos(z), -np.sin(z), 0], [np.sin(z), np.cos(z), 0], [0, 0, 1]]
    turn = np.array(about_y) @ np.array(about_x) @ np.array(about_z)
    return np.asarray(positions @ turn.T)
