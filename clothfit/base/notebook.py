"""How scenes, motions and fits show themselves in a notebook: who draws them, and of which scene a motion is.

The viewer stands far above what it shows, and is loaded when a notebook first asks for it.
"""

from __future__ import annotations

from importlib import import_module
from typing import Any
from weakref import WeakKeyDictionary

VIEWER = "clothfit.report.page"

_scenes: WeakKeyDictionary[Any, Any] = WeakKeyDictionary()


def html_of(thing: Any) -> str:
    """The HTML that shows a scene, a motion or a fit."""
    return str(import_module(VIEWER).viewer(thing))


def belongs(motion: Any, scene: Any) -> None:
    """Note of which scene a motion is, so that its faces can be drawn."""
    _scenes[motion] = scene


def scene_of(motion: Any) -> Any | None:
    """The scene that a motion is of, where that is known."""
    return _scenes.get(motion)
