"""A report: two scenes and perhaps a target motion → one HTML page that needs neither network nor other files.

The parts are in `web/`: the page with places `{{name}}` for the others, its style, and JavaScript modules that import
one another by name. Each module goes into an import map as a `data:` address, as modules cannot be loaded from
`file://`. The content of the page is a JSON document in a `script` element that no browser runs. Names and titles are
escaped; as a second safeguard, a content security policy lets nothing load and runs only scripts with the nonce. (It
allows `data:` as well, because not every browser passes the nonce on to imports.)

A small viewer for notebooks: the cloth in 3-D in a frame of its own, with the modules of a report's page.

It needs no network, and stays in the notebook's file: about 1 MB each. The frame may run scripts and nothing else.
"""

from __future__ import annotations

import base64
import hashlib
import html
import json
import re
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from clothfit.base.arrays import Array
from clothfit.base.messages import counted
from clothfit.base.notebook import scene_of
from clothfit.fit.result import Fit
from clothfit.motion.divergence import Diverged
from clothfit.motion.motion import Motion
from clothfit.motion.simulate import simulate
from clothfit.objective.experiment import Recorded, motion_of
from clothfit.report.contents import content, mesh, surroundings
from clothfit.report.log import Log
from clothfit.report.packing import box, packed, packed_positions
from clothfit.report.showing import BEFORE, MOST_POSITIONS, view
from clothfit.scene.scene import Scene

WEB = Path(__file__).parent / "web"
THREE = "three/three.module.min.js"


def report_page(
    truth: Scene,
    fitted: Scene,
    target: Recorded | None = None,
    *,
    frames: int | None = None,
    log: Log | None = None,
    others: Sequence[tuple[Scene, Log]] = (),
    commands: Sequence[str] = (),
    inputs: Sequence[tuple[str, str]] = (),
) -> bytes:
    """The page, HTML in UTF-8, that plays a fitted scene over the true one, or over a target, a motion or
    the path of its file, where one is given.

    `frames` counts the initial state (default: those of `evaluate`, fewer for large scenes). `log` is the course of the
    fit; with its `start` the page plays the motion before the fit as well. `others` are other fits of the same scene,
    with their logs, to stand beside this one. The page shows `commands`, which repeat the fit, and `inputs`, name and
    SHA-256 of each file. Raises InvalidInput when scenes or target do not fit, Diverged when the motion or its target
    has no second frame.
    """
    goal = None if target is None else motion_of(target, truth)
    show = view(truth, fitted, goal, frames, others=companions(log, [scene for scene, _ in others]))
    logs = [other for _, other in others]
    return page(content(truth, fitted, show, log or Log(), None if goal is None else goal.name, logs), commands, inputs)


def companions(log: Log | None, others: Sequence[Scene]) -> list[tuple[str, Scene]]:
    """The motions to play beside the fitted one, with their names: that before the fit, where it is known, first."""
    before = [(BEFORE, log.start)] if log is not None and log.start is not None else []
    return [*before, *((scene.name, scene) for scene in others)]


def page(
    shows: Mapping[str, Any], commands: Sequence[str] = (), inputs: Sequence[tuple[str, str]] = ()
) -> bytes:
    """The page, HTML in UTF-8, that shows a content: of a fit, of a motion led through keys, or of one on a subspace.
    `commands` repeat it, `inputs` are name and SHA-256 of each file.
    """
    text = script_text({**shows, "commands": list(commands), "inputs": [list(pair) for pair in inputs]})
    parts = {
        "title": html.escape(str(shows["title"])),
        "nonce": hashlib.sha256(text.encode()).hexdigest()[:32],
        "style": (WEB / "page.css").read_text("utf-8"),
        "imports": import_map(sorted(WEB.glob("*.js"))),
        "content": text,
    }
    return filled((WEB / "page.html").read_text("utf-8"), parts).encode("utf-8", errors="replace")


def filled(template: str, parts: Mapping[str, str]) -> str:
    """A template with its places filled in one pass, so that places in the inserted text stay as they are."""
    return re.sub(r"\{\{(\w+)\}\}", lambda match: parts[match[1]], template)


def import_map(paths: Iterable[Path], named: bool = True) -> str:
    """The import map of modules and of three.js, each as a `data:` address; `named` for a browser's developer tools."""
    sources = {"three": (WEB / THREE).read_bytes()}
    for path in paths:
        name = f"clothfit/{path.stem}"
        sources[name] = path.read_bytes() + (f"\n//# sourceURL={name}.js\n".encode() if named else b"")
    coded = {name: base64.b64encode(source).decode() for name, source in sources.items()}
    return json.dumps({"imports": {name: f"data:text/javascript;base64,{text}" for name, text in coded.items()}})


def script_text(shows: Mapping[str, Any]) -> str:
    """A content as JSON that cannot end a `script` element or begin a comment."""
    text = json.dumps(shows, allow_nan=False, separators=(",", ":"))
    return text.replace("<", "\\u003c").replace(">", "\\u003e").replace("&", "\\u0026")


OWN = WEB / "inline"
HEIGHT = 420
"""Pixels of a frame."""

MOST_FRAMES = 500


def viewer(thing: Scene | Motion | Fit) -> str:
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
    page = html.escape(document(frame_content(x, times, scene)), quote=True)
    style = f"width:100%;height:{HEIGHT}px;border:0;border-radius:12px"
    return f'{line}<iframe title="clothfit" sandbox="allow-scripts" style="{style}" srcdoc="{page}"></iframe>'


def frame_content(x: Array, times: Array, scene: Scene | None) -> dict[str, Any]:
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
