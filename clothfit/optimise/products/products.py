"""Products with the derivative J (N, Q) of the residuals of a fit, which is never formed.

J z is a tangent sweep along the motion, Jᵀ w an adjoint sweep, each about as expensive as a simulation. The motion is
simulated once; its states are kept as far as memory allows.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from clothfit.base.arrays import Array
from clothfit.derivative import adjoint
from clothfit.derivative.adjoint import TrajectoryMemory
from clothfit.engine.system import System
from clothfit.engine.tape import Tape
from clothfit.objective.run import Run, shown
from clothfit.objective.running_cost import KeptStates
from clothfit.optimise.trajectory import Trajectory
from clothfit.scene.fit_vector import changes

if TYPE_CHECKING:
    from scipy.sparse import csr_array


class Simulated(NamedTuple):
    """One run at the point of the products."""

    run: Run
    system: System
    memory: TrajectoryMemory
    by_position: csr_array  # ∂r/∂x
    residuals: Array  # r of the run


class Products:
    """J at coordinates y (Q,)."""

    def __init__(self, part: Trajectory, y: Array, tolerance: float) -> None:
        """The linear systems of the sweeps are solved to `tolerance`, relative. Raises Diverged."""
        self.part, self.tolerance, self.p = part, tolerance, part.parameters(y)
        self.factor = part.search.coordinates.derivative(self.p)
        self.runs = [self._simulated(run) for run in part.objective.runs]
        self.r = np.concatenate([each.residuals for each in self.runs])

    def _simulated(self, run: Run) -> Simulated:
        objective, at = self.part.objective, KeptStates(run.comparison)
        system = run.changed(self.p)
        tape = Tape(system, run.steps, objective.tolerance, objective.plan(run), run.forms)
        shown(run, tape, [at.update])
        by_position = run.comparison.jacobian_of(at.states)
        return Simulated(run, system, tape, by_position, run.comparison.residual_of(at.states))

    def _tangents(self, z: Array) -> Iterator[tuple[Simulated, Array]]:
        """Each run, and the change of its motion (T + 1, n, 3) along z (Q,)."""
        direction = np.zeros(len(self.p))
        direction[self.part.fitted] = z
        direction *= self.factor
        for each in self.runs:
            along = changes(each.run.scene, each.run.cloth, self.p, direction)
            yield each, adjoint.tangent(each.system, each.memory, along, self.tolerance)

    def forward(self, z: Array) -> Array:
        """J z (N,)."""
        return np.concatenate([each.by_position @ change.reshape(-1) for each, change in self._tangents(z)])

    def growth(self, z: Array) -> float:
        """How much the change of a motion along z (Q,) grows at most, from a quarter of its steps to where it is
        largest.
        """
        found = 1.0
        for _, change in self._tangents(z):
            sizes = np.linalg.norm(change[1:], axis=(1, 2))
            first = float(sizes[len(sizes) // 4]) if len(sizes) else 0.0
            found = max(found, float(sizes.max()) / first) if first > 0 else found
        return found

    def back(self, w: Array) -> Array:
        """Jᵀ w (Q,)."""
        gradient, start = np.zeros(len(self.p)), 0
        for run, system, memory, B, _ in self.runs:
            weight = (B.T @ w[start : start + B.shape[0]]).reshape(-1, *system.x0.shape)
            start += B.shape[0]
            self.part.objective.add_pullback(run, self.p, system, memory, weight, gradient, self.tolerance)
        return (gradient * self.factor)[self.part.fitted]
