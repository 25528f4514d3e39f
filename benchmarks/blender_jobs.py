"""What Blender makes of files: `python blender_jobs.py JOBS.json`, by a Python that has Blender as a module (bpy).

A job is an object with `out`, where the positions (frames, n, 3) go, in Blender's axes, and either

    "cloth": mesh.npz, "script": blender.py, "fps": 50, "frames": 101     what the cloth modifier does after the script
    "glb": motion.glb, "fps": 50, "times": [0.0, …]                       a file as it is imported and played

Blender's Python is another than that of clothfit, of which it takes only the player, which stands alone.
"""

from __future__ import annotations

import json
import sys
from pathlib import Path
from typing import Any

import bpy  # type: ignore[import-not-found]
import numpy as np

sys.path.insert(0, str(Path(__file__).resolve().parents[1] / "clothfit" / "simulators"))  # it is no package there
from blender_player import emptied, from_the_first, mesh_of, placed, run  # type: ignore[import-not-found]


def simulated(job: dict[str, Any]) -> Any:
    """A mesh, set up by an exported script that is run as a user would run it, from its first frame on."""
    scene = emptied(job["fps"], job["frames"])
    owner = mesh_of(job["cloth"], scene)
    run(job["script"], "__main__")
    return from_the_first(scene, owner, job["frames"])


def imported(job: dict[str, Any]) -> Any:
    """The mesh of a file at some times."""
    scene = emptied(job["fps"], len(job["times"]))
    bpy.ops.import_scene.gltf(filepath=job["glb"])
    (owner,) = (each for each in scene.objects if each.type == "MESH")
    found = []
    for time in job["times"]:
        place = round(time * job["fps"], 6)
        scene.frame_set(int(place), subframe=place - int(place))
        found.append(placed(owner))
    return np.array(found)


if __name__ == "__main__":
    for each in json.loads(Path(sys.argv[1]).read_text("utf-8")):
        np.save(each["out"], simulated(each) if "cloth" in each else imported(each))
