"""The vertex numbers of the mesh that an object of a scene was made from, where welding changed them.

A motion from the tool that drew the mesh has the mesh's vertices. An optional field of the object lists the vertex of
the object that each of them became: in `"meshVertices": [0, 1, 2, 1, -1]` the fourth was joined to the second, and the
fifth left out. The editor keeps the field, as any that it does not know.
"""

from __future__ import annotations

import json
from typing import Any

import numpy as np
import numpy.typing as npt

from clothfit.base.arrays import Indices
from clothfit.base.errors import InvalidScene
from clothfit.scene.scene import Scene

FIELD = "meshVertices"
NAME = "meshName"
"""The name of the mesh, in a file with several."""


def numberings(scene: Scene) -> list[Indices | None]:
    """For each object the vertices (n_mesh,) that those of its mesh became, −1 for none; None where the scene has no
    such field, as both have the same numbers. Raises InvalidScene when a field is invalid.
    """
    if f'"{FIELD}"' not in scene.source.text:  # parsing takes as long as loading
        return [None] * len(scene.cloths)
    objects = json.loads(scene.source.text)["objects"]
    return [_numbering(item.get(FIELD), i, scene) for i, item in enumerate(objects)]


def mesh_names(scene: Scene) -> str:
    """The names of the meshes that the objects were made of, with commas between; empty where one has none."""
    if f'"{NAME}"' not in scene.source.text:
        return ""
    names = [item.get(NAME) for item in json.loads(scene.source.text)["objects"]]
    return ",".join(names) if all(isinstance(name, str) and name.strip() for name in names) else ""


def _complete(scene: Scene) -> list[Indices]:
    """For each object the vertices (n_mesh,) that those of its mesh became, −1 for none."""
    found = zip(numberings(scene), scene.vertex_counts, strict=True)
    return [np.arange(count, dtype=np.int32) if numbering is None else numbering for numbering, count in found]


def picks(scene: Scene) -> Indices | None:
    """For each vertex of the scene the first vertex of the meshes that became it, both numbered through all objects;
    None where nothing was renumbered. Raises InvalidScene as `numberings`.

    Positions (frames, points, 3) of the meshes become those of the scene by `positions[:, picks(scene)]`, if there are
    `sum(mesh_counts(scene))` of them.
    """
    if all(numbering is None for numbering in numberings(scene)):
        return None
    chosen, begin = [], 0
    for own in _complete(scene):
        became, first = np.unique(own, return_index=True)
        chosen.append(begin + first[became >= 0])
        begin += len(own)
    return np.concatenate(chosen).astype(np.int32)


def mesh_counts(scene: Scene) -> tuple[int, ...]:
    """How many vertices each object's mesh has. Raises InvalidScene as `numberings`."""
    return tuple(map(len, _complete(scene)))


def triangles_of(scene: Scene) -> Indices:
    """The faces (T, 3) of all objects of a scene, whose vertices are numbered through."""
    starts = np.cumsum([0, *scene.vertex_counts])
    return np.concatenate([cloth.triangles + start for cloth, start in zip(scene.cloths, starts, strict=False)])


def unwelded(scene: Scene, positions: npt.NDArray[Any]) -> npt.NDArray[Any]:
    """Positions (frames, vertices, 3) of the scene, or other values of its vertices, spread to the vertices of its
    meshes (frames, points, 3); those in no triangle, which were left out, follow their object's first vertex. Raises
    InvalidScene as `numberings`.
    """
    begins = np.cumsum([0, *scene.vertex_counts])
    chosen = [begin + np.maximum(own, 0) for begin, own in zip(begins, _complete(scene), strict=False)]
    return positions[:, np.concatenate(chosen)]


def _numbering(values: Any, index: int, scene: Scene) -> Indices | None:
    if values is None:
        return None
    n = scene.vertex_counts[index]
    whole = isinstance(values, list) and set(map(type, values)) <= {int}
    if not whole or not {*range(n)} <= {*values} <= {*range(-1, n)}:
        place = f"objects[{index}].{FIELD}"
        raise InvalidScene(f"{place}: must be a list that names each of the {n} vertices; remove the field", scene.name)
    return np.array(values, np.int32)
