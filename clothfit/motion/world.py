"""Motions of a scene whose axes move: from these axes to those of the world, where it is simulated, and back."""

from __future__ import annotations

from dataclasses import replace

from clothfit.engine.inputs.sampling import axes
from clothfit.motion.motion import Motion
from clothfit.scene.scene import Scene


def in_world(motion: Motion, scene: Scene) -> Motion:
    """A motion in the scene's axes, in those of the world; the same object where these do not move."""
    if scene.frame is None:
        return motion
    return replace(motion, positions=axes(scene.frame, motion.times).world(motion.positions))


def in_scene(motion: Motion, scene: Scene) -> Motion:
    """The inverse of `in_world`."""
    if scene.frame is None:
        return motion
    return replace(motion, positions=axes(scene.frame, motion.times).own(motion.positions))
