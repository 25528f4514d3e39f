"""The tools that a scene can be exported to: a module each, whose `files` give names and contents.

`docs/export.md` explains what the numbers mean in each tool, and what of a scene has no counterpart there. Numbers have
full precision, so they read back unchanged; the same scene gives the same bytes.
"""

from __future__ import annotations

from collections.abc import Callable
from importlib import import_module
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from clothfit.scene.scene import Scene

TOOLS = {
    "csv": "tables", "obi": "obi", "blender": "blender", "vellum": "vellum",
    "gltf": "handles_gltf", "usd": "handles_usd",
}  # fmt: skip
"""The module for each tool."""

PATHS = ("gltf", "usd")
"""Those that take the paths of pins and nothing else."""

WITHOUT_STEPS = ("csv", *PATHS)
"""Those that simulate nothing."""


def own_step(scene: Scene, tool: str) -> str | None:
    """A warning where the scene's step is neither the tool's nor one that the values are usually fitted with."""
    from clothfit.scene.kinds import INTEGRATORS, OF_THE_EDITOR

    name = INTEGRATORS[scene.method]
    if name in OF_THE_EDITOR or tool in WITHOUT_STEPS:
        return None
    return (
        f"its values go with {name} steps of {scene.delta:.4g} s (integrationMethod {scene.method}), which {tool} does "
        "not have; the steps of its own may damp more, and the motion differs"
    )


def exported(scene: Scene, tool: str) -> dict[str, bytes]:
    """The files for a tool of `TOOLS`: contents by name."""
    files: Callable[[Scene], dict[str, bytes]] = import_module(f"clothfit.export.{TOOLS[tool]}").files
    return files(scene)
