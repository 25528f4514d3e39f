"""What of a scene a tool does not get: a row for each field of the file, so that none is forgotten.

`FIELDS` has the places of fields in the scene's file, `*` for those below, and what is lost with them; None for those
that say nothing of the motion, or that every tool gets.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

if TYPE_CHECKING:
    from clothfit.scene.scene import Scene


class Lost(NamedTuple):
    """What some fields say, and who gets it."""

    what: str  # in a sentence
    there: Callable[[Scene], object]  # whether a scene has it
    tools: tuple[str, ...] = ()  # that get it


SOLVERS = ("csv", "obi", "blender", "vellum")

PATHS = Lost("the paths of its pins", lambda scene: any(cloth.pins for cloth in scene.cloths), ("gltf", "usd"))
OBSTACLES = Lost("its colliders", lambda scene: scene.obstacles)
WIND = Lost("its wind", lambda scene: scene.wind.any() and any(cloth.feels_air for cloth in scene.cloths))
DRAG = Lost("its air drag", lambda scene: any(cloth.feels_air for cloth in scene.cloths), ("csv",))

FIELDS: dict[str, Lost | None] = {
    **dict.fromkeys(("title", "tolerance", "optimizationIterations", "forwardSubSteps", "printTimes", "fit")),
    **dict.fromkeys(("integrationMethod", "delta")),  # `tools.own_step`
    "windVel": WIND,
    "windVelKeys": Lost("its wind over time", lambda scene: scene.wind_keys),
    "gravity": Lost("its gravity, which is not 9.81 m/s² downwards", lambda scene: not is_earths(scene)),
    "gravityKeys": Lost("its gravity over time", lambda scene: scene.gravity_keys),
    "frame": Lost("its moving frame of reference", lambda scene: scene.frame),
    "colliderOffset": OBSTACLES,
    "planes": OBSTACLES,
    "colliders.*": OBSTACLES,
    "selfCollision": Lost("the contact of cloths with themselves", lambda scene: scene.self_contact),
    **dict.fromkeys(f"objects.{name}" for name in ("vertPos", "vertIsFixed", "vertMass", "springs", "triangles")),
    **dict.fromkeys(f"objects.{name}" for name in ("springStiffness", "springRestLength")),
    **dict.fromkeys(f"objects.{name}" for name in ("optimizationSettings", "families", "regions", "warp", "fit")),
    "objects.vertVel": Lost("its velocities at the start", lambda scene: any(c.velocity.any() for c in scene.cloths)),
    "objects.dragCoefficient": DRAG,
    "objects.dragLaw": DRAG,
    "objects.damping": Lost(
        "its damping", lambda scene: any(c.damping for c in scene.cloths), ("csv", "blender", "vellum")
    ),
    "objects.pins": PATHS,
    "objects.pinOffset": PATHS,
}


def is_earths(scene: Scene) -> bool:
    """Whether gravity is as a tool has it by itself."""
    return bool(np.allclose(scene.gravity, [0.0, -9.81, 0.0], atol=0.02))


def dropped(scene: Scene, tool: str) -> list[str]:
    """What of a scene a tool does not get, each thing once."""
    every = [lost for lost in FIELDS.values() if lost] if tool in SOLVERS else []
    return list(dict.fromkeys(lost.what for lost in every if tool not in lost.tools and lost.there(scene)))
