"""A scene as the page draws it: the mesh and what is around it, in the records of a report's page."""

from __future__ import annotations

from typing import Any

import numpy as np

from clothfit.base.version import __version__
from clothfit.report.contents import mesh
from clothfit.report.surroundings import surroundings
from clothfit.scene.scene import Scene

MOST_FRAMES = 2000
"""Frames for which the page knows where obstacles are that move."""


def described(scene: Scene, generation: int) -> dict[str, Any]:
    """The scene: names, mesh, surroundings, and what the file asks to fit."""
    frames = min(scene.frames, MOST_FRAMES) if scene.moves else 2
    times = scene.delta * np.arange(frames, dtype=float)
    start = np.concatenate([cloth.positions for cloth in scene.cloths])
    modes = {name: [cloth.mode(name) for cloth in scene.cloths] for name in ("mass", "stiffness")}
    fits = {name: next((mode for mode in own if mode != "n"), "n") for name, own in modes.items()}
    flags = {name: any(cloth.mode(name) != "n" for cloth in scene.cloths) for name in ("damping", "drag")}
    return {
        "version": __version__,
        "generation": generation,
        "title": scene.title.strip() or scene.name,
        "name": scene.name,
        "delta": scene.delta,
        "frames": scene.frames,
        "mesh": mesh(scene),
        "surroundings": surroundings(scene, times, np.broadcast_to(start, (frames, *start.shape))),
        "fit": {**fits, **flags, **{name: scene.mode(name) != "n" for name in ("wind", "gravity")}},
        "airy": any(len(cloth.triangles) for cloth in scene.cloths),
        "warnings": list(scene.warnings)[:20],
    }
