"""The cost of a scene's parameters against a target motion, with its exact gradient and the tangent of the motion.

Only the cloths that have parameters are simulated. The errors of the linear systems enter the gradient directly: solved
to 1e-10, as in a fit, it agrees with the derivative of the cost to about 1e-8; to 1e-14, as far as rounding allows.
"""

from __future__ import annotations

import numpy as np

from clothfit import adjoint
from clothfit.arrays import Array, Flags
from clothfit.cost import Target, cost, cost_and_derivative, target
from clothfit.errors import Diverged
from clothfit.fit_vector import blocks, check_shape, elements, extra_kinds, fitted_cloths, parameters
from clothfit.motion import Motion, as_motion, checked_motion, checked_tolerance
from clothfit.rollout import Rollout, rollout
from clothfit.scene import Scene
from clothfit.system import System, build, with_elements

TIGHT = 1e-14
"""Tolerance of the linear systems in a fit, relative: their errors enter the gradient directly."""


class Objective:
    """G(p) of one scene and one target; the systems and the target are prepared once."""

    def __init__(
        self, scene: Scene, motion: Motion | Array, tolerance: float | None = None, frames: int | None = None
    ) -> None:
        """Compare with the frames of `motion` that lie within the first `frames` of the scene (default: all).

        An array (frames, vertices, 3) stands for a motion with one frame per step.

        Raises InvalidMotion when the motion does not fit the scene.
        """
        motion = checked_motion(motion, scene) if isinstance(motion, Motion) else as_motion(scene, motion)
        self.scene = scene
        self.tolerance = checked_tolerance(tolerance, TIGHT)
        self.blocks = blocks(scene)
        self.cloths = fitted_cloths(scene)
        self.systems = {i: build(scene, i) for i in self.cloths}
        last = None if frames is None else frames - 1
        self.targets: dict[int, Target] = {i: target(motion, i, scene.delta, last) for i in self.cloths}

    @property
    def observations(self) -> int:
        """Number of vertex positions that are compared."""
        return sum(int(goal.observed.sum()) for goal in self.targets.values())

    @property
    def frames(self) -> int:
        """Number of frames that are compared."""
        return max((len(goal.step) for goal in self.targets.values()), default=0)

    @property
    def shows_motion(self) -> bool:
        """Whether anything that can move is compared after the initial state; true where nothing can move."""
        fixed = {i: self.scene.cloths[i].fixed for i in self.cloths}
        return any((seen & ~fixed[i]).any() or fixed[i].all() for i, seen in self.seen.items())

    @property
    def seen(self) -> dict[int, Flags]:
        """Of each fitted cloth, which vertices (n,) are compared at some time after the initial state."""
        return {i: np.asarray(goal.observed[goal.step > 0].any(axis=0)) for i, goal in self.targets.items()}

    def rmse(self, cost: float) -> float:
        """Root mean square distance, m, of a cost, m²."""
        return float(np.sqrt(cost / max(self.observations, 1)))

    def cost(self, p: Array) -> float:
        """G(p), m². Raises Diverged."""
        return sum(self.cost_of(i, p) for i in self.cloths)

    def cost_of(self, cloth: int, p: Array) -> float:
        """The part of G(p), m², that one fitted cloth contributes. Raises Diverged."""
        return cost(self._run(cloth, p)[1].x, self.targets[cloth])

    def cost_or_infinity(self, p: Array, cloth: int | None = None) -> float:
        """G(p), m², or the part of one fitted cloth; infinite where the simulation diverges or the cost overflows."""
        try:
            value = self.cost(p) if cloth is None else self.cost_of(cloth, p)
        except Diverged:
            return np.inf
        return value if np.isfinite(value) else np.inf

    def cost_and_gradient(self, p: Array) -> tuple[float, Array]:
        """G(p), m², and ∂G/∂p (P,). Raises Diverged."""
        total, gradient = 0.0, np.zeros(len(check_shape(self.scene, p)))
        for i in self.cloths:
            cloth, memory = self._run(i, p)
            value, by_position = cost_and_derivative(memory.x, self.targets[i])
            grad = adjoint.gradient(cloth, memory, by_position, self.tolerance, extra_kinds(self.scene, i))
            total += value
            for block in self.blocks:
                if block.cloth in (i, None):
                    gradient[block.part] += block.reduce(getattr(grad, block.name))
        if not np.isfinite(gradient).all():
            raise Diverged(f"{self.scene.name}: the gradient overflows", 0)
        return total, gradient

    def tangent(self, p: Array, direction: Array) -> list[Array]:
        """Change of the positions (T + 1, n, 3) of each fitted cloth along `direction` (P,) from p. Raises Diverged."""
        changes = []
        for i in self.cloths:
            cloth, memory = self._run(i, p)
            along = elements(self.scene, i, direction, absent=0.0)
            changes.append(adjoint.tangent(cloth, memory, along, self.tolerance))
        return changes

    def _run(self, cloth: int, p: Array) -> tuple[System, Rollout]:
        changed = with_elements(self.systems[cloth], elements(self.scene, cloth, p))
        steps = int(self.targets[cloth].step.max(initial=0))
        memory, good = rollout(changed, steps, self.tolerance)
        if good < steps:
            raise Diverged(f"{self.scene.name}: objects[{cloth}] diverged at step {good + 1}", good + 1)
        return changed, memory


def cost_and_gradient(scene: Scene, motion: Motion | Array, tolerance: float | None = None) -> tuple[float, Array]:
    """G, m², of the scene against all frames of `motion`, and its exact derivative (P,) at the scene's parameters.

    `tolerance` is that of the linear systems (default: tight enough for 1e-7 relative in the gradient). Raises
    InvalidMotion when the motion does not fit the scene, Diverged when the simulation does not stay finite.
    """
    return Objective(scene, motion, tolerance).cost_and_gradient(parameters(scene))
