"""A cloth of a scene as XPBD has it, the method of Obi, Vellum and many engines of games.

Every spring is a constraint of compliance 1/k. Its damping (α/2) k is, times the compliance, the time α/2. Bending
springs stay distances across an edge, or become angles between the faces there: with the length L of a spring, its
torque in the third order of the angle, k L² θ³/32, is that of the compliance 32/(k L² FOLD²) at the angle FOLD. As
compliances are 1/k, what differs from the springs' motion is the length of substeps and what the iterations leave;
with many of both it is the springs' (`tests/simulators/test_xpbd.py`).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from clothfit.base.arrays import Array, Indices
from clothfit.base.errors import InvalidInput
from clothfit.engine.forces.spheres import STIFFNESS
from clothfit.engine.inputs.tables import Inputs
from clothfit.engine.system import System, build
from clothfit.export.blender import FOLD
from clothfit.export.topology import roles
from clothfit.scene.cloth import Cloth
from clothfit.scene.scene import Scene
from clothfit.simulators.substep import Model

DISTANCE, ANGLE = "distance", "angle"
BENDING = (DISTANCE, ANGLE)
"""What a bending spring becomes."""

SOLVED = ("distance", "bending")
"""Kinds of constraints of which a solver has its own settings."""

STIFFEST, SOFTEST = 1e-12, 1e12
"""Compliances, m/N: a spring that is not, and one without stiffness."""


@dataclass(frozen=True)
class Settings:
    """How a solver is set."""

    substeps: int = 4  # of a step of the scene
    iterations: int = 5  # of a substep
    bending: str = DISTANCE

    def check(self) -> None:
        """Raise InvalidInput on what cannot be."""
        for name in ("substeps", "iterations"):
            if not 1 <= getattr(self, name) <= 10_000:
                raise InvalidInput(f"{name} must be within 1 … 10000; {getattr(self, name)} was given")
        if self.bending not in BENDING:
            raise InvalidInput(f"bending: there is no {self.bending!r}; use distance or angle")


def refuse(scene: Scene, tool: str) -> None:
    """Raise InvalidInput for what of a scene no model here has."""
    found = {
        "colliders other than plain spheres": scene.colliders,
        "self-contact": scene.self_contact,
        "applied forces": scene.forces,
        "moving axes": scene.frame,
    }
    for what, there in found.items():
        if there:
            raise InvalidInput(f"{scene.name}: the model of {tool} has no {what}")


def model_of(scene: Scene, index: int, settings: Settings, frames: int) -> Model:
    """Cloth `index` of a scene as XPBD has it, for motions of so many frames. Raises InvalidInput, InvalidScene."""
    settings.check()
    refuse(scene, "xpbd")
    system, cloth = build(scene, index, steps=frames - 1), scene.cloths[index]
    members, rest, compliance = constraints(cloth, settings.bending)
    faces = system.faces._replace(wind=system.faces.wind.copy())
    pins, path = pins_of(system.inputs, frames)
    return Model(
        x0=system.x0.copy(), v0=system.v0.copy(), free=~cloth.fixed,
        inverse=np.where(cloth.fixed, 0.0, 1.0 / cloth.mass),
        members=members, rest=rest, compliance=compliance, time=np.full(len(rest), 0.5 * cloth.damping),
        relaxation=np.ones(len(rest)), damping=np.full(len(cloth.mass), cloth.damping),
        faces=faces, radius=system.spheres.radius, contact=1.0 / STIFFNESS,
        **world(system, frames), path=path, pins=pins,
        h=scene.delta, substeps=settings.substeps, iterations=settings.iterations,
    )  # fmt: skip


def constraints(cloth: Cloth, bending: str) -> tuple[Indices, Array, Array]:
    """Members (K, 4), rest (K,) and compliances (K,) of the constraints, in the order of the springs."""
    members = np.full((len(cloth.springs), 4), -1, np.int32)
    members[:, :2] = cloth.springs
    rest: Array = cloth.rest.copy()
    with np.errstate(divide="ignore"):
        compliance: Array = np.clip(1.0 / cloth.stiffness, STIFFEST, SOFTEST)
    if bending == ANGLE:
        role = roles(cloth)
        chosen = role.bending
        members[chosen, :2], members[chosen, 2:] = role.hinges[chosen], cloth.springs[chosen]
        rest[chosen] = 0.0
        rest[chosen] = angles(members[chosen], cloth.positions)
        compliance[chosen] *= 32.0 / (cloth.rest[chosen] * FOLD) ** 2
    return members, rest, compliance


def angles(members: Indices, x: Array) -> Array:
    """The angles of hinges (H, 4) at x (n, 3), rad, as `substep.angle` has them."""
    origin = x[members[:, 0]]
    e, a, b = (x[members[:, k]] - origin for k in (1, 2, 3))
    p, q = np.cross(e, a), np.cross(b, e)
    with np.errstate(all="ignore"):
        along = np.nan_to_num((np.cross(p, q) * e).sum(axis=1) / np.linalg.norm(e, axis=1))
    found: Array = np.arctan2(along, (p * q).sum(axis=1))
    return found


def world(system: System, frames: int) -> dict[str, Array]:
    """Wind, gravity and spheres at the times of the frames."""
    inputs, spheres = system.inputs, len(system.spheres.radius)

    def rows(base: Array, table: Array | None) -> Array:
        found = np.broadcast_to(base, (frames, *base.shape)).copy()
        if table is not None and len(table):
            found += table[:frames]
        return found

    wind = inputs.wind_base if inputs else system.faces.wind
    gravity = inputs.gravity_base if inputs else system.vertex.gravity
    centre = rows(system.spheres.centre, None)
    if inputs and len(inputs.centre):
        centre = inputs.centre[:frames, :spheres].copy()
    return {
        "wind": rows(wind, inputs and inputs.wind), "gravity": rows(gravity, inputs and inputs.gravity),
        "centre": centre,
    }  # fmt: skip


def pins_of(inputs: Inputs | None, frames: int) -> tuple[Indices, Array]:
    """The pins (P,) and their places (frames, P, 3)."""
    if inputs is None or not len(inputs.path):
        return np.zeros(0, np.int32), np.zeros((frames, 0, 3))
    return inputs.pins, inputs.path[:frames].copy()
