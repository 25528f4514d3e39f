"""A sheet to fit, and motions with another clock or in another place."""

from __future__ import annotations

import json
from dataclasses import replace

import numpy as np

from clothfit.base.arrays import Array
from clothfit.motion.motion import Motion
from clothfit.scene.scene import Scene
from helpers.scenes import cloth, document, load_text


def sheet(stiffness: float = 20.0, letters: str = "nG", frames: int = 40, delta: float = 0.02) -> Scene:
    """A sheet of 6 × 6 vertices, 0.1 m apart, held at one side."""
    springs = [stiffness] * len(cloth(6, 6)["springStiffness"])
    own = cloth(6, 6, 0.1, vertIsFixed=[i < 6 for i in range(36)], vertMass=[0.002] * 36, springStiffness=springs)
    own["optimizationSettings"] = letters
    return load_text(json.dumps(document(own, optimizationIterations=frames, delta=delta, tolerance=1e-10)))


def stranger(
    motion: Motion, rate: float = 1.0, offset: float = 0.0, turn: Array | None = None, move: Array | None = None
) -> Motion:
    """A motion with another clock, and in another place."""
    turn, move = np.eye(3) if turn is None else turn, np.zeros(3) if move is None else move
    return replace(motion, times=rate * motion.times + offset, positions=(motion.positions - move) @ turn)
