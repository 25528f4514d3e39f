"""Write the files `arm` with Blender as a Python module: `python make_skeleton.py`, with bpy 4.2 installed.

An arm of two bones, the lower one below the upper one, on an armature that is turned and moved. Both bones turn, and
the upper one moves, over ten frames at 25 a second. `arm.json` has what Blender says of them: the matrix of each bone
in the world, z up, at each frame.
"""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import bpy  # type: ignore[import-not-found]

FRAMES = 11
FOLDER = Path(__file__).parent


def arm() -> Any:
    """The armature with its bones."""
    made = bpy.data.objects.new("arm", bpy.data.armatures.new("arm"))
    bpy.context.scene.collection.objects.link(made)
    bpy.context.view_layer.objects.active = made
    bpy.ops.object.mode_set(mode="EDIT")
    upper = made.data.edit_bones.new("upper")
    upper.head, upper.tail = (0.2, 0.0, 1.4), (0.5, 0.1, 1.2)
    lower = made.data.edit_bones.new("lower")
    lower.head, lower.tail, lower.parent = upper.tail, (0.8, 0.0, 1.0), upper
    bpy.ops.object.mode_set(mode="POSE")
    made.rotation_euler, made.location = (0.1, -0.2, 0.7), (1.0, 0.5, 0.25)
    return made


def animate(made: Any) -> None:
    """Turn the bones, and move the upper one."""
    for bone in made.pose.bones:
        bone.rotation_mode = "XYZ"
    for frame in range(1, FRAMES + 1):
        share = (frame - 1) / (FRAMES - 1)
        upper, lower = made.pose.bones["upper"], made.pose.bones["lower"]
        upper.rotation_euler, upper.location = (0.9 * share, 0.2 * share, -0.4 * share**2), (0.0, 0.1 * share, 0.05)
        lower.rotation_euler = (-0.3, 0.0, 1.2 * share)
        for bone in (upper, lower):
            bone.keyframe_insert("rotation_euler", frame=frame)
        upper.keyframe_insert("location", frame=frame)


def recorded(made: Any) -> dict[str, Any]:
    """The matrices of the bones in the world."""
    found: dict[str, Any] = {bone.name: [] for bone in made.pose.bones}
    for frame in range(1, FRAMES + 1):
        bpy.context.scene.frame_set(frame)
        for bone in made.pose.bones:
            matrix = made.matrix_world @ bone.matrix
            found[bone.name].append([[round(value, 9) for value in row] for row in matrix])
    return {"times": [(frame - 1) / 25 for frame in range(1, FRAMES + 1)], "bones": found}


def main() -> None:
    """Write the files."""
    bpy.ops.wm.read_factory_settings(use_empty=True)
    scene = bpy.context.scene
    scene.render.fps, scene.frame_start, scene.frame_end = 25, 1, FRAMES
    made = arm()
    animate(made)
    (FOLDER / "arm.json").write_text(json.dumps(recorded(made)) + "\n", encoding="ascii")
    bpy.ops.object.mode_set(mode="OBJECT")
    bpy.ops.export_scene.gltf(
        filepath=str(FOLDER / "arm.glb"), export_format="GLB", export_animations=True, export_anim_slide_to_zero=True,
        export_skins=True,
    )  # fmt: skip
    bpy.ops.wm.usd_export(filepath=str(FOLDER / "arm.usdc"), export_animation=True, export_armatures=True)


if __name__ == "__main__":
    main()
