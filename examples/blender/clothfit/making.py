"""From an object of Blender to a scene and a target of clothfit."""

import os
from pathlib import Path

import bpy
import numpy as np

from . import files
from .command import Failed

HELD = 0.5
"""Weight in the pin group from which a vertex is held."""


class Paths:
    """The files of an object, in the folder that its settings name."""

    def __init__(self, thing):
        folder = thing.clothfit.folder
        if folder.startswith("//") and not bpy.data.filepath:
            raise Failed("save the file first, or choose another folder: the folder is relative to it")
        self.folder = Path(os.path.normpath(bpy.path.abspath(folder)))
        stem = bpy.path.clean_name(thing.name)
        self.mesh, self.scene = self.folder / f"{stem}.obj", self.folder / f"{stem}.json"
        self.fitted, self.target = self.folder / f"{stem}.fitted.json", self.folder / f"{stem}.target.pc2"
        self.motion, self.values = self.folder / f"{stem}.fitted.pc2", self.folder / f"{stem}.values"


def points(mesh, matrix):
    """Vertices (n, 3) of a mesh in the world, m."""
    flat = np.empty(3 * len(mesh.vertices), np.float32)
    mesh.vertices.foreach_get("co", flat)
    own = np.array(matrix, float)
    return flat.reshape(-1, 3) @ own[:3, :3].T + own[:3, 3]


def held(thing):
    """Numbers of the vertices that the cloth modifier pins."""
    modifier = next((each for each in thing.modifiers if each.type == "CLOTH"), None)
    group = thing.vertex_groups.get(modifier.settings.vertex_group_mass) if modifier else None
    if group is None:
        return []
    weights = [(v.index, g.weight) for v in thing.data.vertices for g in v.groups if g.group == group.index]
    return [index for index, weight in weights if weight >= HELD]


def write_mesh(thing, path):
    """Write the mesh of an object as it is without modifiers."""
    path.parent.mkdir(parents=True, exist_ok=True)
    faces = [tuple(face.vertices) for face in thing.data.polygons]
    files.write_obj(path, points(thing.data, thing.matrix_world), faces)


def record(context, thing, count):
    """Positions (frames, n, 3) of an object in all frames of the scene, with its modifiers. Raises Failed."""
    scene, before, found = context.scene, context.scene.frame_current, []
    try:
        for frame in range(scene.frame_start, scene.frame_end + 1):
            scene.frame_set(frame)
            seen = thing.evaluated_get(context.evaluated_depsgraph_get())
            mesh = seen.to_mesh()
            found.append(points(mesh, seen.matrix_world))
            seen.to_mesh_clear()
    finally:
        scene.frame_set(before)
    if {len(each) for each in found} != {count}:
        raise Failed(f"{thing.name} has {len(found[0])} vertices where the cloth has {count}; no modifier may add any")
    return np.array(found)


def rate(context):
    """Frames per second."""
    return context.scene.render.fps / context.scene.render.fps_base


def frames(context):
    """Frames of the scene."""
    return context.scene.frame_end - context.scene.frame_start + 1


def new_call(context, thing, paths):
    """The call that makes the scene of an object."""
    own = thing.clothfit
    letters = "F" if own.letters == "auto" else own.letters
    call = ["new", str(paths.mesh), "-o", str(paths.scene)]
    call += ["--fps", repr(rate(context)), "--frames", str(frames(context))]
    call += ["--density", repr(own.density), "--stiffness", repr(own.stiffness), "--fit", f"n{letters}"]
    pinned = held(thing)
    call += ["--fix-vertices", files.ranges(pinned)] if pinned else []
    for name in ("damping", "drag"):
        call += ["--fit", name] if getattr(own, name) else []
    return call if own.drag else [*call, "--drag", "0"]


def target(context, thing, paths):
    """The path of the target's motion, and whether it needs the rate of frames; recorded where it is an object's."""
    own = thing.clothfit
    if own.target == "FILE":
        path = bpy.path.abspath(own.path)
        if not own.path:
            raise Failed("choose the file of the target")
        return path, path.lower().endswith((".pc2", ".obj"))
    source = thing if own.target == "OWN" else own.other
    if source is None or source.type != "MESH":
        raise Failed("choose the object of the target, a mesh")
    files.write_pc2(paths.target, record(context, source, len(thing.data.vertices)))
    return str(paths.target), True


def fit_calls(context, thing, paths):
    """All calls of a fit: the scene, the fit, the motion of its result."""
    write_mesh(thing, paths.mesh)
    motion, unknown = target(context, thing, paths)
    estimate = ["estimate", str(paths.scene), "--target", motion, "-o", str(paths.fitted)]
    estimate += ["--fps", repr(rate(context))] if unknown else []
    estimate += ["--model", "auto"] if thing.clothfit.letters == "auto" else []
    estimate += thing.clothfit.options.split()
    return [new_call(context, thing, paths), estimate, ["simulate", str(paths.fitted), "-o", str(paths.motion)]]
