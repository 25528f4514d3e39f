"""Set the values that clothfit found on the active object: masses, stiffnesses, pins of its cloth modifier.

In Blender: select the mesh, open this file in the text editor, and run it. The mesh must have the vertices of the
scene in their order. OBJECT says which object of the scene it is.
"""

import json
from collections.abc import Iterable
from typing import Any

import bpy  # type: ignore[import-not-found]

OBJECT = 0
DATA: dict[str, Any] = json.loads("{}")


def modifier_of(mesh: Any) -> Any:
    """The cloth modifier of an object, made where there is none."""
    for modifier in mesh.modifiers:
        if modifier.type == "CLOTH":
            return modifier
    return mesh.modifiers.new(name="Cloth", type="CLOTH")


def paint(mesh: Any, name: str, weights: Iterable[tuple[int, float]]) -> Any:
    """Make a vertex group anew, with weights by vertex; returns its name."""
    old = mesh.vertex_groups.get(name)
    if old is not None:
        mesh.vertex_groups.remove(old)
    made = mesh.vertex_groups.new(name=name)
    for vertex, weight in weights:
        made.add([vertex], weight, "REPLACE")
    return made.name


def set_up(mesh: Any, values: dict[str, Any], frames_per_second: float) -> None:
    """Set everything on one object."""
    if mesh is None or mesh.type != "MESH" or len(mesh.data.vertices) != values["vertices"]:
        raise RuntimeError(f"select the mesh of object {values['object']}: it has {values['vertices']} vertices")
    settings = modifier_of(mesh).settings
    settings.time_scale = 1.0 / (frames_per_second * DATA["time_unit"])
    settings.mass = values["mass"]
    settings.air_damping = values["air_damping"]
    settings.bending_model = "ANGULAR"
    if values["pin"]:
        settings.vertex_group_mass = paint(mesh, "clothfit pin", [(vertex, 1.0) for vertex in values["pin"]])
    structural = values["structural"]
    if structural:
        name = paint(mesh, "clothfit structural", enumerate(structural["weights"]))
        settings.vertex_group_structural_stiffness = name
        settings.vertex_group_shear_stiffness = name
        for kind in ("tension", "compression", "shear"):
            setattr(settings, f"{kind}_stiffness", structural["stiffness"])
            setattr(settings, f"{kind}_stiffness_max", structural["stiffness_max"])
            setattr(settings, f"{kind}_damping", values["spring_damping"])
    bending = values["bending"]
    if bending:
        settings.vertex_group_bending = paint(mesh, "clothfit bending", enumerate(bending["weights"]))
        settings.bending_stiffness = bending["stiffness"]
        settings.bending_stiffness_max = bending["stiffness_max"]


if __name__ == "__main__":
    rendering = bpy.context.scene.render
    set_up(bpy.context.active_object, DATA["objects"][OBJECT], rendering.fps / rendering.fps_base)
