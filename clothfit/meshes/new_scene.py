"""From a mesh to a whole scene, without the editor: one cloth, spheres, wind, how to simulate it and what to fit.

First the scene and its text; then how the cloth is woven and divided, from what the mesh and the user say; then which
vertices are meant, those that do not move or a region: in a box, at a side of the scene's axes (right, top and front
are where x, y and z are largest), or by numbers.

Families of springs follow the texture coordinates where the mesh has some: u along the cloth, v across it. Garments are
unfolded into their patterns for that, so these are the directions of the cloth. The families are written only where
they are not those that the scene would show anyway.
"""

from __future__ import annotations

import io
import json
import math
import os
from collections.abc import Mapping, Sequence
from dataclasses import replace
from functools import partial
from typing import TYPE_CHECKING, Any

import numpy as np
import numpy.typing as npt

from clothfit.base.arrays import Array, Flags, Indices
from clothfit.base.errors import InvalidInput
from clothfit.base.messages import meant
from clothfit.formats.animation import unused
from clothfit.meshes.mesh import Mesh, object_document
from clothfit.scene.cloth import ELSEWHERE, sphere_document, vector_document
from clothfit.scene.families import FAMILIES, families_of
from clothfit.scene.kinds import AIR, AUTO, CLOTH_KINDS, EDITORS, INTEGRATORS, KIND, KINDS, LETTERED, PLATE, SCENE_KINDS
from clothfit.scene.mesh_numbering import FIELD, NAME
from clothfit.scene.scene import Scene, load

if TYPE_CHECKING:
    from clothfit.fabric.fabric import Woven
    from clothfit.fabric.presets import Preset


def new_scene(
    mesh: Mesh,
    fixed: npt.ArrayLike | None = None,
    *,
    density: float = 0.2,
    stiffness: float = 50.0,
    bending: bool | float = True,
    damping: float = 0.1,
    drag: float | None = None,
    drag_law: str = EDITORS,
    fit: str = "nF",
    fits: Mapping[str, str] | None = None,
    spheres: Sequence[Sequence[float]] = (),
    wind: Sequence[float] = (0.0, 0.0, 0.0),
    integrator: str = "bdf2",
    delta: float = 0.02,
    frames: int = 100,
    tolerance: float = 1e-8,
    title: str = "scene",
    numbering: Indices | None = None,
    warp: Sequence[float] | None = None,
    regions: Mapping[str, npt.ArrayLike] | None = None,
    colliders: Sequence[Mapping[str, Any]] = (),
    name: str | None = None,
    fabric: Preset | None = None,
) -> Scene:
    """Make a scene of one cloth, with the springs and masses that the editor would give it.

    `fixed` (n,) marks the vertices that do not move (default: none). `density` is in kg/m², `stiffness` E in N/m.
    `bending` is True for the editor's bending springs, False for none, or their share of E. `damping` and `drag` are
    those of the file; without `drag` it is 0.1, or in the `drag_law` "air" that of a plate, 1.2. `fit` is two letters,
    for masses and stiffnesses: n keeps them, F fits one factor on what is there, R one per family and region, M a
    smooth map, G one value for all, L one each; `fits` gives the letters of other kinds, such as {"wind": "G"}; or
    `fit` is "auto", and a fit chooses by itself; spheres then have friction. Spheres are (x, y, z, radius), m. `wind`
    is in m/s, the time step `delta` in s. A cloth that the editor is to play needs the `integrator` "implicit",
    "symplectic" or "explicit" and the `drag_law` "editor". A fit compares `frames` frames. `tolerance` is that of the
    linear solver, relative. `numbering` (vertices of the mesh before welding,) is `Welded.vertices`. `warp` is the
    direction along the cloth, which else is that of the mesh's texture coordinates; `regions` gives the vertices of
    named regions, which come before the parts of the mesh. `colliders` are others than spheres, as the file has them;
    `name` is that of the mesh, in a file with several. `fabric` is a real one, of `clothfit.fabric.presets`: what is
    known of it takes the place of `density`, `stiffness` and `bending`. Raises InvalidInput when no scene can be made.
    """
    if isinstance(mesh, (str, os.PathLike)):
        path = os.fspath(mesh)
        raise InvalidInput(f"mesh: a path is given, {path!r}; read it: clothfit.read_mesh({path!r})")
    _check(density=density, stiffness=stiffness, bending=float(bending))
    held = np.zeros(len(mesh.positions), bool) if fixed is None else fixed
    if integrator not in INTEGRATORS:
        raise InvalidInput(f"integrator: there is no {integrator!r}; use {', '.join(INTEGRATORS)}")
    if drag is None:
        drag = PLATE if drag_law == AIR else 0.1
    own, whole = _flags(fits or {})
    auto = fit == AUTO
    if auto and (own or whole):
        raise InvalidInput("fit: auto chooses what to fit by itself; leave the others out")
    made = None
    if fabric is not None:
        density = fabric.density or density
        made = _woven(mesh, held, density, stiffness, fabric, warp)
    cloth = object_document(
        mesh, held, density=density, stiffness=stiffness, damping=damping, drag=drag, settings="nn" if auto else fit,
        bending=bending,
    )
    if made is not None:
        cloth |= {"springs": made.ends.reshape(-1).tolist(), "springStiffness": made.stiffness.tolist(),
                  "springRestLength": made.rest.tolist()}  # fmt: skip
    if drag_law != EDITORS:
        cloth["dragLaw"] = drag_law
    cloth |= fields(mesh, np.array(cloth["springs"], np.int32).reshape(-1, 2), warp, regions or {})
    if own:
        cloth["fit"] = own
    if numbering is not None:
        cloth[FIELD] = numbering.tolist()
    if name is not None:
        cloth[NAME] = name
    document: dict[str, Any] = {
        "integrationMethod": INTEGRATORS.index(integrator),
        "delta": delta,
        "tolerance": tolerance,
        "optimizationIterations": frames,
        "objects": [cloth],
        "colliders": [
            dict(each) | ({"friction": KIND["friction"].neutral[0]} if auto else {})
            for each in (*map(sphere_document, spheres), *colliders)
        ],
        "windVel": vector_document(wind),
        "printTimes": False,
        "forwardSubSteps": 1 if made is None or integrator != "bdf2" else 2,  # one leaves out what their push does
        "title": title,
    }
    if whole or auto:
        document["fit"] = whole or AUTO
    return replace(load(io.StringIO(text(document))), name=title)


def _woven(
    mesh: Mesh, held: npt.ArrayLike, density: float, stiffness: float, fabric: Preset, warp: Sequence[float] | None
) -> Woven | None:
    """The springs of a real fabric; None where neither its stretch nor its bending is known."""
    from clothfit.fabric.fabric import woven

    stretch, bend = fabric.full("stretch"), fabric.full("bending")
    if stretch is None and bend is None:
        return None
    given = np.asarray(warp, float) if warp is not None else None if mesh.texture is None else along(mesh)
    own = stretch or (stiffness,) * 3
    return woven(mesh.positions, mesh.triangles, density, own, bend or (0.0,) * 3, np.asarray(held, bool), given)


def joined(scenes: Sequence[Scene], touching: Mapping[str, Any] | None = None) -> Scene:
    """The first of some scenes, with the objects of all, which may touch each other. Raises InvalidInput."""
    if len(scenes) == 1 and not touching:
        return scenes[0]
    first, *others = (json.loads(each.source.text) for each in scenes)
    first["objects"] += [cloth for each in others for cloth in each["objects"]]
    if touching:
        first["selfCollision"] = dict(touching)
    return replace(load(io.StringIO(text(first))), name=scenes[0].name)


def _check(**values: float) -> None:
    for name, value in values.items():
        least = "above 0" if name == "density" else "at least 0"
        if not (math.isfinite(value) and value >= 0) or (least == "above 0" and not value):
            raise InvalidInput(f"{name} must be {least} and finite; {value:g} was given")


def _flags(fits: Mapping[str, str]) -> tuple[dict[str, str], dict[str, str]]:
    """What to fit besides masses and stiffnesses: the fields `fit` of the object and of the scene."""
    left_out = (*LETTERED, "path", "shift", "gusts", "friction", "contact", "offset")  # of what a new scene lacks
    others = [kind for kind in KINDS if kind.name not in left_out]
    for name, mode in fits.items():
        if name not in [kind.name for kind in others]:
            known = [*LETTERED, *(kind.name for kind in others)]
            raise InvalidInput(f"fit: there is no {name!r}; use two letters, or {', '.join(known)}{meant(name, known)}")
        if mode not in KIND[name].modes:
            raise InvalidInput(f"fit: {name} cannot be fitted as {mode!r}; use {' or '.join(KIND[name].modes)}")
    asked = [(kind, fits[kind.name]) for kind in others if kind.name in fits]
    own = {kind.field: mode for kind, mode in asked if kind in CLOTH_KINDS}
    return own, {kind.field: mode for kind, mode in asked if kind in SCENE_KINDS}


def text(document: dict[str, Any]) -> str:
    """Write a scene, its fields in their order."""
    compact = partial(json.dumps, separators=(",", ":"))
    fields = [[f'  "{name}": {compact(value)}' for name, value in cloth.items()] for cloth in document["objects"]]
    objects = ", ".join("{\n" + ",\n".join(lines) + "\n}" for lines in fields)
    values = {name: f"[{objects}]" if name == "objects" else compact(value) for name, value in document.items()}
    return "{\n" + ",\n".join(f'"{name}": {value}' for name, value in values.items()) + "\n}\n"


SIDES = {"left": (0, -1), "right": (0, 1), "bottom": (1, -1), "top": (1, 1), "back": (2, -1), "front": (2, 1)}
"""Axis and direction of each side."""

SIDE_DEPTH = 1e-3
"""The depth of a side, as a share of the mesh's extent."""


def in_box(positions: Array, corner: Sequence[float], opposite: Sequence[float]) -> Flags:
    """Which of the positions (n, 3) lie in the box between two corners, m, or on its surface."""
    low, high = np.minimum(corner, opposite), np.maximum(corner, opposite)
    return np.asarray(np.all((positions >= low) & (positions <= high), axis=1))


def at_side(positions: Array, side: str, reach: float | None = None, option: str = "fix side") -> Flags:
    """Which of the positions (n, 3) lie at a side of all of them, one of SIDES, within `reach`, m (default: a
    thousandth of their extent). Raises InvalidInput when there is no such side; `option` is its name in messages.
    """
    if side not in SIDES:
        raise InvalidInput(f"{option}: there is no {side!r}; use {', '.join(SIDES)}")
    axis, sign = SIDES[side]
    depth = sign * positions[:, axis]
    extent = float(np.ptp(depth))
    if not extent:
        raise InvalidInput(f"{option}: the mesh is flat along {'xyz'[axis]}, so its {side} is all of it; name another")
    if reach is not None and not 0 <= reach < np.inf:
        raise InvalidInput(f"{option}: the reach must be at least 0 and finite; {reach:g} m was given")
    return np.asarray(depth >= depth.max() - (SIDE_DEPTH * extent if reach is None else reach))


def listed(count: int, ranges: Sequence[tuple[int, int]], option: str = "fix vertices") -> Flags:
    """Which of `count` vertices are in the ranges, both ends included. Raises InvalidInput when one does not exist."""
    chosen = np.zeros(count, bool)
    for first, last in ranges:
        if not 0 <= first <= last < count:
            wrong = last if last >= count else first
            raise InvalidInput(f"{option}: vertex {wrong} does not exist (the mesh has vertices 0 to {count - 1})")
        chosen[first : last + 1] = True
    return chosen


FLAT = 1e-9
"""Sine of the angle at a corner of a triangle in the texture below which it has no area there."""


def fields(
    mesh: Mesh, springs: Indices, warp: Sequence[float] | None, regions: Mapping[str, npt.ArrayLike]
) -> dict[str, Any]:
    """The fields `warp`, `regions` and `families` of the object of a mesh, those that are needed. Raises InvalidInput.
    """
    made: dict[str, Any] = {}
    if warp is not None:
        vector = np.asarray(warp, float)
        if vector.shape != (3,) or not np.isfinite(vector).all() or not vector.any():
            raise InvalidInput(f"warp: {list(warp)} is not a direction; give three finite numbers that are not all 0")
        made["warp"] = vector_document(vector.tolist())
    named = _regions(mesh, regions)
    if named:
        made["regions"] = [{"name": name, "vertices": own.tolist()} for name, own in named.items()]
    if warp is None and mesh.texture is not None:
        own, shown = (families_of(mesh.positions, mesh.triangles, springs, given) for given in (along(mesh), None))
        used, family = np.unique(own, return_inverse=True)
        if not np.array_equal(own, shown):
            made["families"] = {"names": [FAMILIES[k] for k in used], "springs": family.tolist()}
    return made


def along(mesh: Mesh) -> Array:
    """The direction (T, 3) in which u grows in each triangle, 0 where nobody knows."""
    if mesh.texture is None:
        return np.zeros((len(mesh.triangles), 3))
    at = mesh.positions[mesh.triangles]
    first, second = at[:, 1] - at[:, 0], at[:, 2] - at[:, 0]
    (a, b), (c, d) = (mesh.texture[:, 1] - mesh.texture[:, 0]).T, (mesh.texture[:, 2] - mesh.texture[:, 0]).T
    area = a * d - b * c
    with np.errstate(invalid="ignore", over="ignore"):
        size = np.hypot(a, b) * np.hypot(c, d)
        good = np.isfinite(area) & (np.abs(area) > FLAT * size)
        u = (first * d[:, None] - second * b[:, None]) * np.sign(area)[:, None]  # dP/du · |area|
    return np.where((good & np.isfinite(u).all(axis=1))[:, None], u, 0.0)


def _regions(mesh: Mesh, given: Mapping[str, npt.ArrayLike]) -> dict[str, Indices]:
    """The vertices of each region: those that are given, then the parts of the mesh. Raises InvalidInput."""
    made: dict[str, Indices] = {}
    for name, vertices in given.items():
        own = np.unique(np.asarray(vertices)).astype(np.int64)
        if not name.strip() or name == ELSEWHERE:
            raise InvalidInput(f"region: {name!r} cannot be a name; give another one")
        if not len(own):
            raise InvalidInput(f"region: {name!r} has no vertices")
        if not 0 <= own[0] <= own[-1] < len(mesh.positions):
            wrong = int(own[0] if own[0] < 0 else own[-1])
            raise InvalidInput(f"region: {name!r}: there is no vertex {wrong}; there are {len(mesh.positions)}")
        made[name] = own.astype(np.int32)
    for name, vertices in mesh.parts:
        if name not in given and len(vertices) < len(mesh.positions):  # one may have come to be all of it
            made[unused(name, [*made, ELSEWHERE])] = vertices
    return made
