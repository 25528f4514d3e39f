"""From a mesh to a whole scene, without the editor: one cloth, spheres, wind, how to simulate it and what to fit."""

from __future__ import annotations

import io
import json
import math
import os
from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any

import numpy as np
import numpy.typing as npt

from clothfit.base.arrays import Indices
from clothfit.base.errors import InvalidInput
from clothfit.meshes import weave
from clothfit.meshes.mesh import Mesh, object_document
from clothfit.scene.cloth import SPHERE
from clothfit.scene.kinds import CLOTH_KINDS, INTEGRATORS, KIND, KINDS, LETTERED, SCENE_KINDS
from clothfit.scene.mesh_numbering import FIELD
from clothfit.scene.scene import Scene, load


def new_scene(
    mesh: Mesh,
    fixed: npt.ArrayLike | None = None,
    *,
    density: float = 0.2,
    stiffness: float = 50.0,
    bending: bool | float = True,
    damping: float = 0.1,
    drag: float = 0.1,
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
) -> Scene:
    """Make a scene of one cloth, with the springs and masses that the editor would give it.

    `fixed` (n,) marks the vertices that do not move (default: none). `density` is in kg/m², `stiffness` E in N/m.
    `bending` is True for the editor's bending springs, False for none, or their share of E. `damping` and `drag` are
    those of the file. `fit` is two letters, for masses and stiffnesses: n keeps them, F fits one factor on what is
    there, R one per family and region, M a smooth map, G one value for all, L one each; `fits` gives the letters of
    other kinds, such as {"wind": "G"}. Spheres are (x, y, z, radius), m. `wind` is in m/s,
    the time step `delta` in s. A cloth that the editor is to play needs the `integrator` "implicit", "symplectic" or
    "explicit". A fit compares `frames` frames. `tolerance` is that of the linear solver, relative.
    `numbering` (vertices of the mesh before welding,) is `Welded.vertices`. `warp` is the direction along the cloth,
    which else is that of the mesh's texture coordinates; `regions` gives the vertices of named regions, which come
    before the parts of the mesh. Raises InvalidInput when no scene can be
    made.
    """
    if isinstance(mesh, (str, os.PathLike)):
        path = os.fspath(mesh)
        raise InvalidInput(f"mesh: a path is given, {path!r}; read it: clothfit.read_mesh({path!r})")
    _check(density=density, stiffness=stiffness, bending=float(bending))
    held = np.zeros(len(mesh.positions), bool) if fixed is None else fixed
    if integrator not in INTEGRATORS:
        raise InvalidInput(f"integrator: there is no {integrator!r}; use {', '.join(INTEGRATORS)}")
    own, whole = _flags(fits or {})
    cloth = object_document(
        mesh, held, density=density, stiffness=stiffness, damping=damping, drag=drag, settings=fit, bending=bending
    )
    cloth |= weave.fields(mesh, np.array(cloth["springs"], np.int32).reshape(-1, 2), warp, regions or {})
    if own:
        cloth["fit"] = own
    if numbering is not None:
        cloth[FIELD] = numbering.tolist()
    document: dict[str, Any] = {
        "integrationMethod": INTEGRATORS.index(integrator),
        "delta": delta,
        "tolerance": tolerance,
        "optimizationIterations": frames,
        "objects": [cloth],
        "colliders": [_sphere(*each) for each in spheres],
        "windVel": _vector(wind),
        "printTimes": False,
        "forwardSubSteps": 1,
        "title": title,
    }
    if whole:
        document["fit"] = whole
    return replace(load(io.StringIO(text(document))), name=title)


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
            raise InvalidInput(f"fit: there is no {name!r}; use two letters, or {', '.join(k.name for k in others)}")
        if mode not in KIND[name].modes:
            raise InvalidInput(f"fit: {name} cannot be fitted as {mode!r}; use {' or '.join(KIND[name].modes)}")
    asked = [(kind, fits[kind.name]) for kind in others if kind.name in fits]
    own = {kind.field: mode for kind, mode in asked if kind in CLOTH_KINDS}
    return own, {kind.field: mode for kind, mode in asked if kind in SCENE_KINDS}


def _sphere(x: float, y: float, z: float, radius: float) -> dict[str, Any]:
    rot, size = _vector((0.0, 0.0, 0.0)), _vector((2 * radius,) * 3)
    return {"type": SPHERE, "pos": _vector((x, y, z)), "rot": rot, "scale": size}


def _vector(xyz: Sequence[float]) -> dict[str, float]:
    x, y, z = map(float, xyz)
    return {"x": x, "y": y, "z": z}


def text(document: dict[str, Any]) -> str:
    """Write a scene, its fields in their order."""
    made = {name: _objects(value) if name == "objects" else _compact(value) for name, value in document.items()}
    lines = [f'"{name}": {value}' for name, value in made.items()]
    return "{\n" + ",\n".join(lines) + "\n}\n"


def _objects(cloths: list[dict[str, Any]]) -> str:
    return "[" + ", ".join("{\n" + ",\n".join(map(_field, cloth.items())) + "\n}" for cloth in cloths) + "]"


def _field(item: tuple[str, Any]) -> str:
    return f'  "{item[0]}": {_compact(item[1])}'


def _compact(value: Any) -> str:
    return json.dumps(value, separators=(",", ":"))
