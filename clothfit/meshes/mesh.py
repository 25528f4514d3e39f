"""From a triangle mesh to an object of a scene, as the editor builds it: springs, stiffnesses, masses.

The editor walks through the triangles (a, b, c) in order and meets their edges ab, ac, bc; each such meeting is a
*side*. The first side at an edge gives a traction spring along it, the second a bending spring between the two vertices
opposite it, so spring s is side s and every mesh has three springs per triangle. With A the area of a
triangle (m²), L the rest length of the spring (m), E the object's stiffness (N/m) and ρ its density (kg/m²):

    traction  k = E ΣA / L²            over the triangles at the edge
    bending   k = (E/4) 2 A / L²       of the second triangle met
    mass      m = ρ ΣA/3               over the triangles at the vertex

A mesh comes from another tool's file, in the scene's axes: the first frame of what the file holds, with its triangles.

n vertices, T triangles, S springs.
"""

from __future__ import annotations

import os
from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt

from clothfit.base.arrays import Array, Flags, Indices
from clothfit.base.errors import InvalidInput
from clothfit.formats import obj
from clothfit.formats.animation import OtherPoints, Parts
from clothfit.formats.axes import Convention, facing, to_scene
from clothfit.formats.registry import foreign, read_format, suffix_of, wrong_kind
from clothfit.scene import directions
from clothfit.scene.kinds import AIR_DENSITY

BENDING_SHARE = 0.25  # a bending spring's share of the object's stiffness
MOST_PLANE_VERTICES = 1_000_000  # vertices of a plane: the text of a scene with many more is too long to be read again

FARTHEST_VERTEX = 1e9
"""m from the origin; a float64 position farther away is no longer exact to a micrometre."""

MESHES = (".obj", ".glb", ".gltf", ".ply", ".stl", ".abc", ".usd", ".usda", ".usdc")
"""Suffixes of the formats that can hold triangles."""


class Mesh(NamedTuple):
    """A triangle mesh."""

    positions: Array  # (n, 3), m
    triangles: Indices  # (T, 3), corners
    texture: Array | None = None  # (T, 3, 2), texture coordinates u, v of the corners; NaN unknown
    parts: Parts = ()  # names and vertices of its parts, such as groups and materials

    def __repr__(self) -> str:
        size = np.ptp(self.positions, axis=0) if len(self.positions) else np.zeros(3)
        extent = " × ".join(f"{side:.3g}" for side in size)
        return f"<Mesh: {len(self.positions)} vertices, {len(self.triangles)} triangles, {extent} m>"


class Sides(NamedTuple):
    """The sides ab, ac, bc of each triangle in turn, 3 T in all."""

    edge: Indices  # (3 T, 2), the ends, the smaller index first
    opposite: Indices  # (3 T,), the triangle's third corner
    first: Indices  # (3 T,), the side that met the same edge first: itself, at the first meeting


class Springs(NamedTuple):
    """The springs of an object."""

    ends: Indices  # (S, 2), vertices, the smaller index first
    stiffness: Array  # (S,), N/m
    bends: Flags  # (S,), joins the vertices opposite an edge; False: lies along an edge


class Shape(NamedTuple):
    """A mesh of a file over time."""

    mesh: Mesh  # at its first frame
    times: Array | None  # (F,), s, as the file counts them; None: it has no times
    frames: Array  # (F, n, 3), m; of a scan the first alone
    pins: Indices | None  # vertices that the file marks as held
    notes: tuple[str, ...]  # sentences on what was assumed


def read_mesh(
    path: str | os.PathLike[str], up: str | None = None, handedness: str | None = None, scale: float | None = None
) -> tuple[Mesh, tuple[str, ...]]:
    """Read a mesh into the scene's axes and metres; returns it with sentences on what was assumed.

    Vertices keep the file's order; texture coordinates and named parts come with them. `up` ("y", "z"), `handedness`
    ("left", "right") and `scale`, m per unit, replace what the file or its format says. Raises InvalidInput when the
    file holds no mesh or cannot be read.
    """
    found = read_shape(sources(os.fspath(path))[0], up, handedness, scale)
    return found.mesh, found.notes


def read_shape(
    path: str | os.PathLike[str], up: str | None = None, handedness: str | None = None, scale: float | None = None,
    wanted: str = "",
) -> Shape:  # fmt: skip
    """The same with its motion; of several meshes those that are `wanted`, by names with commas between."""
    name = os.fspath(path)
    suffix, found = suffix_of(name), foreign(name)
    if found is not None and suffix not in MESHES:
        raise InvalidInput(f"{name}: {found.name} hold no faces; a mesh is needed, in {', '.join(MESHES)}")
    if found is None:
        known = f"no mesh format has that suffix; known are {', '.join(MESHES)}; export it as one"
        raise InvalidInput(f"{name}: {wrong_kind(name, suffix) or known}")
    convention = Convention(scale, up, handedness)
    try:
        animation = read_format(found, name, wanted)
    except OtherPoints:  # a scan, of which the first frame counts
        animation = read_format(found, sources(name)[0], wanted)
    axes = convention.axes(animation.axes)
    if animation.triangles is None or not len(animation.triangles):
        raise InvalidInput(f"{name}: has no faces; a cloth is made of triangles")
    frames = last_seen(to_scene(np.asarray(animation.positions, float), axes))
    positions = frames[0]
    near = (np.abs(positions) <= FARTHEST_VERTEX).all(axis=1)  # False for NaN
    if not near.all():
        wrong = int(near.argmin())
        if np.isnan(positions[wrong]).any():
            raise InvalidInput(f"{name}: vertex {wrong} has no position (NaN) in the first frame; export that again")
        raise InvalidInput(
            f"{name}: vertex {wrong} is not within {FARTHEST_VERTEX:g} m of the origin; is the unit right?"
        )
    triangles = np.ascontiguousarray(facing(np.asarray(animation.triangles), axes), np.int32)
    order = facing(np.arange(3, dtype=np.int32)[None], axes)[0]
    texture = None if animation.texture is None else animation.texture[:, order]
    mesh = Mesh(positions, triangles, texture, animation.parts)
    return Shape(mesh, animation.times, frames, animation.pins, (f"read as {axes}", *animation.notes))


def sources(path: str) -> list[str]:
    """The files of a name: of a sequence `name_*.obj` all, the first of which is the mesh."""
    return obj.frames_of(path) if obj.ANY in path and suffix_of(path) == ".obj" else [path]


def last_seen(frames: Array) -> Array:
    """Frames (F, n, 3) in which a vertex that was not seen, NaN, is where it was seen last, and NaN before."""
    missing = np.asarray(np.isnan(frames).any(axis=2))
    if not missing[1:].any():
        return frames
    frame = np.maximum.accumulate(np.where(missing, 0, np.arange(len(frames))[:, None]), axis=0)
    return np.take_along_axis(frames, frame[..., None], axis=0)


def turned(positions: Array, degrees: Sequence[float]) -> Array:
    """Positions (n, 3) turned about the scene's axes by angles in degrees, as Unity does: about z, then x, then y."""
    x, y, z = np.radians(np.asarray(degrees, float))
    about_x = [[1, 0, 0], [0, np.cos(x), -np.sin(x)], [0, np.sin(x), np.cos(x)]]
    about_y = [[np.cos(y), 0, np.sin(y)], [0, 1, 0], [-np.sin(y), 0, np.cos(y)]]
    about_z = [[np.cos(z), -np.sin(z), 0], [np.sin(z), np.cos(z), 0], [0, 0, 1]]
    turn = np.array(about_y) @ np.array(about_x) @ np.array(about_z)
    return np.asarray(positions @ turn.T)


LONGEST_SIDE = 1e150
"""The longest side of a plane, m: its area is a number."""


def plane(divisions: int, width: float, height: float | None = None, upright: bool = False) -> Mesh:
    """Make a rectangle of width × height, m, centred at the origin; a square when no height is given.

    The longer side has divisions + 2 vertices, the shorter as many as keep the cells nearest to squares. The vertex
    in column i along x and row j along z (in y when upright) has index columns · j + i.
    Raises InvalidInput when `divisions` is negative, a side is not above 0 or too long for numbers, or there would be a
    million vertices.
    """
    height = width if height is None else height
    if divisions < 0 or not (0 < width <= LONGEST_SIDE and 0 < height <= LONGEST_SIDE):
        raise InvalidInput(f"a plane of {divisions} divisions, {width:g} by {height:g} m: nothing can be made of that")
    cells = divisions + 1
    across, along = (max(1, round(cells * side / max(width, height))) for side in (width, height))
    if (count := (across + 1) * (along + 1)) > MOST_PLANE_VERTICES:
        raise InvalidInput(
            f"a plane of {divisions} divisions would have {count} vertices; it may have at most {MOST_PLANE_VERTICES}"
        )
    second, first = np.meshgrid(_axis(along, height), _axis(across, width), indexing="ij")
    zero = np.zeros_like(first)
    axes = (first, second, zero) if upright else (first, zero, second)
    return Mesh(np.stack(axes, axis=-1).reshape(-1, 3), _cells(across, along))


def _axis(cells: int, length: float) -> Array:
    return (np.arange(cells + 1) / cells - 0.5) * length


def _cells(across: int, along: int) -> Indices:
    """Triangles (2 · across · along, 3) of a grid of cells, column by column as in the editor's planes."""
    i, j = np.meshgrid(np.arange(across), np.arange(along), indexing="ij")
    columns = across + 1
    a = columns * j + i
    b = a + columns
    c, d = b + 1, a + 1
    return np.stack([a, b, c, a, c, d], axis=-1).reshape(-1, 3).astype(np.int32)


def areas(mesh: Mesh) -> Array:
    """Areas (T,) of the triangles, m²."""
    a, b, c = (mesh.positions[mesh.triangles[:, corner]] for corner in range(3))
    normal = np.cross(b - a, c - a)
    return np.asarray(0.5 * np.sqrt((normal * normal).sum(axis=1)))


def sides(triangles: Indices) -> Sides:
    """List the sides of the triangles (T, 3) in the order in which the editor meets them.

    Raises InvalidInput when more than two triangles share an edge, as the result of the editor is not known then.
    """
    met = any_sides(triangles)
    meetings = np.bincount(met.first)
    if len(meetings) and meetings.max() > 2:
        a, b = met.edge[meetings.argmax()]
        raise InvalidInput(f"{meetings.max()} triangles share the edge between vertices {a} and {b}; at most 2 can")
    return met


def any_sides(triangles: Indices) -> Sides:
    """The same for any triangles, of which more than two may share an edge."""
    edge = np.sort(triangles[:, [[0, 1], [0, 2], [1, 2]]].reshape(-1, 2), axis=1)
    _, found, group = np.unique(directions.keys(edge), return_index=True, return_inverse=True)
    return Sides(edge, triangles[:, [2, 1, 0]].reshape(-1), found[group].astype(np.int32))


def edges(triangles: Indices) -> Indices:
    """Ends (E, 2) of the edges of the triangles (T, 3), each once, in the order in which the editor meets them."""
    met = sides(triangles)
    return np.asarray(met.edge[met.first == np.arange(len(met.first))])


def springs(mesh: Mesh, stiffness: float, bending: bool | float = True) -> Springs:
    """Make the springs of an object of stiffness E, N/m.

    `bending` is True for the editor's bending springs, False for none, or their share of E. Raises InvalidInput
    when a spring would have no length, or more than two triangles share an edge.
    """
    share = BENDING_SHARE if bending is True else float(bending)
    ends, area, bends = stretched(sides(mesh.triangles), areas(mesh), share)
    strength = stiffness * area
    chosen = np.full(len(bends), True) if share else ~bends
    ends, strength, bends = ends[chosen], strength[chosen], bends[chosen]
    e = mesh.positions[ends[:, 0]] - mesh.positions[ends[:, 1]]
    length2 = (e * e).sum(axis=1)
    if not length2.all():
        a, b = ends[length2.argmin()]
        raise InvalidInput(f"vertices {a} and {b} need a spring but are at the same place; weld or move them")
    return Springs(ends, strength / length2, bends)


def stretched(met: Sides, area: Array, share: float) -> tuple[Indices, Array, Flags]:
    """Of each side: the ends (2,) of a spring, the area that it stands for, m², and whether it bends. It runs along the
    side where that is the first at its edge, else across the edge. `area` (T,) are those of the triangles, of which
    bending springs stand for a `share`.
    """
    bends = met.first != np.arange(len(met.first))
    across = np.sort(np.stack([met.opposite, met.opposite[met.first]], axis=1), axis=1)
    each = np.repeat(area, 3)
    traction = np.bincount(met.first, weights=each, minlength=len(each))
    return np.where(bends[:, None], across, met.edge), np.where(bends, share * 2 * each, traction), bends


def masses(mesh: Mesh, density: float) -> Array:
    """Masses (n,), kg, of the vertices of a cloth of this density, kg/m².

    Raises InvalidInput when a vertex would have no mass.
    """
    mass = np.zeros(len(mesh.positions))
    np.add.at(mass, mesh.triangles, density * areas(mesh)[:, None] / 3)
    if not mass.all():
        raise InvalidInput(f"vertex {mass.argmin()} has no mass, being in no triangle that has an area; remove it")
    return mass


def air_drag(mesh: Mesh, speed: float) -> float:
    """The `dragCoefficient`, kg/(m^6 s), with which air of this speed, m/s, pushes the mesh as real air would.

    Real air pushes a face of area A with ½ ϱ c A v², the format with drag · A · (2 A)² · v. The two are equal for one
    area and one speed: drag = ϱ c v / (8 A²), with ϱ = 1.2 kg/m³, c = 1 and the median area. Raises InvalidInput where
    that is not finite.
    """
    area = float(np.median(areas(mesh))) if len(mesh.triangles) else 0.0
    drag = AIR_DENSITY * speed / (8 * area * area) if area * area > 0 else np.inf
    if not 0 <= drag < np.inf:
        raise InvalidInput(f"drag: faces of {area:g} m² in air of {speed:g} m/s have no coefficient; give a number")
    return drag


def object_document(
    mesh: Mesh,
    fixed: npt.ArrayLike,
    *,
    density: float,
    stiffness: float,
    damping: float = 0.0,
    drag: float = 0.0,
    settings: str = "nn",
    bending: bool | float = True,
) -> dict[str, Any]:
    """Make an object of a scene file, with the names and the order of fields that the editor writes.

    `fixed` (n,) marks the vertices that do not move. `density` is in kg/m², `stiffness` in N/m; `damping`, `drag` and
    `settings` are the file's `damping`, `dragCoefficient` and `optimizationSettings`; `bending` is as in `springs`.
    Raises InvalidInput when no object can be made of the mesh or `fixed` does not fit it.
    """
    held = np.asarray(fixed, dtype=np.bool_)
    if held.shape != (len(mesh.positions),):
        raise InvalidInput(f"fixed: {held.size} values for {len(mesh.positions)} vertices; one each is needed")
    made = springs(mesh, stiffness, bending)
    return {
        "vertPos": [{"x": x, "y": y, "z": z} for x, y, z in mesh.positions.tolist()],
        "vertIsFixed": held.tolist(),
        "vertMass": masses(mesh, density).tolist(),
        "springs": made.ends.reshape(-1).tolist(),
        "springStiffness": made.stiffness.tolist(),
        "triangles": mesh.triangles.reshape(-1).tolist(),
        "dragCoefficient": drag,
        "damping": damping,
        "optimizationSettings": settings,
    }
