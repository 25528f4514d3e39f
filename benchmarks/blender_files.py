"""Opens motion files in Blender: `python blender_files.py JOB.json`, by a Python that has Blender as a module (bpy).

A job has `obj`, the mesh of the first frame; `pc2`, `mdd`, `usd`, `glb`, files of its motion; `objs`, files of every
frame; `fps`, `frames` and `out`, the .npz of what is found: the positions (frames, n, 3) in the world, and of the
caches and OBJ files also in the mesh's own axes.
"""

from __future__ import annotations

import json
import sys
from pathlib import Path
from typing import Any

import bpy  # type: ignore[import-not-found]
import numpy as np

sys.path.insert(0, str(Path(__file__).resolve().parents[1] / "clothfit" / "simulators"))  # it is no package there
from blender_player import points, world  # type: ignore[import-not-found]


def emptied(job: dict[str, Any]) -> Any:
    """An empty scene."""
    bpy.ops.wm.read_factory_settings(use_empty=True)
    scene = bpy.context.scene
    scene.render.fps, scene.frame_start, scene.frame_end = job["fps"], 0, job["frames"] - 1
    return scene


def the_mesh(scene: Any) -> Any:
    """The one mesh of a scene."""
    (owner,) = (each for each in scene.objects if each.type == "MESH")
    return owner


def played(scene: Any, owner: Any, frames: int, first: int = 0) -> tuple[Any, Any]:
    """The positions of all frames, in its own axes and in the world."""
    own, found = [], []
    for frame in range(first, first + frames):
        scene.frame_set(frame)
        own.append(points(owner))
        found.append(world(owner, own[-1]))
    return np.array(own), np.array(found)


def cached(job: dict[str, Any], kind: str) -> tuple[Any, Any]:
    """A point cache on the mesh of the OBJ file."""
    scene = emptied(job)
    bpy.ops.wm.obj_import(filepath=job["obj"])
    owner = the_mesh(scene)
    modifier = owner.modifiers.new("cache", "MESH_CACHE")
    modifier.cache_format, modifier.filepath, modifier.frame_start = kind.upper(), job[kind], 0
    return played(scene, owner, job["frames"])


def imported(job: dict[str, Any], kind: str) -> Any:
    """A file of a scene."""
    scene = emptied(job)
    if kind == "usd":
        bpy.ops.wm.usd_import(filepath=job[kind])
    else:
        bpy.ops.import_scene.gltf(filepath=job[kind])
    return played(scene, the_mesh(scene), job["frames"])[1]


def sequence(job: dict[str, Any]) -> tuple[Any, Any]:
    """The meshes of OBJ files, one by one."""
    own, found = [], []
    for path in job["objs"]:
        scene = emptied(job)
        bpy.ops.wm.obj_import(filepath=path)
        owner = the_mesh(scene)
        own.append(points(owner))
        found.append(world(owner, own[-1]))
    return np.array(own), np.array(found)


if __name__ == "__main__":
    job = json.loads(Path(sys.argv[1]).read_text("utf-8"))
    made: dict[str, Any] = {}
    for kind in ("pc2", "mdd"):
        made[f"{kind}_own"], made[kind] = cached(job, kind)
    for kind in ("usd", "glb"):
        made[kind] = imported(job, kind)
    made["obj_own"], made["obj"] = sequence(job)
    np.savez(job["out"], **made)
