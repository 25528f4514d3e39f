"""What a fit has found, in Blender: its motion, its values, its stiffnesses as colours."""

import runpy

import bpy

from . import files
from .command import Failed
from .making import frames, rate

COLOURS = "clothfit stiffness"
APART = 1.2
"""Widths of the cloth between it and the object that plays the result."""


def needed(path):
    """A path that must be there. Raises Failed."""
    if not path.exists():
        raise Failed(f"{path.name} does not exist; fit first")
    return path


def play(context, thing, paths):
    """An object beside the cloth that plays the fitted motion; the one that there is, or a new one."""
    name = f"{thing.name} fitted"
    made = bpy.data.objects.get(name)
    if made is None:
        made = bpy.data.objects.new(name, thing.data.copy())
        (thing.users_collection[0] if thing.users_collection else context.scene.collection).objects.link(made)
        made.location.x = APART * max(thing.dimensions.x, 0.1)
        made.modifiers.new("Clothfit", "MESH_CACHE")
    cache = made.modifiers["Clothfit"]
    cache.cache_format = "PC2"
    cache.filepath = str(needed(paths.motion))
    cache.forward_axis, cache.up_axis = "POS_Z", "NEG_Y"  # what this modifier calls files with y up
    scale = max(files.samples(paths.motion) - 1, 1) / max(frames(context) - 1, 1)  # a fit may take shorter steps
    # frame f shows sample scale f - frame_start, which is to be 0 at the first frame
    cache.frame_scale, cache.frame_start = scale, scale * context.scene.frame_start
    return made


def apply(context, thing, paths):
    """Set the cloth modifier of the object from the exported values."""
    script = runpy.run_path(str(needed(paths.values / "blender.py")), run_name="clothfit_values")
    try:
        script["set_up"](thing, script["DATA"]["objects"][0], rate(context, thing))
    except RuntimeError as error:
        raise Failed(str(error)) from error


def colour(thing, paths):
    """Colour the vertices by the stiffness of their springs, in a colour attribute that the viewport can show."""
    values = files.vertex_stiffness(needed(paths.fitted))
    mesh = thing.data
    if len(values) != len(mesh.vertices):
        raise Failed(f"the fitted scene has {len(values)} vertices, the mesh {len(mesh.vertices)}")
    attribute = mesh.color_attributes.get(COLOURS) or mesh.color_attributes.new(COLOURS, "FLOAT_COLOR", "POINT")
    attribute.data.foreach_set("color", files.colours(values).astype("f").ravel())
    mesh.color_attributes.active_color = attribute
    mesh.update()
