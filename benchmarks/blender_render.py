"""Renders a cloth in Blender: `python blender_render.py JOB.json`, by a Python that has Blender as a module (bpy).

A job has `arrays`, a .npz of positions (frames, n, 3) and triangles in Blender's axes; `right`, `up`, `place`, the
camera's unit vectors and place there; `light`, a vector to the light; `wide`, m, what the picture's width shows;
`size`, pixels; `ground` and `cloth`, colours of sRGB; `out`, a name for each frame. Cycles renders it on the processor.
"""

from __future__ import annotations

import json
import sys
from pathlib import Path
from typing import Any

import bpy  # type: ignore[import-not-found]
import numpy as np
from mathutils import Matrix, Vector  # type: ignore[import-not-found]

SAMPLES = 32


def linear(colour: list[float]) -> tuple[float, ...]:
    """A colour of sRGB as Blender computes with it."""
    return (*(c / 12.92 if c <= 0.04045 else ((c + 0.055) / 1.055) ** 2.4 for c in colour), 1.0)


def cloth_of(positions: Any, triangles: Any, colour: list[float], scene: Any) -> Any:
    """A smooth mesh of one colour."""
    mesh = bpy.data.meshes.new("cloth")
    mesh.from_pydata(positions.tolist(), [], triangles.tolist())
    mesh.polygons.foreach_set("use_smooth", np.ones(len(triangles), bool))
    paint = bpy.data.materials.new("cloth")
    paint.use_nodes = True
    shader = next(node for node in paint.node_tree.nodes if node.type == "BSDF_PRINCIPLED")
    shader.inputs["Base Color"].default_value = linear(colour)
    shader.inputs["Roughness"].default_value = 0.9
    mesh.materials.append(paint)
    made = bpy.data.objects.new("cloth", mesh)
    scene.collection.objects.link(made)
    return made


def look(job: dict[str, Any], scene: Any) -> None:
    """Camera and light."""
    right, up = Vector(job["right"]), Vector(job["up"])
    eye = bpy.data.objects.new("camera", bpy.data.cameras.new("camera"))
    eye.data.type, eye.data.sensor_fit, eye.data.ortho_scale = "ORTHO", "HORIZONTAL", job["wide"]
    turned = Matrix((right, up, right.cross(up))).transposed().to_4x4()
    eye.matrix_world = Matrix.Translation(job["place"]) @ turned
    sun = bpy.data.objects.new("sun", bpy.data.lights.new("sun", "SUN"))
    sun.data.energy, sun.data.angle = 3.0, 0.2
    sun.rotation_euler = Vector(job["light"]).to_track_quat("Z", "Y").to_euler()
    for each in (eye, sun):
        scene.collection.objects.link(each)
    scene.camera = eye
    scene.world = bpy.data.worlds.new("world")
    scene.world.use_nodes = True
    ground = scene.world.node_tree.nodes["Background"]
    ground.inputs["Color"].default_value = linear(job["ground"])


def main() -> None:
    """Render all frames."""
    job = json.loads(Path(sys.argv[1]).read_text("utf-8"))
    with np.load(job["arrays"]) as arrays:
        positions, triangles = arrays["positions"], arrays["triangles"]
    bpy.ops.wm.read_factory_settings(use_empty=True)
    scene = bpy.context.scene
    cloth = cloth_of(positions[0], triangles, job["cloth"], scene)
    look(job, scene)
    picture = scene.render
    picture.engine, scene.cycles.device, scene.cycles.samples = "CYCLES", "CPU", SAMPLES
    picture.threads_mode, picture.threads = "FIXED", 1
    picture.resolution_x, picture.resolution_y = job["size"]
    picture.image_settings.file_format, scene.view_settings.view_transform = "PNG", "Standard"
    for frame, name in zip(positions, job["out"], strict=True):
        cloth.data.vertices.foreach_set("co", frame.astype(np.float32).reshape(-1))
        cloth.data.update()
        picture.filepath = name
        bpy.ops.render.render(write_still=True)


if __name__ == "__main__":
    main()
