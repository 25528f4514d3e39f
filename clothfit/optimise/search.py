"""What every optimiser is given: a cost that never fails, in scaled coordinates, and a memory of the best point.

`coordinates` says how the parameters are scaled. The cost is scaled to 1 at the first point. Where the simulation
diverges or the cost overflows, the optimiser sees a bowl around the best point so far, above every cost met: its line
search steps back.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from typing import TYPE_CHECKING

import numpy as np

from clothfit.base.arrays import Array
from clothfit.motion.divergence import Diverged
from clothfit.objective.objective import Objective
from clothfit.optimise.coordinates import Coordinates
from clothfit.optimise.journal import Journal
from clothfit.optimise.status import Status, Stop
from clothfit.scene.fit_vector import at_lower, at_upper, bounds

if TYPE_CHECKING:
    from clothfit.optimise.prior import Prior

STATIONARY = 1e-5
"""Converged at once where a change of any one parameter by a factor e would change the cost, linearly, by less than
this fraction.
"""

STALL_EVALUATIONS, STALL_REDUCTION = 50, 1e-3
"""At an end where this many evaluations in a row reduced the best cost by less than this fraction …"""

FLAT = 5e-2
"""… which is convergence (at the floor that noise or the model sets) where the same measure is below this, else a
stall.
"""

PLATEAU, SHAKE = 1e-3, 0.5
"""No convergence where the cost changes by less than this fraction though every parameter moves by a factor e^SHAKE,
every other one down: far from a minimum, the motion may no longer depend on the parameters at all.
"""

HEIGHT = 1e3
"""Height of the bowl at its bottom, relative to the largest cost met; twice that at distance 1 from the best point."""


@dataclass(frozen=True)
class Progress:
    """What a fit tells while it runs."""

    evaluations: int
    budget: int  # evaluations allowed
    cost: float  # best so far, m²
    rmse: float  # best so far, m; of what is compared
    seconds: float
    iteration: int = 0  # changes of the parameters that were accepted so far
    step: float = np.nan  # the largest relative change of a parameter by the last of them
    stage: str = ""  # what is being done: a method, or what prepares it
    window: int = 0  # frames that are compared at this stage …
    frames: int = 0  # … of so many
    window_rmse: float = np.nan  # of the last accepted point, m, where that is of fewer than all frames


class Search:
    """The cost of one fit in the coordinates y of the parameters that can be identified (Q,)."""

    def __init__(
        self,
        objective: Objective,
        start: Array,
        rmse_tolerance: float,
        budget: int,
        report: Callable[[Progress], None] | None = None,
        journal: Journal | None = None,
    ) -> None:
        """`start` (P,): values of all parameters; those that cannot be identified keep them.

        The `journal` answers what it knows, keeps the rest, and is told how far the search is.
        """
        self.objective = objective
        self.fitted = objective.identifiable
        self.best = np.array(start, float)
        self.coordinates = Coordinates(objective.scene, self.best)
        self.best = np.where(self.fitted, self.coordinates.clipped(self.best), self.best)
        self.best_cost = np.inf
        self.best_gradient = np.zeros(len(start))
        self.prior: Prior | None = None  # what the best point was found with
        self.rmse_tolerance = rmse_tolerance
        self.budget = budget
        self.report = report
        self.journal = journal or Journal()
        self.journal.standing = self
        self.began = time.perf_counter() - self.journal.known.seconds
        self.notes: list[str] = []  # what the user should know
        self.history: list[float] = []  # best cost after each evaluation
        self.scale = self.coordinates.weight[self.fitted]
        self.stage, self.window, self.window_rmse = "start", objective.frames, np.nan
        self.iterations, self.step = 0, np.nan
        self._at = self.best  # the last accepted point, in a window or not
        self.unit = 0.0
        self.worst = 0.0
        self._shaken, self._plateau = np.nan, False  # the cost at which the plateau was looked for, and what was found

    @property
    def y(self) -> Array:
        """Coordinates (Q,) of the best point."""
        return self.coordinates.y(self.best)[self.fitted]

    @property
    def bounds(self) -> list[tuple[float, float]]:
        """Bounds of the coordinates."""
        lower, upper = self.coordinates.lower[self.fitted], self.coordinates.upper[self.fitted]
        return list(zip(lower.tolist(), upper.tolist(), strict=True))

    @property
    def evaluations(self) -> int:
        """How often cost and gradient were asked for."""
        return len(self.history)

    @property
    def seconds(self) -> float:
        """Time since the search began."""
        return time.perf_counter() - self.began

    def parameters(self, y: Array) -> Array:
        """All parameters (P,) at coordinates y (Q,)."""
        whole = np.zeros(len(self.best))
        whole[self.fitted] = y
        return np.where(self.fitted, self.coordinates.p(whole), self.best)

    def __call__(self, y: Array) -> tuple[float, Array]:
        """Scaled cost and its gradient (Q,). Raises Stop when the fit is finished or its budget is spent."""
        if self.evaluations >= self.budget:
            raise Stop(Status.LIMIT)
        p = self.parameters(y)
        answer = self.journal.recall("gradient", partial(cost_and_gradient, self.objective, p), p)
        cost, gradient = float(answer[0]), answer[1:]
        usable = bool(np.isfinite(cost) and np.isfinite(gradient).all())
        if usable:
            self._remember(p, cost, gradient)
        self.history.append(self.best_cost)
        self.tell()
        self._check_end()
        if not usable:
            return self._bowl(y)
        slope = gradient * self.coordinates.change(p) / self.coordinates.weight
        return cost / self.unit, slope[self.fitted] / self.unit

    def visit(self, p: Array) -> float:
        """The cost at parameters (P,), which becomes the best point where it is the lowest; infinite where the
        simulation diverges. Raises Stop as calling the search does.
        """
        cost = self.measure(p)
        if cost < self.best_cost:
            self.settle(p, cost)
        return cost

    def measure(self, p: Array, objective: Objective | None = None) -> float:
        """The cost at parameters (P,), of another objective where one is given; it counts, but is not remembered."""
        self.spend()
        goal = objective or self.objective
        name = f"cost of {goal.steps} steps"
        return float(self.journal.recall(name, lambda: np.array(goal.cost_or_infinity(p)), p))

    def spend(self) -> None:
        """Count an evaluation. Raises Stop when the budget is spent."""
        if self.evaluations >= self.budget:
            raise Stop(Status.LIMIT)
        self.history.append(self.best_cost)

    def settle(self, p: Array, cost: float) -> None:
        """Make parameters (P,) of that cost the best point. Raises Stop when the error is small enough."""
        self.best, self.best_cost = p, cost
        self.advance(p)
        self.tell()
        if self._near():
            raise Stop(Status.CONVERGED)

    def cost(self, y: Array) -> float:
        """Scaled cost alone, for methods without a gradient."""
        return self(y)[0]

    def standing(self) -> Array:
        """How the search stands, as numbers (3 + 2 P + evaluations,)."""
        return np.array([self.best_cost, self.unit, self.worst, *self.best, *self.best_gradient, *self.history])

    def stand(self, standing: Array) -> None:
        """Stand as the search did that gave these numbers. Raises Stop when the error is small enough."""
        count = len(self.best)
        self.unit, self.worst = float(standing[1]), float(standing[2])
        self.best_gradient, self.history = standing[3 + count : 3 + 2 * count], standing[3 + 2 * count :].tolist()
        self.settle(standing[3 : 3 + count], float(standing[0]))

    def enter(self, stage: str, objective: Objective | None = None) -> None:
        """Say what is done from now on, and on which objective: the search's own, or one of fewer frames."""
        self.stage, self.window = stage, (objective or self.objective).frames

    def advance(self, p: Array, window_rmse: float = np.nan) -> None:
        """Count a change to parameters (P,) that was accepted, with the error, m, of a window where it was there."""
        self.window_rmse = window_rmse
        if not np.array_equal(p, self._at):
            size = np.maximum(np.abs(self._at), self.coordinates.change(self._at))[self.fitted]
            change = np.abs(p - self._at)[self.fitted]
            self.step = float((change[size > 0] / size[size > 0]).max(initial=0.0))
            self.iterations, self._at = self.iterations + 1, p

    def note(self, text: str) -> None:
        """Tell the user something, once."""
        if text not in self.notes:
            self.notes.append(text)

    def take_known(self) -> None:
        """Make the best point that the journal knows the best one, where the way did not lead there again."""
        if self.journal.is_behind(self.best_cost):
            known = self.journal.known.best
            self.best, self.best_cost = known[1:], float(known[0])

    def _remember(self, p: Array, cost: float, gradient: Array) -> None:
        self.unit = self.unit or max(cost, np.finfo(float).tiny)
        self.worst = max(self.worst, cost)
        if cost < self.best_cost:
            self.best, self.best_cost, self.best_gradient = p, cost, gradient
            self.advance(p)

    def _bowl(self, y: Array) -> tuple[float, Array]:
        away = y - self.y
        height = HEIGHT * max(self.worst / self.unit if self.unit else 1.0, 1.0)
        return float(height * (1.0 + away @ away)), 2.0 * height * away

    def tell(self) -> None:
        """Report how far the search is, where there is a result."""
        if self.report and np.isfinite(self.best_cost) and not self.journal.repeating:
            rmse = self.objective.rmse(self.best_cost)
            at = (self.iterations, self.step, self.stage, self.window, self.objective.frames, self.window_rmse)
            self.report(Progress(self.evaluations, self.budget, self.best_cost, rmse, self.seconds, *at))

    def _check_end(self) -> None:
        if self._near():
            raise Stop(Status.CONVERGED)
        if self._slope() <= STATIONARY and not self.on_plateau():
            raise Stop(Status.CONVERGED)
        if len(self.history) > STALL_EVALUATIONS:
            before = self.history[-1 - STALL_EVALUATIONS]
            if np.isfinite(before) and self.best_cost > (1.0 - STALL_REDUCTION) * before:
                raise Stop(self.verdict())

    def verdict(self) -> Status:
        """How the search ended, if it ends here: converged or stalled."""
        at_minimum = self._near() or (self._slope() <= FLAT and not self.on_plateau())
        return Status.CONVERGED if at_minimum else Status.STALLED

    def _near(self) -> bool:
        """Whether the error is small enough."""
        return self.objective.rmse(self.best_cost) <= self.rmse_tolerance

    def on_plateau(self) -> bool:
        """Whether the cost around the best point hardly depends on the parameters."""
        if self._shaken != self.best_cost:
            self._shaken = self.best_cost
            y = self.y
            turns = SHAKE * self.scale * np.where(np.arange(len(y)) % 2 == 0, 1.0, -1.0)
            near = [self.objective.cost_or_infinity(self.parameters(y + t)) for t in (turns, -turns)]
            self._plateau = all(abs(cost / self.best_cost - 1.0) < PLATEAU for cost in near)
        return self._plateau

    def _slope(self) -> float:
        """Largest change of the best cost by a parameter's change by a factor e (by σ where its coordinate is linear),
        linearly, as a fraction of that cost.
        """
        if not (np.isfinite(self.best_cost) and self.best_cost > 0):
            return np.inf
        lower, upper = bounds(self.objective.scene)
        slope = self.best_gradient * self.coordinates.change(self.best)
        slope[~self.fitted] = 0.0
        stuck = (at_lower(self.best, lower) & (slope > 0)) | (at_upper(self.best, upper) & (slope < 0))
        slope[stuck] = 0.0  # the bounds allow no descent
        return float(np.abs(slope).max(initial=0.0) / self.best_cost)


def cost_and_gradient(objective: Objective, p: Array) -> Array:
    """Cost and gradient at p (P,) in one array (1 + P,); infinite and 0 where the simulation diverges."""
    try:
        cost, gradient = objective.cost_and_gradient(p)
    except Diverged:
        cost, gradient = np.inf, np.zeros(len(p))
    return np.array([cost, *gradient])
