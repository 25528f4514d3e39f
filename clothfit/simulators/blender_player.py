"""Plays cloths in Blender: a program for a Python that has Blender as a module (bpy), or for Blender itself.

    python blender_player.py            blender --background --python blender_player.py

It reads jobs from standard input, one JSON object a line, and answers each with a line that begins with ANSWER. A job
has `mesh` (a .npz with positions, in Blender's axes, and triangles), `script` (what `clothfit export --to blender`
writes), `values` (those of an object, or none to take the script's own), `fps`, `frames` and `out`, the .npy of the
positions (frames, n, 3). It imports nothing of clothfit.
"""

from __future__ import annotations

import json
import sys
import traceback
from pathlib import Path
from typing import Any

import bpy  # type: ignore[import-not-found]
import numpy as np

ANSWER = "clothfit-blender: "


def placed(owner: Any) -> Any:
    """Positions (n, 3) of an object in the world, as it is now."""
    found = owner.evaluated_get(bpy.context.evaluated_depsgraph_get())
    mesh = found.to_mesh()
    points = np.empty(3 * len(mesh.vertices), np.float32)
    mesh.vertices.foreach_get("co", points)
    found.to_mesh_clear()
    matrix = np.array(found.matrix_world)
    return points.reshape(-1, 3).astype(float) @ matrix[:3, :3].T + matrix[:3, 3]


def emptied(job: dict[str, Any]) -> Any:
    """An empty scene with the frames of a job."""
    bpy.ops.wm.read_factory_settings(use_empty=True)
    scene = bpy.context.scene
    rate = max(1, round(job["fps"]))
    scene.render.fps, scene.render.fps_base = rate, rate / job["fps"]
    scene.frame_start, scene.frame_end = 1, job["frames"]
    return scene


def cloth_of(job: dict[str, Any], scene: Any) -> Any:
    """The mesh of a job, set up by the script."""
    with np.load(job["mesh"]) as arrays:
        positions, triangles = arrays["positions"].tolist(), arrays["triangles"].tolist()
    mesh = bpy.data.meshes.new("cloth")
    mesh.from_pydata(positions, [], triangles)
    owner = bpy.data.objects.new("cloth", mesh)
    scene.collection.objects.link(owner)
    bpy.context.view_layer.objects.active = owner
    space: dict[str, Any] = {"__name__": "script"}
    exec(compile(Path(job["script"]).read_text("utf-8"), "blender.py", "exec"), space)
    values = job.get("values") or space["DATA"]["objects"][0]
    space["set_up"](owner, values, job["fps"])
    return owner


def played(job: dict[str, Any]) -> Any:
    """The motion (frames, n, 3) of a job."""
    scene = emptied(job)
    owner = cloth_of(job, scene)
    (modifier,) = owner.modifiers
    modifier.point_cache.frame_end = job["frames"]
    found = []
    for frame in range(1, job["frames"] + 1):
        scene.frame_set(frame)
        found.append(placed(owner))
    return np.array(found)


def answer(job: dict[str, Any]) -> dict[str, Any]:
    """Do a job; returns what to answer."""
    try:
        np.save(job["out"], played(job))
    except Exception:  # noqa: BLE001  whatever Blender raises is for the one who asked
        return {"fault": traceback.format_exc(limit=2)[-1500:]}
    return {"done": job["out"]}


def main() -> None:
    """Answer until there are no more jobs."""
    print(ANSWER + json.dumps({"version": bpy.app.version_string}), flush=True)
    for line in sys.stdin:
        print("\n" + ANSWER + json.dumps(answer(json.loads(line))), flush=True)


if __name__ == "__main__":
    main()
