"""The trajectory fit of many parameters on a large cloth, where no matrix of the fit is ever formed.

SciPy's trust-region reflective method (`least_squares`) asks for products of the Jacobian with vectors: J z is a
tangent sweep along the motion, Jᵀ r an adjoint sweep, each about as expensive as a simulation. Its inner solver, LSMR,
takes some dozens of them for a step. The prior keeps one width here, since learning it needs the matrix. D. Fong, M.
Saunders, LSMR: an iterative algorithm for sparse least-squares problems, SIAM Journal on Scientific Computing 33, 2011.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from clothfit.base.arrays import Array
from clothfit.derivative import adjoint
from clothfit.motion.divergence import Diverged
from clothfit.objective.running_cost import KeptStates, running_cost
from clothfit.optimise.priors.evidence import variance
from clothfit.optimise.priors.prior import Prior
from clothfit.optimise.status import Status
from clothfit.optimise.trajectory import Trajectory
from clothfit.scene.fit_vector import changes

if TYPE_CHECKING:
    from scipy.sparse.linalg import LinearOperator

WIDTH = 1.0
"""τ of a prior that would be learned: a factor e."""

RESTARTS = 3
"""Restarts with the variance of the residuals that is left."""

EVALUATIONS = 40
"""Evaluations of the residuals in each round."""

RESTART_SAVING = 1e-4
"""Relative reduction of the cost by a round that ends the fit."""

LEAST, ROUGH = 1e-10, 1e-3
"""The same by a step that ends a round; and where only a part of the frames is fitted."""

FAR = 1e6
"""Residual where the simulation diverges, relative to the largest met: the step is taken back."""


VECTORS = 12
"""Arrays of the size of the residuals that the method works with."""


def fits(part: Trajectory) -> bool:
    """Whether the method fits into what the objective may hold."""
    matrices = sum(run.comparison.jacobian_bytes for run in part.objective.runs)
    moves = sum((run.steps + 1) * run.system.x0.nbytes for run in part.objective.runs)
    return 8 * VECTORS * part.residuals() + matrices + 3 * moves <= part.objective.room


def minimise(part: Trajectory, y: Array, prior: Prior, whole: bool) -> tuple[Array, Status]:
    """Go down from y (Q,); returns the last point and how it ended."""
    from scipy.optimize import least_squares

    solve: Any = least_squares
    bounds = (part.problem().lower, part.problem().upper)
    status = Status.LIMIT
    for _ in range(RESTARTS if whole else 1):
        residuals = Residuals(part, prior, y)
        before = float(residuals(y) @ residuals(y))
        found = solve(
            residuals, np.clip(y, *bounds), residuals.jacobian, bounds=bounds, method="trf", tr_solver="lsmr",
            max_nfev=EVALUATIONS if whole else EVALUATIONS // 4,
            ftol=LEAST if whole else ROUGH, xtol=1e-10, gtol=None,
        )  # fmt: skip
        y = found.x
        if whole:
            part.search.visit(part.search.parameters(y))
        status = Status.CONVERGED if found.status > 0 else Status.LIMIT
        if 2.0 * found.cost > (1.0 - RESTART_SAVING) * before:
            break
    return y, status


class Residuals:
    """The residuals of a trajectory, those of the prior below them, and products with their derivative."""

    def __init__(self, part: Trajectory, prior: Prior, y: Array) -> None:
        """`y` (Q,) is where the variance of the residuals is taken, which weighs the prior."""
        self.part, self.prior = part, prior.alone(WIDTH)
        cost = part.cost(y)
        sigma = np.sqrt(variance(cost if np.isfinite(cost) else 0.0, part.residuals(), 0.0))
        self.weights = [sigma / tau for tau in self.prior.tau]
        part.believe(self.prior, float(sigma) ** 2)
        self.worst, self.count, self.lowest = 0.0, 0, np.inf

    def __call__(self, y: Array) -> Array:
        """r (N + …,) at y (Q,)."""
        self.part.search.count()
        p = self.part.search.parameters(y)
        objective = self.part.objective
        try:
            observers = [(run, running_cost(run.comparison), KeptStates(run.comparison)) for run in objective.runs]
            for run, cost, at in observers:
                objective.simulate(run, p, cost.update, at.update)
        except Diverged:
            return np.full(self.count, FAR * self.worst)
        self.part.remember(p, sum(cost.value for _, cost, _ in observers))
        self.part.search.report()
        parts = [run.comparison.residual_of(at.states) for run, _, at in observers]
        below = [w * self.prior.deviation(y, g) for w, g in zip(self.weights, self.prior.groups, strict=True)]
        r = np.concatenate([*parts, *below])
        self.count, self.worst = len(r), max(self.worst, float(np.abs(r).max(initial=0.0)))
        best, squares = self.part.search.best, float(r @ r)
        if squares < self.lowest and best.descent is not None:  # a resumed fit begins there
            self.lowest = squares
            best.follow(best.descent._replace(y=y.copy()))
        return r

    def jacobian(self, y: Array) -> LinearOperator:
        """∂r/∂y at y (Q,), as an operator."""
        from scipy.sparse.linalg import LinearOperator

        part, search = self.part, self.part.search
        p, objective = search.parameters(y), part.objective
        factor = search.coordinates.derivative(p)
        observed = [(run, KeptStates(run.comparison)) for run in objective.runs]
        simulated = [(run, *objective.simulate(run, p, at.update, plan=objective.plan(run))) for run, at in observed]
        by_position = [run.comparison.jacobian_of(at.states) for run, at in observed]
        groups = list(zip(self.weights, self.prior.groups, strict=True))

        def forward(z: Array) -> Array:
            direction = np.zeros(len(p))
            direction[part.fitted] = z.reshape(-1)
            direction *= factor
            above = []
            for (run, system, memory), B in zip(simulated, by_position, strict=True):
                along = changes(run.scene, run.cloth, p, direction)
                above.append(B @ adjoint.tangent(system, memory, along, objective.tolerance).reshape(-1))
            return np.concatenate([*above, *(w * self.spread(z.reshape(-1)[g]) for w, g in groups)])

        def back(r: Array) -> Array:
            gradient, out, start = np.zeros(len(p)), np.zeros(part.size), 0
            for (run, system, memory), B in zip(simulated, by_position, strict=True):
                weight = (B.T @ r[start : start + B.shape[0]]).reshape(-1, *system.x0.shape)
                start += B.shape[0]
                objective.add_pullback(run, p, system, memory, weight, gradient)
            out += (gradient * factor)[part.fitted]
            for w, g in groups:
                out[g] += w * self.spread(r[start : start + len(g)])
                start += len(g)
            return out

        return LinearOperator((self.count, part.size), matvec=forward, rmatvec=back, dtype=np.float64)

    def spread(self, z: Array) -> Array:
        """P z of one group of the prior."""
        return np.asarray(z - z.mean() if self.prior.learns else z)
