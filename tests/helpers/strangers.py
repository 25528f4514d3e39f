"""Sheets to fit, and motions with another clock, in another place or by finer steps."""

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from clothfit import Scene, load, simulate
from clothfit.base.arrays import Array
from clothfit.motion.motion import Motion, at_frames
from helpers.scenes import cloth, document

WIND, DRAG, DAMPING = (1.0, -0.5, 2.0), 2000.0, 0.5
"""Of a sheet in wind: m/s, kg/(m⁶ s) and 1/s."""

SPRINGS = len(cloth(6, 6)["springStiffness"])


def sheet(stiffness: float = 20.0, letters: str = "nG", frames: int = 40, delta: float = 0.02) -> Scene:
    """A sheet of 6 × 6 vertices, 0.1 m apart, held at one side."""
    return small(letters, frames, side=6, delta=delta, springStiffness=[stiffness] * SPRINGS)


def stranger(
    motion: Motion, rate: float = 1.0, offset: float = 0.0, turn: Array | None = None, move: Array | None = None
) -> Motion:
    """A motion with another clock, and in another place."""
    turn, move = np.eye(3) if turn is None else turn, np.zeros(3) if move is None else move
    return replace(motion, times=rate * motion.times + offset, positions=(motion.positions - move) @ turn)


def small(letters: str = "nL", frames: int = 24, method: int = 2, side: int = 4, **fields: Any) -> Scene:
    """A square sheet, vertices 0.1 m apart, held at one side; fields of an object go to it, all others to the scene."""
    springs = len(cloth(side, side)["springStiffness"])
    own = {"vertIsFixed": [i < side for i in range(side**2)], "vertMass": [0.002] * side**2}
    own["springStiffness"] = [20.0] * springs
    kept = {"optimizationIterations": frames, "integrationMethod": method, "tolerance": 1e-10}
    known = (*cloth(2, 2), *own, "springRestLength", "dragLaw")
    parts = {name: fields.pop(name) for name in list(fields) if name in known}
    fit = fields.pop("of_cloth", {})
    made = cloth(side, side, 0.1, **{**own, **parts, "optimizationSettings": letters, "fit": fit})
    return load(document(made, **{**kept, **fields}))


def with_finer_steps(scene: Scene, count: int) -> Motion:
    """The frames of a scene's motion by so many BDF2 steps to each of its own."""
    finer = scene.with_step(scene.delta / count, count * (scene.frames - 1) + 1, "bdf2")
    return at_frames(simulate(finer, tolerance=1e-12), slice(None, None, count))


def windy(
    wind: Sequence[float] = WIND, drag: float = DRAG, damping: float = DAMPING, stiffness: float = 5.0,
    letters: str = "nF", frames: int = 160, law: str = "editor", **fields: Any,
) -> Scene:  # fmt: skip
    """A sheet of 6 × 6 vertices in wind, held at one side; its frames are near enough for differences."""
    own = {"springStiffness": [stiffness] * SPRINGS, "dragCoefficient": drag, "damping": damping, "dragLaw": law}
    own["of_cloth"] = {"damping": "G", "dragCoefficient": "G"}
    world = {"windVel": dict(zip("xyz", wind, strict=True)), "fit": {"windVel": "G"}, "delta": 0.0025, **fields}
    return small(letters, frames, 3, 6, **own, **world)
