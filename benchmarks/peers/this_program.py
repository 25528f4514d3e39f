"""This program, behind the same few functions as its peers."""

from __future__ import annotations

from dataclasses import replace

import clothfit
from clothfit.engine.rollout import rollout
from clothfit.engine.system import build
from clothfit.scene.scene import Scene


class Peer:
    """clothfit on a scene of one cloth whose stiffnesses, and nothing else, are fitted."""

    name = "clothfit"

    def __init__(self, scene: Scene) -> None:
        cloth = replace(scene.cloths[0], settings="nL", fits={})
        self.scene = replace(scene, cloths=(cloth,), fits={})
        self.system, self._memory = build(self.scene, 0), None
        self._objective = None, None, None

    @property
    def iterations(self):
        """CG iterations of a step, on average, of the motion that was computed last."""
        return 0.0 if self._memory is None else float(self._memory.solves[:, 0].mean())

    def steps(self, n, tolerance):
        """The motion of n steps."""
        self._memory, _ = rollout(self.system, n, tolerance)
        return self._memory.x

    def cost_and_gradient(self, k, target, tolerance):
        """G and ∂G/∂k; the objective is prepared once for each target, as a fit does."""
        *key, objective = self._objective
        if key != [id(target), tolerance]:
            motion = clothfit.as_motion(self.scene, target)
            objective = clothfit.Objective(self.scene, motion, tolerance)
            self._objective = id(target), tolerance, objective
        return objective.cost_and_gradient(k)
