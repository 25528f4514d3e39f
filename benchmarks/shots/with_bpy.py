"""Shots of Blender's cloth modifier: `python benchmarks/shots/with_bpy.py FOLDER [NAME …]`. Needs `bpy` (of 4.2, for
Python 3.11; its wheel has 330 MB).

Cotton at Blender's quality 15, 24 frames per second, in Blender's own time scale. Held vertices are a pin group on a
hook that is moved; wind and turbulence are force fields; a ball collides.
"""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import bpy
import numpy as np
from shot import Array, generate, quads, save, sheet, skirt, smooth

FPS = 24


def simulate(
    x: Array, triangles: Array, held: Array, path: Callable[[float], tuple[Array, float]] | None = None, *,
    frames: int = 84, mass: float = 0.3, tension: float = 15.0, bending: float = 0.5, wind: float = 0.0,
    turbulence: float = 0.0, ball: tuple[float, ...] = (), air: float = 1.0,
) -> Array:  # fmt: skip
    """Motion (frames, n, 3); `path` gives the hook's place and its turn about z, `mass` is that of a vertex in
    Blender's unit, and wind blows along y.
    """
    bpy.ops.wm.read_factory_settings(use_empty=True)
    scene = bpy.context.scene
    scene.render.fps, scene.frame_start, scene.frame_end = FPS, 1, frames
    mesh = bpy.data.meshes.new("sheet")
    mesh.from_pydata(x.tolist(), [], triangles.tolist())
    owner = bpy.data.objects.new("sheet", mesh)
    scene.collection.objects.link(owner)
    if path:
        hook = bpy.data.objects.new("hook", None)
        scene.collection.objects.link(hook)
        for frame in range(1, frames + 1):
            hook.location, hook.rotation_euler[2] = path((frame - 1) / FPS)
            hook.keyframe_insert("location", frame=frame)
            hook.keyframe_insert("rotation_euler", frame=frame)
        follower = owner.modifiers.new("hook", "HOOK")
        follower.object = hook
        follower.vertex_indices_set(held.tolist())
    modifier = owner.modifiers.new("cloth", "CLOTH")
    cloth = modifier.settings
    cloth.quality, cloth.mass, cloth.air_damping = 15, mass, air
    cloth.tension_stiffness = cloth.compression_stiffness = tension
    cloth.shear_stiffness, cloth.bending_stiffness = tension, bending
    if len(held):
        group = owner.vertex_groups.new(name="pin")
        group.add(held.tolist(), 1.0, "REPLACE")
        cloth.vertex_group_mass = "pin"
    modifier.point_cache.frame_start, modifier.point_cache.frame_end = 1, frames
    for kind, strength in (("WIND", wind), ("TURBULENCE", turbulence)):
        if strength:
            bpy.ops.object.effector_add(type=kind, location=(0, -3, 0), rotation=(-np.pi / 2, 0, 0))
            bpy.context.object.field.strength = strength
            bpy.context.object.field.flow = 0.0
            bpy.context.object.field.seed = 3
    if ball:
        bpy.ops.mesh.primitive_uv_sphere_add(segments=48, ring_count=24, radius=ball[3], location=ball[:3])
        body = bpy.context.object
        body.modifiers.new("collision", "COLLISION")
        body.collision.thickness_outer, body.collision.cloth_friction = 0.005, 40.0
        modifier.collision_settings.friction = 40.0
        modifier.collision_settings.distance_min = 0.005
        modifier.collision_settings.collision_quality = 5
    found = []
    for frame in range(1, frames + 1):
        scene.frame_set(frame)
        evaluated = owner.evaluated_get(bpy.context.evaluated_depsgraph_get()).to_mesh()
        flat = np.zeros(3 * len(evaluated.vertices), np.float32)
        evaluated.vertices.foreach_get("co", flat)
        found.append(flat.reshape(-1, 3).astype(float))
    return np.array(found)


def side(folder: Path, name: str) -> None:
    """A level sheet falls from one side."""
    x, triangles, held = sheet(15, 16, 0.9, 1.0), quads(15, 16), np.arange(15) * 16
    motion = simulate(x, triangles, held, frames=60)
    save(folder, name, motion, triangles, FPS, held, "Blender 4.2, 1 x 0.9 m, level, one side held")


def flag(folder: Path, name: str) -> None:
    """A flag whose pole is waved."""
    x, triangles, held = sheet(12, 18, 0.7, 1.1, upright=True), quads(12, 18), np.arange(12) * 18

    def path(t: float) -> tuple[Array, float]:
        size = 0.3 * smooth(t / 0.5)
        return size * np.array([0.3 * np.cos(5 * t) - 0.3, np.sin(5 * t), 0.25 * np.sin(10 * t)]), 0.0

    motion = simulate(x, triangles, held, path, tension=50.0)
    save(folder, name, motion, triangles, FPS, held, "Blender 4.2, flag of 1.1 x 0.7 m, waved")


def in_wind(folder: Path, name: str) -> None:
    """A flag in wind and turbulence."""
    x, triangles, held = sheet(13, 19, 0.8, 1.2, upright=True), quads(13, 19), np.arange(13) * 19
    motion = simulate(x, triangles, held, wind=300.0, turbulence=120.0)
    save(folder, name, motion, triangles, FPS, held, "Blender 4.2, flag of 1.2 x 0.8 m, wind 300, turbulence 120")


def steady(folder: Path, name: str) -> None:
    """A sheet, held at its upper side, in steady wind."""
    x, triangles, held = sheet(15, 15, 0.9, 0.9, upright=True), quads(15, 15), np.arange(15)
    motion = simulate(x, triangles, held, wind=600.0)
    save(folder, name, motion, triangles, FPS, held, "Blender 4.2, 0.9 m, upper side held, wind 600")


def dress(folder: Path, name: str) -> None:
    """A skirt on a waist that turns, in wind."""
    x, triangles, held = skirt(12, 25, 0.13, 0.36, 0.6), quads(12, 25, closed=True), np.arange(25)
    motion = simulate(
        x, triangles, held, lambda t: (np.zeros(3), 1.0 * smooth(t) * np.sin(4 * t)), frames=80, wind=100.0
    )
    save(folder, name, motion, triangles, FPS, held, "Blender 4.2, skirt of 0.6 m, waist turned, wind 100")


def over_ball(folder: Path, name: str) -> None:
    """A sheet drops on a ball."""
    x, triangles, ball = sheet(17, 17, 1, 1, z=0.95), quads(17, 17), (0.03, 0.48, 0.6, 0.28)
    motion = simulate(x, triangles, np.zeros(0, int), frames=60, ball=ball)
    none = np.zeros(0, int)
    save(folder, name, motion, triangles, FPS, none, "Blender 4.2, 1 m, drops on a ball", ball=np.array(ball))


SHOTS = {
    "blender-side-2": side, "blender-flag": flag, "blender-wind-2": in_wind, "blender-steady": steady,
    "blender-skirt": dress, "blender-ball": over_ball,
}  # fmt: skip

if __name__ == "__main__":
    generate(SHOTS)
