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
    "csv": "tools.tables", "obi": "obi.files", "blender": "blender.files", "vellum": "vellum.files",
    "gltf": "handles.gltf", "usd": "handles.usd",
}  # fmt: skip
"""The module for each tool, and its function."""

PATHS = ("gltf", "usd")
"""Those that take the paths of pins and nothing else."""

WITHOUT_STEPS = ("csv", *PATHS)
"""Those that simulate nothing."""

TABLES = {
    "objects.csv": ("object", "vertices", "springs", "triangles", "damping", "drag", "drag_law"),
    "vertices.csv": ("object", "vertex", "x", "y", "z", "fixed", "mass"),
    "springs.csv": ("object", "spring", "a", "b", "kind", "rest_length", "stiffness", "damping"),
}
"""The plain tables and the names of their columns."""


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


def tables(scene: Scene) -> dict[str, bytes]:
    """Plain tables (CSV): one row per object, vertex and spring, for spreadsheets and scripts. SI units, the scene's
    axes; the first line names the columns; numbers as Python writes them, which reads back as the same. Damping of a
    spring is (α/2) k, N s/m.
    """
    from clothfit.export.topology import roles

    objects, vertices, springs = [], [], []
    for number, cloth in enumerate(scene.cloths):
        counts = (len(cloth.mass), len(cloth.springs), len(cloth.triangles))
        objects.append((number, *counts, float(cloth.damping), float(cloth.drag), cloth.drag_law))
        places, fixed, mass = cloth.positions.tolist(), cloth.fixed.tolist(), cloth.mass.tolist()
        vertices += [(number, i, *x, int(f), m) for i, (x, f, m) in enumerate(zip(places, fixed, mass, strict=True))]
        damping = (0.5 * cloth.damping * cloth.stiffness).tolist()
        columns = (cloth.springs.tolist(), roles(cloth).names, cloth.rest.tolist(), cloth.stiffness.tolist(), damping)
        springs += [(number, s, *ends, *rest) for s, (ends, *rest) in enumerate(zip(*columns, strict=True))]
    return {
        name: "".join(f"{','.join(map(str, row))}\n" for row in (head, *rows)).encode()
        for (name, head), rows in zip(TABLES.items(), (objects, vertices, springs), strict=True)
    }
