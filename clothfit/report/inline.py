"""A small viewer for notebooks: the cloth in 3-D in a frame of its own, with the modules of a report's page.

It needs no network, and stays in the notebook's file: about 1 MB each. The frame may run scripts and nothing else.
"""

from __future__ import annotations

import base64
import hashlib
import html
from typing import Any

import numpy as np

from clothfit.base.arrays import Array
from clothfit.base.messages import counted
from clothfit.base.notebook import scene_of
from clothfit.fit.result import Fit
from clothfit.motion.divergence import Diverged
from clothfit.motion.motion import Motion
from clothfit.motion.simulate import simulate
from clothfit.report.contents import mesh, surroundings
from clothfit.report.packing import box, packed, packed_positions
from clothfit.report.page import WEB, filled, import_map, script_text
from clothfit.report.showing import MOST_POSITIONS
from clothfit.scene.scene import Scene

OWN = WEB / "inline"
HEIGHT = 420
"""Pixels of a frame."""

MOST_FRAMES = 500


def shown(thing: Scene | Motion | Fit) -> str:
    """The HTML that shows a scene at its start, a motion, or the motion of a fit."""
    if isinstance(thing, Scene):
        start = np.concatenate([cloth.positions for cloth in thing.cloths])[None]
        return framed(start, np.zeros(1), thing, repr(thing))
    if isinstance(thing, Fit):
        motion = fitted_motion(thing.scene)
        return framed(motion.positions, motion.times, thing.scene, repr(thing))
    return framed(thing.positions, thing.times, scene_of(thing), repr(thing))


def fitted_motion(scene: Scene) -> Motion:
    """The motion of a fitted scene, or its good part."""
    try:
        return simulate(scene, min(scene.frames, MOST_FRAMES))
    except Diverged as error:
        if error.motion is None or not len(error.motion.times):
            start = np.concatenate([cloth.positions for cloth in scene.cloths])[None]
            return Motion(start, np.zeros(1), scene.vertex_counts)
        return error.motion


def framed(x: Array, times: Array, scene: Scene | None, text: str) -> str:
    """A frame that plays positions x (F, n, 3), m, at times (F,), s, under a line of text."""
    every = max(1, -(-x.size // (3 * MOST_POSITIONS)), -(-len(x) // MOST_FRAMES))
    x, times = x[::every], times[::every]
    line = f'<p style="margin:0 0 6px;font:13px system-ui,sans-serif">{html.escape(text.strip("<>"))}</p>'
    if not np.isfinite(x).any() or x.shape[1] == 0:
        return line
    page = html.escape(document(content(x, times, scene)), quote=True)
    style = f"width:100%;height:{HEIGHT}px;border:0;border-radius:12px"
    return f'{line}<iframe title="clothfit" sandbox="allow-scripts" style="{style}" srcdoc="{page}"></iframe>'


def content(x: Array, times: Array, scene: Scene | None) -> dict[str, Any]:
    """What the frame shows."""
    low, step = box(x)
    around = {"wind": [0, 0, 0], "spheres": [], "solids": [], "pinned": False}
    return {
        "times": times.tolist(),
        "motion": packed_positions(x, low, step),
        "mesh": bare_mesh(x) if scene is None else mesh(scene),
        "surroundings": around if scene is None else surroundings(scene, times, x),
        "label": f"{counted(x.shape[1], 'vertex', 'vertices')}, {counted(len(x), 'frame', 'frames')}",
    }


def bare_mesh(x: Array) -> dict[str, Any]:
    """The mesh of a motion of which nothing but the vertices is known."""
    n, none = x.shape[1], np.zeros(0)
    return {
        "vertex_counts": [n], "spring_counts": [0], "start": packed(np.nan_to_num(x[0])),
        "triangles": packed(np.zeros(0, np.int32)), "springs": packed(np.zeros(0, np.int32)), "rest": packed(none),
        "fixed": packed(np.zeros(n, bool)), "mass": packed(np.ones(n)), "stiffness": packed(none),
    }  # fmt: skip


def document(shows: dict[str, Any]) -> str:
    """The page in the frame."""
    text = script_text(shows)
    parts = {
        "nonce": base64.b16encode(hashlib.sha256(text.encode()).digest()[:16]).decode(),
        "imports": import_map([*sorted(WEB.glob("*.js")), OWN / "inline.js"], named=False),
        "content": text,
    }
    return filled((OWN / "inline.html").read_text("utf-8"), parts)
