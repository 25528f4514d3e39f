"""The tools that a scene can be exported to: a module each, whose `files` give names and contents.

`docs/export.md` explains what the numbers mean in each tool, and what of a scene has no counterpart there. Numbers have
full precision, so they read back unchanged; the same scene gives the same bytes.
"""

from __future__ import annotations

import json
from collections.abc import Callable
from importlib import import_module
from typing import TYPE_CHECKING, Any

from clothfit.base.errors import InvalidInput

if TYPE_CHECKING:
    from clothfit.scene.scene import Scene

TOOLS = {
    "csv": "tables.files", "obi": "obi.files", "blender": "blender.files", "vellum": "vellum.files",
    "gltf": "handles.gltf", "usd": "handles.usd",
}  # fmt: skip
"""The module for each tool, and its function."""

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
    module, name = TOOLS[tool].split(".")
    files: Callable[[Scene], dict[str, bytes]] = getattr(import_module(f"clothfit.export.{module}"), name)
    return files(scene)


def json_text(document: Any, tool: str) -> str:
    """The JSON of a tool's file, which has no infinite numbers. Raises InvalidInput where what the tool takes in place
    of a value overflows.
    """
    try:
        return json.dumps(document, allow_nan=False)
    except ValueError:
        raise InvalidInput(
            f"{tool} cannot have the scene: a value in its terms is infinite; masses, stiffnesses or damping are "
            "beyond what a cloth has"
        ) from None
