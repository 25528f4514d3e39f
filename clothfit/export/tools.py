"""The tools that a scene can be exported to: a module each, whose `files(scene)` gives names and contents of files.

What the numbers stand for in the tool, and what of a scene has no counterpart there, is said in `docs/export.md`.
Numbers are written in full precision, so they read back as they are; the same scene gives the same bytes.
"""

from __future__ import annotations

from collections.abc import Callable
from importlib import import_module
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from clothfit.scene.scene import Scene

TOOLS = {"csv": "tables", "obi": "obi", "blender": "blender", "vellum": "vellum"}
"""Names of the tools to the modules that write for them."""


def exported(scene: Scene, tool: str) -> dict[str, bytes]:
    """The files for a tool of `TOOLS`: names to contents."""
    files: Callable[[Scene], dict[str, bytes]] = import_module(f"clothfit.export.{TOOLS[tool]}").files
    return files(scene)
