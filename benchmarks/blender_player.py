"""What Blender makes of files: `python blender_player.py JOBS.json`, by a Python that has Blender as a module (bpy).

A job is an object with `out`, where the positions (frames, n, 3) go, in Blender's axes, and either

    "cloth": mesh.npz, "script": blender.py, "fps": 50, "frames": 101     what the cloth modifier does after the script
    "glb": motion.glb, "fps": 50, "times": [0.0, …]                       a file as it is imported and played

It stands alone: Blender's Python is another than that of clothfit.
"""

from __future__ import annotations

import json
import sys
from pathlib import Path
from typing import Any

import bpy  # type: ignore[import-not-found]
import numpy as np


def evaluated(owner: Any) -> Any:
    """Positions (n, 3) of an object in the world, as it is now."""
    found = owner.evaluated_get(bpy.context.evaluated_depsgraph_get())
    mesh = found.to_mesh()
    points = np.empty(3 * len(mesh.vertices), np.float32)
    mesh.vertices.foreach_get("co", points)
    found.to_mesh_clear()
    matrix = np.array(found.matrix_world)
    return points.reshape(-1, 3).astype(float) @ matrix[:3, :3].T + matrix[:3, 3]


def emptied(fps: float) -> Any:
    """An empty scene at a rate."""
    bpy.ops.wm.read_factory_settings(use_empty=True)
    scene = bpy.context.scene
    scene.render.fps, scene.render.fps_base = round(fps), round(fps) / fps
    return scene


def simulated(job: dict[str, Any]) -> Any:
    """A mesh, set up by an exported script, from its first frame on."""
    scene = emptied(job["fps"])
    scene.frame_start, scene.frame_end = 1, job["frames"]
    with np.load(job["cloth"]) as arrays:
        positions, triangles = arrays["positions"].tolist(), arrays["triangles"].tolist()
    mesh = bpy.data.meshes.new("cloth")
    mesh.from_pydata(positions, [], triangles)
    owner = bpy.data.objects.new("cloth", mesh)
    scene.collection.objects.link(owner)
    bpy.context.view_layer.objects.active = owner
    text = Path(job["script"]).read_text("utf-8")
    exec(compile(text, "blender.py", "exec"), {"__name__": "__main__"})
    (modifier,) = owner.modifiers
    modifier.point_cache.frame_end = job["frames"]
    found = []
    for frame in range(1, job["frames"] + 1):
        scene.frame_set(frame)
        found.append(evaluated(owner))
    return np.array(found)


def imported(job: dict[str, Any]) -> Any:
    """The mesh of a file at some times."""
    scene = emptied(job["fps"])
    bpy.ops.import_scene.gltf(filepath=job["glb"])
    (owner,) = (each for each in scene.objects if each.type == "MESH")
    found = []
    for time in job["times"]:
        place = round(time * job["fps"], 6)
        scene.frame_set(int(place), subframe=place - int(place))
        found.append(evaluated(owner))
    return np.array(found)


if __name__ == "__main__":
    for each in json.loads(Path(sys.argv[1]).read_text("utf-8")):
        np.save(each["out"], simulated(each) if "cloth" in each else imported(each))
