"""The live page: the modules of a report's page, with a main of its own; and a scene as it draws it."""

from __future__ import annotations

from functools import lru_cache
from pathlib import Path
from typing import Any

import numpy as np

from clothfit.base.version import __version__
from clothfit.report.contents import mesh, surroundings
from clothfit.report.page import WEB, filled, import_map
from clothfit.scene.scene import Scene

OWN = Path(__file__).parent / "web"

MOST_FRAMES = 2000
"""Frames for which the page knows where obstacles are that move."""


@lru_cache(maxsize=1)
def parts() -> dict[str, str]:
    """The page's parts, read once."""
    styles = [(WEB / "page.css").read_text("utf-8"), (OWN / "live.css").read_text("utf-8")]
    return {
        "style": "\n".join(styles),
        "imports": import_map([*sorted(WEB.glob("*.js")), *sorted(OWN.glob("*.js"))]),
        "page": (OWN / "live.html").read_text("utf-8"),
    }


def live_page(nonce: str) -> bytes:
    """The page, HTML in UTF-8, whose scripts have a nonce."""
    own = parts()
    return filled(own["page"], {"style": own["style"], "imports": own["imports"], "nonce": nonce}).encode("utf-8")


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


def elements_of(scene: Scene) -> dict[str, Any]:
    """The masses and stiffnesses of a scene, as in its mesh."""
    whole = mesh(scene)
    return {name: whole[name] for name in ("mass", "stiffness")}
