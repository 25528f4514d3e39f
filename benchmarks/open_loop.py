"""Keyframe control as textbooks do it, for `adjoints.py`: by forces on all vertices, straight through the simulation.

The cost of forces u (T, n, 3) is G = Σ over keys |x − x*|² + γ Σ |u|² h, in m². Three ways down, each with the exact
gradient or the approximate one: steepest descent with a line search that doubles and halves its step, L-BFGS (SciPy's),
and Gauss–Newton, damped by μ |u⁺ − u|² (Levenberg and Marquardt). Its linear systems are those of the keys: with
J = ∂x_keys/∂u, residuals r and β = γ h + μ,

    (J Jᵀ + β I) q = β r − γ h J u,      u⁺ = u − (Jᵀ q + γ h u)/β

by conjugate gradients, one sweep back and one forth in each iteration.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass
from types import ModuleType
from typing import Any

import numpy as np

import approximate
from clothfit.base.arrays import Array
from clothfit.derivative import adjoint
from clothfit.engine.rollout import Rollout, rollout
from clothfit.engine.system import build, zeros
from clothfit.scene.forces import Forces
from clothfit.scene.scene import Scene

GAMMA = 1e-3
"""γ, m²/(N² s): effort of some tens of N² s costs as much as a key that a cloth misses by a few centimetres."""

WAVE = 0.3
"""Height of the wave, m, that the cloth is to be at half of the time; at its end it is to be where it began."""

TOLERANCE = 1e-9
"""Of linear systems, relative: errors of the gradient far below what the two sweeps differ by."""

SWEEPS: dict[str, ModuleType] = {"approximate": approximate, "exact": adjoint}

ARMIJO, CURVED, DAMPED = 1e-4, 1e-2, 1e-2
"""Share of the linear prediction that a step must gain; of Gauss–Newton the residual to which it solves its systems,
and the first μ, relative to the largest eigenvalue of J Jᵀ.
"""

MOST_STEPS, MOST_PRODUCTS = 3000, 200
"""Iterations of a descent, and of the conjugate gradients within one."""

SLOW, LATE = 1e-3, 20
"""A descent ends where so many iterations gain less than this share of the cost."""


class Task:
    """The first cloth of a scene, to be a wave after half of the steps and at rest where it began after all."""

    def __init__(self, scene: Scene, steps: int) -> None:
        count = sum(scene.vertex_counts)
        forces = Forces(scene.delta * np.arange(steps, dtype=float), np.zeros((steps, count, 3)))
        self.system, self.steps, self.h = build(scene.with_forces(forces), 0, steps=steps), steps, scene.delta
        self.free = self.system.vertex.free
        self.keys, self.wanted = [steps // 2, steps], np.stack([wave(self.system.x0), self.system.x0])
        self.simulations = self.products = 0

    def simulated(self, u: Array, tolerance: float = TOLERANCE) -> Rollout | None:
        """The motion under forces u (T, n, 3), N; None where it diverges."""
        assert self.system.inputs is not None
        self.simulations += 1
        self.system.inputs.force[: self.steps] = u
        motion, good = rollout(self.system, self.steps, tolerance)
        return motion if good == self.steps else None

    def missed(self, motion: Rollout) -> Array:
        """r (K, n, 3), m."""
        return np.where(self.free[:, None], motion.x[self.keys] - self.wanted, 0.0)

    def cost(self, u: Array, motion: Rollout | None) -> float:
        """G, m²."""
        if motion is None:
            return np.inf
        return float((self.missed(motion) ** 2).sum() + GAMMA * self.h * (u**2).sum())

    def back(self, sweep: ModuleType, motion: Rollout, weight: Array, tolerance: float = TOLERANCE) -> Array:
        """Jᵀ of weights (K, n, 3), along a motion: (T, n, 3)."""
        self.products += 1
        by_position = np.zeros_like(motion.x)
        by_position[self.keys] = weight
        found = sweep.gradient(self.system, motion, by_position, tolerance, ("force",)).force[: self.steps]
        return np.where(self.free[:, None], found, 0.0)

    def forth(self, sweep: ModuleType, motion: Rollout, change: Array) -> Array:
        """J of a change (T, n, 3) of the forces: (K, n, 3)."""
        self.products += 1
        along = zeros(self.system, ("force",))
        along.force[: self.steps] = change
        return np.asarray(sweep.tangent(self.system, motion, along, TOLERANCE)[self.keys])

    def gradient(self, sweep: ModuleType, u: Array, motion: Rollout, tolerance: float = TOLERANCE) -> Array:
        """∂G/∂u (T, n, 3), m²/N."""
        back = self.back(sweep, motion, 2.0 * self.missed(motion), tolerance)
        return np.asarray(back + 2.0 * GAMMA * self.h * u)


def wave(x: Array) -> Array:
    """Positions (n, 3) displaced along the cloth's normal axis by one wave that grows along its longest side."""
    extent = np.ptp(x, axis=0)
    along, across = int(np.argmax(extent)), int(np.argmin(extent))
    s = (x[:, along] - x[:, along].min()) / extent[along]
    moved = x.copy()
    moved[:, across] += WAVE * s * np.sin(2.0 * np.pi * s)
    return moved


@dataclass
class Result:
    """How a descent ended."""

    ended: str
    iterations: int
    cost: float


class Descent:
    """One way down from no forces, within a time of so many seconds of this process."""

    def __init__(self, task: Task, sweep: ModuleType, seconds: float) -> None:
        self.task, self.sweep, self.seconds = task, sweep, seconds
        task.simulations = task.products = 0
        self.began = time.process_time()
        self.u = np.zeros_like(task.system.inputs.force[: task.steps])  # type: ignore[union-attr]
        self.motion = self.simulated(self.u)
        self.values = [task.cost(self.u, self.motion)]

    def simulated(self, u: Array) -> Any:
        """The motion under forces u."""
        return self.task.simulated(u)

    def ended(self) -> str | None:
        """Why to end now, if so."""
        if time.process_time() - self.began > self.seconds:
            return "time"
        if len(self.values) > MOST_STEPS:
            return "iterations"
        late = len(self.values) > LATE and self.values[-1 - LATE] - self.values[-1] < SLOW * self.values[-1]
        return "slow" if late else None

    def searched(self, direction: Array, slope: float, step: float) -> float:
        """Move along a direction by as much of `step` as gains enough; returns that, 0 where nothing does."""
        while step > 1e-14 and time.process_time() - self.began < self.seconds:
            u = self.u + step * direction
            motion = self.simulated(u)
            value = self.task.cost(u, motion)
            if value < self.values[-1] + ARMIJO * step * slope:
                self.u, self.motion = u, motion
                self.values.append(value)
                return step
            step *= 0.5
        return 0.0

    def result(self, ended: str) -> Result:
        """What was found."""
        return Result(ended, len(self.values) - 1, self.values[-1])


def steepest(descent: Descent) -> Result:
    """Steepest descent."""
    step = 1.0
    while (ended := descent.ended()) is None:
        gradient = descent.task.gradient(descent.sweep, descent.u, descent.motion)
        size = float((gradient**2).sum())
        step = descent.searched(-gradient, -size, 2.0 * step)
        if step == 0.0:
            return descent.result(descent.ended() or "no step gains")
    return descent.result(ended)


def lbfgs(descent: Descent) -> Result:
    """SciPy's L-BFGS-B without bounds."""
    from scipy.optimize import minimize

    task, best = descent.task, descent.values[0]

    def cost(z: Array) -> tuple[float, Array]:
        nonlocal best
        u = z.reshape(descent.u.shape)
        motion = descent.simulated(u)
        value = task.cost(u, motion)
        if motion is None:
            return 1e30, np.zeros_like(z)
        best = min(best, value)
        return value, task.gradient(descent.sweep, u, motion).reshape(-1)

    def noted(_: Array) -> None:
        descent.values.append(best)
        if descent.ended() is not None:
            raise StopIteration

    search: Any = minimize
    options = {"maxcor": 12, "maxiter": 10**6, "maxfun": 10**6, "ftol": 0.0, "gtol": 0.0}
    found = search(cost, descent.u.reshape(-1), jac=True, method="L-BFGS-B", callback=noted, options=options)
    descent.values[-1] = best
    return descent.result(descent.ended() or ("no step gains" if found.status == 2 else "flat"))


def gauss_newton(descent: Descent) -> Result:
    """Gauss–Newton in the space of the keys, damped by Levenberg and Marquardt's term."""
    task, sweep, h = descent.task, descent.sweep, descent.task.h
    left = task.missed(descent.motion)
    image = task.forth(sweep, descent.motion, task.back(sweep, descent.motion, left))
    largest = float(np.linalg.norm(image) / np.linalg.norm(left))  # about the largest eigenvalue of J Jᵀ
    damping = DAMPED * largest
    while (ended := descent.ended()) is None:
        motion, value, shift = descent.motion, descent.values[-1], GAMMA * h + damping
        left = task.missed(motion)
        right = shift * left - GAMMA * h * task.forth(sweep, motion, descent.u)
        weight = conjugate_gradients(descent, right, shift)
        change = -(task.back(sweep, motion, weight) + GAMMA * h * descent.u) / shift
        u = descent.u + change
        foretold = float(((left + task.forth(sweep, motion, change)) ** 2).sum() + GAMMA * h * (u**2).sum())
        moved = descent.simulated(u)
        found = task.cost(u, moved)
        good = found < value and foretold < value
        if good:
            descent.u, descent.motion = u, moved
            descent.values.append(found)
        share = (value - found) / (value - foretold) if good else 0.0
        damping *= 0.1 if share > 0.75 else 1.0 if share > 0.25 else 5.0
        if damping > 1e6 * largest:
            return descent.result(descent.ended() or "no step gains")
    return descent.result(ended)


def conjugate_gradients(descent: Descent, right: Array, shift: float) -> Array:
    """Solve (J Jᵀ + shift I) weight = right, (K, n, 3)."""
    task, sweep, motion = descent.task, descent.sweep, descent.motion
    found, left = np.zeros_like(right), right.copy()
    along, size = left.copy(), float((left**2).sum())
    first = size
    for _ in range(MOST_PRODUCTS):
        if size <= CURVED**2 * first or descent.ended() == "time":
            break
        image = task.forth(sweep, motion, task.back(sweep, motion, along)) + shift * along
        step = size / float((along * image).sum())
        found += step * along
        left -= step * image
        before, size = size, float((left**2).sum())
        along = left + size / before * along
    return found


METHODS: dict[str, Callable[[Descent], Result]] = {
    "gradient descent": steepest, "L-BFGS": lbfgs, "Gauss–Newton": gauss_newton,
}  # fmt: skip
