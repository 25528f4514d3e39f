"""Write the files of this folder with Blender as a Python module: `python make.py`, with bpy 4.2 installed.

A sheet of 3 × 3 vertices, x and y in 0 … 1, of four quads. A shape key adds x y in z, by a weight from 0 to 1 over five
frames at 25 a second. The sheet is scaled, turned by a quarter about z and moved; its parent moves along x by 1 m over
the same frames. The tests compute where its vertices are.
"""

import json
from pathlib import Path
from typing import Any

import bpy  # type: ignore[import-not-found]

FRAMES, ARM_FRAMES = 5, 11
FOLDER = Path(__file__).parent


def linear(owner: Any) -> None:
    """Straight lines between the keys of an object."""
    for curve in owner.animation_data.action.fcurves:
        for key in curve.keyframe_points:
            key.interpolation = "LINEAR"


def sheet() -> Any:
    """The sheet, its shape key and its parent."""
    corners = [(x / 2, y / 2, 0.0) for y in range(3) for x in range(3)]
    quads = [(3 * y + x, 3 * y + x + 1, 3 * y + x + 4, 3 * y + x + 3) for y in range(2) for x in range(2)]
    mesh = bpy.data.meshes.new("sheet")
    mesh.from_pydata(corners, [], quads)
    texture = mesh.uv_layers.new(name="UV")
    for loop in mesh.loops:
        texture.data[loop.index].uv = corners[loop.vertex_index][:2]
    found = bpy.data.objects.new("sheet", mesh)
    bpy.context.scene.collection.objects.link(found)
    found.shape_key_add(name="Basis")
    key = found.shape_key_add(name="raised")
    for vertex, (x, y, _) in enumerate(corners):
        key.data[vertex].co = (x, y, x * y)
    for frame in (1, FRAMES):
        key.value = (frame - 1) / (FRAMES - 1)
        key.keyframe_insert("value", frame=frame)
    linear(mesh.shape_keys)
    found.scale, found.rotation_euler, found.location = (1, 2, 0.5), (0, 0, 1.5707963267948966), (1, 2, 3)
    parent = bpy.data.objects.new("parent", None)
    bpy.context.scene.collection.objects.link(parent)
    found.parent = parent
    for frame in (1, FRAMES):
        parent.location = ((frame - 1) / (FRAMES - 1), 0, 0)
        parent.keyframe_insert("location", frame=frame)
    linear(parent)
    return found


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
    for frame in range(1, ARM_FRAMES + 1):
        share = (frame - 1) / (ARM_FRAMES - 1)
        upper, lower = made.pose.bones["upper"], made.pose.bones["lower"]
        upper.rotation_euler, upper.location = (0.9 * share, 0.2 * share, -0.4 * share**2), (0.0, 0.1 * share, 0.05)
        lower.rotation_euler = (-0.3, 0.0, 1.2 * share)
        for bone in (upper, lower):
            bone.keyframe_insert("rotation_euler", frame=frame)
        upper.keyframe_insert("location", frame=frame)


def recorded(made: Any) -> dict[str, Any]:
    """The matrices of the bones in the world."""
    found: dict[str, Any] = {bone.name: [] for bone in made.pose.bones}
    for frame in range(1, ARM_FRAMES + 1):
        bpy.context.scene.frame_set(frame)
        for bone in made.pose.bones:
            matrix = made.matrix_world @ bone.matrix
            found[bone.name].append([[round(value, 9) for value in row] for row in matrix])
    return {"times": [(frame - 1) / 25 for frame in range(1, ARM_FRAMES + 1)], "bones": found}


def empty(frames: int) -> Any:
    """An empty scene of so many frames."""
    bpy.ops.wm.read_factory_settings(use_empty=True)
    scene = bpy.context.scene
    scene.render.fps, scene.frame_start, scene.frame_end = 25, 1, frames
    return scene


def main() -> None:
    """Write all files."""
    empty(ARM_FRAMES)
    made = arm()
    animate(made)
    (FOLDER / "arm.json").write_text(json.dumps(recorded(made)) + "\n", encoding="ascii")
    bpy.ops.object.mode_set(mode="OBJECT")
    bpy.ops.export_scene.gltf(
        filepath=str(FOLDER / "arm.glb"), export_format="GLB", export_animations=True, export_anim_slide_to_zero=True,
        export_skins=True,
    )  # fmt: skip
    bpy.ops.wm.usd_export(filepath=str(FOLDER / "arm.usdc"), export_animation=True, export_armatures=True)
    scene = empty(FRAMES)
    sheet()
    bpy.ops.wm.alembic_export(filepath=str(FOLDER / "sheet.abc"), start=1, end=FRAMES, as_background_job=False)
    for name, keys in (("sheet.usdc", False), ("shape-keys.usdc", True)):
        bpy.ops.wm.usd_export(
            filepath=str(FOLDER / name), export_animation=True, export_materials=False, export_shapekeys=keys
        )
    for suffix, form in (("glb", "GLB"), ("gltf", "GLTF_SEPARATE")):
        bpy.ops.export_scene.gltf(
            filepath=str(FOLDER / f"sheet.{suffix}"), export_format=form, export_normals=False,
            export_morph_normal=False, export_optimize_animation_size=False,
        )  # fmt: skip
    scene.frame_set(1)
    for ascii_format in (True, False):
        name = FOLDER / f"sheet-{'text' if ascii_format else 'binary'}.stl"
        bpy.ops.wm.stl_export(filepath=str(name), ascii_format=ascii_format)


if __name__ == "__main__":
    main()
