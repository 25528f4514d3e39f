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


def points(owner: Any) -> Any:
    """The vertices (n, 3) of an object as it is now, in its own axes, as Blender keeps them."""
    found = owner.evaluated_get(bpy.context.evaluated_depsgraph_get())
    mesh = found.to_mesh()
    held = np.empty(3 * len(mesh.vertices), np.float32)
    mesh.vertices.foreach_get("co", held)
    found.to_mesh_clear()
    return held.reshape(-1, 3)


def world(owner: Any, own: Any) -> Any:
    """The same in the world."""
    matrix = np.array(owner.evaluated_get(bpy.context.evaluated_depsgraph_get()).matrix_world)
    return own.astype(float) @ matrix[:3, :3].T + matrix[:3, 3]


def placed(owner: Any) -> Any:
    """Positions (n, 3) of an object in the world, as it is now."""
    return world(owner, points(owner))


def emptied(fps: float, frames: int) -> Any:
    """An empty scene with frames at a rate."""
    bpy.ops.wm.read_factory_settings(use_empty=True)
    scene = bpy.context.scene
    rate = max(1, round(fps))
    scene.render.fps, scene.render.fps_base = rate, rate / fps
    scene.frame_start, scene.frame_end = 1, frames
    return scene


def mesh_of(path: str, scene: Any) -> Any:
    """The mesh of a file, the active object of the scene."""
    with np.load(path) as arrays:
        positions, triangles = arrays["positions"].tolist(), arrays["triangles"].tolist()
    mesh = bpy.data.meshes.new("cloth")
    mesh.from_pydata(positions, [], triangles)
    owner = bpy.data.objects.new("cloth", mesh)
    scene.collection.objects.link(owner)
    bpy.context.view_layer.objects.active = owner
    return owner


def run(script: str, name: str) -> dict[str, Any]:
    """Run a script as a module of a name; its names."""
    space: dict[str, Any] = {"__name__": name}
    exec(compile(Path(script).read_text("utf-8"), "blender.py", "exec"), space)
    return space


def from_the_first(scene: Any, owner: Any, frames: int) -> Any:
    """The motion (frames, n, 3) of a mesh with one modifier, a cloth, from its first frame on."""
    (modifier,) = owner.modifiers
    modifier.point_cache.frame_end = frames
    found = []
    for frame in range(1, frames + 1):
        scene.frame_set(frame)
        found.append(placed(owner))
    return np.array(found)


def played(job: dict[str, Any]) -> Any:
    """The motion (frames, n, 3) of a job."""
    scene = emptied(job["fps"], job["frames"])
    owner = mesh_of(job["mesh"], scene)
    space = run(job["script"], "script")
    space["set_up"](owner, job.get("values") or space["DATA"]["objects"][0], job["fps"])
    return from_the_first(scene, owner, job["frames"])


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
