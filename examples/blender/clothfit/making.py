"""From an object of Blender to a scene and a target of clothfit."""

import os
from pathlib import Path

import bpy
import numpy as np

from . import files
from .command import Failed

TIME_UNIT = 0.001**0.5
"""Seconds of a frame of Blender's cloth at speed 1: its gravity is a thousandth."""

NEAR = 0.1
"""Distance of a motion's first frame from the cloth, in its size, up to which it is in place."""

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


def cloth_of(thing):
    """The cloth modifier of an object, or None."""
    return next((each for each in thing.modifiers if each.type == "CLOTH"), None)


def source_of(thing):
    """The object whose motion is the target, or None."""
    own = thing.clothfit
    return {"OWN": thing, "OBJECT": own.other}.get(own.target)


def held(thing):
    """Numbers of the vertices that the cloth modifier pins."""
    modifier = cloth_of(thing)
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


def rate(context, thing):
    """Frames per second of the target. Blender's cloth has a time of its own: a frame is its speed times TIME_UNIT."""
    source = source_of(thing)
    modifier = cloth_of(source) if source else None
    if modifier:
        return 1.0 / (TIME_UNIT * modifier.settings.time_scale)
    return context.scene.render.fps / context.scene.render.fps_base


def in_place(found, thing):
    """A recorded motion where the cloth is.

    An object may stand beside the cloth: where its first frame is farther from it than NEAR of its size, the whole
    motion is moved and turned so that this frame is nearest (Kabsch's algorithm).
    """
    own = points(thing.data, thing.matrix_world)
    centre, first = own.mean(axis=0), found[0].mean(axis=0)
    size = np.linalg.norm(own - centre)
    if np.linalg.norm(found[0] - own) < NEAR * size:
        return found
    left, _, right = np.linalg.svd((found[0] - first).T @ (own - centre))
    turn = left @ np.diag([1.0, 1.0, np.sign(np.linalg.det(left @ right))]) @ right
    return (found - first) @ turn + centre


def frames(context):
    """Frames of the scene."""
    return context.scene.frame_end - context.scene.frame_start + 1


def new_call(context, thing, paths):
    """The call that makes the scene of an object."""
    own = thing.clothfit
    letters = "F" if own.letters == "auto" else own.letters
    call = ["new", str(paths.mesh), "-o", str(paths.scene)]
    call += ["--fps", repr(rate(context, thing)), "--frames", str(frames(context))]
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
    source = source_of(thing)
    if source is None or source.type != "MESH":
        raise Failed("choose the object of the target, a mesh")
    found = record(context, source, len(thing.data.vertices))
    files.write_pc2(paths.target, found if source == thing else in_place(found, thing))
    return str(paths.target), True


def fit_calls(context, thing, paths):
    """All calls of a fit: the scene, the fit, the motion of its result."""
    write_mesh(thing, paths.mesh)
    motion, unknown = target(context, thing, paths)
    estimate = ["estimate", str(paths.scene), "--target", motion, "-o", str(paths.fitted)]
    estimate += ["--fps", repr(rate(context, thing))] if unknown else []
    estimate += ["--model", "auto"] if thing.clothfit.letters == "auto" else []
    estimate += thing.clothfit.options.split()
    return [new_call(context, thing, paths), estimate, ["simulate", str(paths.fitted), "-o", str(paths.motion)]]
