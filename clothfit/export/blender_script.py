"""Set the values that clothfit found on the active object: masses, stiffnesses, pins of its cloth modifier.

In Blender: select the mesh, open this file in the text editor, and run it. The mesh must have the vertices of the
scene in their order. OBJECT says which object of the scene it is.
"""

import json
from array import array
from collections.abc import Iterable
from typing import Any

import bpy  # type: ignore[import-not-found]

OBJECT = 0
MOST_STEPS = 80  # Blender's limit
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


def single(value: float) -> float:
    """A number as Blender keeps it, in 32 bits."""
    return array("f", [value])[0]


def steps(quality: int, time_scale: float) -> int:
    """The steps that Blender takes in a frame: rounding adds one to some numbers, and the cloth is too fast."""
    end, step = single(time_scale), single(single(1.0 / quality) * single(time_scale))
    time, count = 0.0, 0
    while time < end:
        time, count = single(time + step), count + 1
    return count


def quality_of(frames_per_second: float, time_scale: float) -> int:
    """The fewest steps in a frame that are no longer than the values ask for."""
    fewest = 1
    while fewest < MOST_STEPS and fewest * frames_per_second * DATA["step"] < 1.0 - 1e-6:
        fewest += 1
    exact = [each for each in range(fewest, MOST_STEPS + 1) if steps(each, time_scale) == each]
    return exact[0] if exact else fewest


def set_up(mesh: Any, values: dict[str, Any], frames_per_second: float) -> None:
    """Set everything on one object."""
    if mesh is None or mesh.type != "MESH" or len(mesh.data.vertices) != values["vertices"]:
        raise RuntimeError(f"select the mesh of object {values['object']}: it has {values['vertices']} vertices")
    settings = modifier_of(mesh).settings
    settings.time_scale = 1.0 / (frames_per_second * DATA["time_unit"])
    settings.quality = quality_of(frames_per_second, settings.time_scale)
    settings.mass = values["mass"]
    settings.air_damping = values["air_damping"]
    settings.bending_model = "ANGULAR"
    settings.bending_damping = 0.0  # with Blender's default of 0.5 a light cloth explodes
    if values["pin"]:
        settings.vertex_group_mass = paint(mesh, "clothfit pin", [(vertex, 1.0) for vertex in values["pin"]])
    structural = values["structural"]
    if structural:
        name = paint(mesh, "clothfit structural", enumerate(structural["weights"]))
        settings.vertex_group_structural_stiffness = name
        settings.vertex_group_shear_stiffness = name
        for kind in ("tension", "compression", "shear"):
            own = values.get(kind, structural)  # fitted ones, where there are any; shear is that of tension
            own = values.get("tension", own) if kind == "shear" else own
            setattr(settings, f"{kind}_stiffness", own["stiffness"])
            setattr(settings, f"{kind}_stiffness_max", own["stiffness_max"])
            damping = values.get("tension_damping" if kind == "shear" else f"{kind}_damping", values["spring_damping"])
            setattr(settings, f"{kind}_damping", damping)
    bending = values["bending"] or {"stiffness": 0.0, "stiffness_max": 0.0}
    if "weights" in bending:
        settings.vertex_group_bending = paint(mesh, "clothfit bending", enumerate(bending["weights"]))
    settings.bending_stiffness = bending["stiffness"]
    settings.bending_stiffness_max = bending["stiffness_max"]


if __name__ == "__main__":
    rendering = bpy.context.scene.render
    set_up(bpy.context.active_object, DATA["objects"][OBJECT], rendering.fps / rendering.fps_base)
