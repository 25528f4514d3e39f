"""What every optimiser is given: a cost that never fails, in scaled coordinates, and a memory of the best point.

`coordinates` says how the parameters are scaled. The cost is scaled to 1 at the first point. Where the simulation
diverges or the cost overflows, the optimiser sees a bowl around the best point so far, above every cost met, so its
line search steps back. Three small objects stand beside the cost: the best point so far, the budget (`status`), and
what is reported (`progress`).
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from copy import copy
from functools import partial
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from clothfit.base import interrupts
from clothfit.base.arrays import Array
from clothfit.kernels.clock import clock_of
from clothfit.motion.divergence import Diverged
from clothfit.objective.comparison import UNITS
from clothfit.objective.objective import Objective
from clothfit.optimise.checkpoint import Checkpoint, State
from clothfit.optimise.coordinates import Coordinates
from clothfit.optimise.progress import Progress, Reporter
from clothfit.optimise.status import Budget, ModelFit, Status, Stop
from clothfit.scene.fit_vector import at_lower, at_upper, bounds, with_parameters

if TYPE_CHECKING:
    from clothfit.optimise.along_target import SingleSteps
    from clothfit.optimise.prior import Prior

STATIONARY = 1e-5
"""Converged at once where a change of any one parameter by a factor e would change the cost, linearly, by less than
this fraction.
"""

FLAT = 5e-2
"""A stall is convergence (at the floor that noise or the model sets) where the same measure is below this."""

PLATEAU, SHAKE = 1e-3, 0.5
"""No convergence where the cost changes by less than this fraction though every parameter moves by a factor e^SHAKE,
every other one down: far from a minimum, the motion may no longer depend on the parameters at all.
"""

SAME_POINT = 1e-12
"""Relative distance of points that differ by the rounding of coordinates."""

SEEN, SEEN_PART = 1e-3, 5e-4
"""Error, m, and relative to the distance travelled, above which a fit to a motion of its own model has not come to it,
whatever minimum it has come to.
"""

HEIGHT = 1e3
"""Height of the bowl at its bottom, relative to the largest cost met; twice that at distance 1 from the best point."""


class Descent(NamedTuple):
    """Gauss–Newton by stages, of which each can begin anew; with a prior it may end at a larger cost."""

    prior: Prior
    y: Array  # (Q,), where the stage begins; in the last one, the point that was accepted last
    radius: float  # of its trust region; 0: not chosen yet
    window: int  # frames that it compares
    before: Array  # (P,), the best point before it
    before_cost: float


class Point(NamedTuple):
    """A point that a search has visited, over all frames."""

    p: Array  # (P,)
    cost: float
    gradient: Array  # (P,), of the last best point that was evaluated with one
    prior: Prior | None  # what it was found with


class Belief(NamedTuple):
    """A prior while a descent looks for points with it."""

    prior: Prior
    penalty: Callable[[Array], float]  # of parameters (P,), beside the cost
    ceiling: float  # the best cost before the descent, which no result may exceed


class BestSoFar:
    """The best point of a search, which no worse one can replace.

    A point is better where its cost is lower. During a descent with a prior it is better where cost and penalty are
    lower, by the prior of the moment, if its cost is not above that of the best point before the descent.
    """

    def __init__(self, p: Array) -> None:
        """`p` (P,): where the search starts."""
        self.point = Point(p, np.inf, np.zeros(len(p)), None)  # replaced as a whole: a signal may come at any time
        self.belief: Belief | None = None  # by which points are compared; None: by their cost alone
        self.descent: Descent | None = None  # that is under way

    @property
    def p(self) -> Array:
        """The parameters (P,)."""
        return self.point.p

    @property
    def cost(self) -> float:
        """Their cost."""
        return self.point.cost

    @property
    def gradient(self) -> Array:
        """Its gradient (P,), of the last best point that was evaluated with one."""
        return self.point.gradient

    @property
    def prior(self) -> Prior | None:
        """The prior that the point was found with."""
        return self.point.prior

    def offer(self, p: Array, cost: float, gradient: Array | None = None) -> bool:
        """Take parameters (P,) of that cost, and gradient (P,) where it is known, if they are better."""
        better = self.is_better(p, cost)
        if better:
            interrupts.hold()
            prior = self.belief.prior if self.belief else None
            self.point = Point(p, cost, self.gradient if gradient is None else gradient, prior)
        return better

    def is_better(self, p: Array, cost: float) -> bool:
        """Whether parameters (P,) of that cost are better than the best so far."""
        if self.belief is None:
            return cost < self.cost
        _, penalty, ceiling = self.belief
        return cost <= ceiling and (cost + penalty(p) < self.cost + penalty(self.p))

    def believe(self, prior: Prior, penalty: Callable[[Array], float]) -> None:
        """Compare points by cost and penalty from now on, with this prior."""
        before = self.descent.before_cost if self.descent else self.cost
        self.belief = Belief(prior, penalty, before)

    def found_with(self, prior: Prior | None) -> None:
        """Name the prior that the best point was found with."""
        self.point = self.point._replace(prior=prior)

    def go_on(self, **changes: Any) -> None:
        """Change what is known of the descent that is under way, if any."""
        self.descent = self.descent and self.descent._replace(**changes)


class Search:
    """The cost of one fit in the coordinates y (Q,) of the parameters that can be identified."""

    def __init__(
        self,
        objective: Objective,
        start: Array,
        rmse_tolerance: float,
        budget: int,
        report: Callable[[Progress], None] | None = None,
        start_cost: float = np.inf,
    ) -> None:
        """`start` (P,): values of all parameters; those that cannot be identified keep them. It is the best point so
        far where its cost is known.
        """
        self.objective, self.fitted, self.rmse_tolerance = objective, objective.identifiable, rmse_tolerance
        start = np.array(start, float)
        self.coordinates = Coordinates(objective.scene, start)
        self.start = np.where(self.fitted, self.coordinates.clipped(start), start)
        self.origin = self.start  # the values of the user, where something before this search has begun with them
        self.best = BestSoFar(self.start)
        self.budget = Budget(budget)
        unit = UNITS.get("".join(objective.weights), "m")  # of an objective that goes alone
        self.progress = Reporter(report, self.start, objective.frames, unit, clock_of(int(self.fitted.sum())))
        self.checkpoint: Checkpoint | None = None  # in which it keeps its state
        self.warnings: list[str] = []  # what the user should know
        self.levels: list[ModelFit] = []  # the models that were fitted from coarse to fine
        self.loose_tolerance: float | None = None  # tolerance of linear systems that the target may have been solved to
        self.longest = np.inf  # seconds of computing, after which a fit ends whose model cannot reproduce the target
        self.each = 0.0  # seconds of computing that the cost took when it was measured last
        self.model, self.substeps, self.integrator = "", 0, 0  # that were chosen for the fit, as in a `State`
        self.left_out: Sequence[str] = ()  # kinds, as there
        self.own = False  # whether the target is known to be a motion of the model
        self.single: tuple[Array, SingleSteps] | None = None  # values (P,) that take each step of the target
        self.stationary: Array | None = None  # (P,), a minimum by the metric of Gauss–Newton (`preconditioned`)
        self.unit, self.worst = 0.0, 0.0  # the first cost, and the largest
        self._shaken, self._plateau = np.nan, False  # the cost at which the plateau was looked for, and what was found
        if np.array_equal(self.start, start):  # it lies within the bounds
            self.best.point = self.best.point._replace(cost=start_cost)

    @property
    def y(self) -> Array:
        """Coordinates (Q,) of the best point."""
        return self.coordinates.y(self.best.p)[self.fitted]

    @property
    def bounds(self) -> list[tuple[float, float]]:
        """Bounds of the coordinates."""
        lower, upper = self.coordinates.lower[self.fitted], self.coordinates.upper[self.fitted]
        return list(zip(lower.tolist(), upper.tolist(), strict=True))

    def parameters(self, y: Array) -> Array:
        """All parameters (P,) at coordinates y (Q,)."""
        whole = np.zeros(len(self.best.p))
        whole[self.fitted] = y
        return np.where(self.fitted, self.coordinates.p(whole), self.best.p)

    def __call__(self, y: Array) -> tuple[float, Array]:
        """Scaled cost and its gradient (Q,). Raises Stop when the fit has ended or its budget is used up."""
        self.budget.check()
        p = self.parameters(y)
        cost, gradient = cost_and_gradient(self.objective, p)
        usable = bool(np.isfinite(cost) and np.isfinite(gradient).all())
        if usable:
            self._remember(p, cost, gradient)
        self.budget.count(self.best.cost)
        self.report()
        self._check_end()
        if not usable:
            return self._bowl(y)
        by_y = gradient * self.coordinates.change(p) / self.coordinates.weight
        return cost / self.unit, by_y[self.fitted] / self.unit

    @property
    def is_late(self) -> bool:
        """Whether a fit ends here whose model cannot reproduce the target."""
        return self.progress.computing >= self.longest

    def has_time(self, seconds: float) -> bool:
        """Whether so many more seconds of computing end before it is late."""
        return self.progress.computing + seconds <= self.longest

    def visit(self, p: Array) -> float:
        """The cost at parameters (P,), which become the best point where it is the lowest; infinite where the
        simulation diverges. Raises Stop as calling the search does.
        """
        cost = self.measure(p)
        self.accept(p, cost)
        return cost

    def measure(self, p: Array, objective: Objective | None = None) -> float:
        """The cost at parameters (P,), of another objective where one is given; it counts, but is not remembered."""
        self.count()
        if objective is None and self._is_known_start(p):
            return self.best.cost
        if objective is not None:
            return objective.cost_or_infinity(p)
        began, new = self.progress.computing, not self.objective.remembers(p)
        cost = self.objective.cost_or_infinity(p)
        self.each = self.progress.computing - began if new else self.each
        return cost

    def _is_known_start(self, p: Array) -> bool:
        """Whether parameters (P,) are those of the start, and it is the best point so far."""
        known = self.best.p is self.start and np.isfinite(self.best.cost)
        return bool(known and np.array_equal(p, self.start))

    def count(self) -> None:
        """Count an evaluation. Raises Stop when the budget is used up."""
        self.budget.check()
        self.budget.count(self.best.cost)

    def accept(self, p: Array, cost: float) -> None:
        """Make parameters (P,) of that cost the best point where they are. Raises Stop when the error is small enough.
        """
        if self.best.offer(p, cost) or self._is_known_start(p):
            self.advance(p)
            self.report()
        if self._is_near():
            raise Stop(Status.CONVERGED)

    def enter(self, stage: str, objective: Objective | None = None) -> None:
        """Name what is done from now on, and its objective: the search's own, or one of fewer frames."""
        self.progress.enter(stage, (objective or self.objective).frames)

    def advance(self, p: Array, window_rmse: float = np.nan) -> None:
        """Count a change to parameters (P,) that was accepted, with the error, m, of a window where it was there."""
        step = self.coordinates.relative_change(self.progress.p, p)[self.fitted].max(initial=0.0)
        self.progress.advance(p, float(step), window_rmse)

    def report(self) -> None:
        """Keep and report how far the search is, where there is a result."""
        if np.isfinite(self.best.cost):
            if self.checkpoint is not None:
                self.checkpoint.save(self.state)
            cost, budget = self.best.cost, self.budget
            best = partial(with_parameters, self.objective.scene, self.best.p)
            self.progress.report(budget.evaluations, budget.limit, cost, self.objective.rmse(cost), best)

    def add_level(self, level: ModelFit) -> None:
        """Note what a model of the hierarchy has come to, and keep it."""
        self.levels.append(level)
        if self.checkpoint is not None:
            self.checkpoint.save(self.state, now=True)

    def finish(self, status: Status) -> Status:
        """Keep how the search ended; "diverged" where there is no result."""
        self.best.belief = None
        status = Status.STALLED if status == Status.CONVERGED and self.misses_own else status
        if status in (Status.CONVERGED, Status.STALLED):
            self.best.descent = None
        if not np.isfinite(self.best.cost):
            return Status.DIVERGED
        if self.checkpoint is not None:
            self.checkpoint.save(lambda: self.state()._replace(status=status), now=True)
        return status

    def state(self) -> State:
        """What a resumed search goes on from."""
        best, none = self.best, np.zeros(0)
        prior, y, radius, window, before, before_cost = best.descent or (best.prior, none, 0.0, 0, none, 0.0)
        centre, tau = (prior.centre, prior.tau) if prior else (none, ())
        own = (best.prior.centre, best.prior.tau) if best.prior else (none, ())
        return State(
            self.start, best.p, best.cost, best.gradient, centre, tau, y, radius, window, before,
            before_cost, self.budget.history, self.budget.extra, self.progress.seconds, self.warnings,
            None, self.model, self.substeps, self.integrator, self.levels, *own, self.left_out,
        )  # fmt: skip

    def restore(self, state: State) -> None:
        """Go on from a state."""
        best = np.where(self.fitted, self.coordinates.clipped(state.best), self.start)
        self.best.point = Point(best, state.cost, state.gradient, None)
        self.budget.history, self.budget.extra = list(state.history), state.beside
        self.progress.began -= state.seconds
        self.warnings, self.levels = list(state.warnings), list(state.rungs)

    def warn(self, *texts: str) -> None:
        """Keep warnings for the user, each once."""
        self.warnings += [text for text in texts if text not in self.warnings]

    def aside(self, budget: int) -> Search:
        """This search with a budget of its own, whose evaluations nobody counts or reports."""
        other = copy(self)
        other.budget = Budget(budget)
        other.progress = Reporter(None, self.progress.p, self.progress.frames, clock=self.progress.clock)
        other.checkpoint = None
        return other

    def subsearch(self, objective: Objective, start: Array, cost: float) -> Search:
        """A search by other parameters, from `start` (P′,) of that cost, with the budget and the reports of this."""
        other = Search(objective, start, self.rmse_tolerance, self.budget.limit, start_cost=cost)
        other.budget, other.progress, other.warnings = self.budget, self.progress, self.warnings
        other.longest, other.each, other.own = self.longest, self.each, self.own
        other.single = self.single if objective is self.objective else None
        other.origin = self.origin if len(self.origin) == len(start) else other.start
        self.progress.p = other.start
        self.budget.enter_stage()
        return other

    def _remember(self, p: Array, cost: float, gradient: Array) -> None:
        self.unit = self.unit or max(cost, np.finfo(float).tiny)
        self.worst = max(self.worst, cost)
        if self.best.offer(p, cost, gradient):
            self.advance(p)
        elif np.allclose(p, self.best.p, rtol=SAME_POINT, atol=0.0):
            self.best.point = self.best.point._replace(gradient=gradient)  # the cost was known, the gradient was not

    def _bowl(self, y: Array) -> tuple[float, Array]:
        away = y - self.y
        height = HEIGHT * max(self.worst / self.unit if self.unit else 1.0, 1.0)
        return float(height * (1.0 + away @ away)), 2.0 * height * away

    def _check_end(self) -> None:
        if self._is_near() or (self._steepness() <= STATIONARY and not self.on_plateau()):
            raise Stop(Status.CONVERGED)
        if self.budget.is_stalled:
            raise Stop(self.verdict())

    @property
    def proven(self) -> SingleSteps | None:
        """How near the best point takes each step of the target, where it does so to rounding."""
        return self.single[1] if self.single is not None and np.array_equal(self.single[0], self.best.p) else None

    @property
    def misses_own(self) -> bool:
        """Whether the best motion is visibly not the target, though that is a motion of the model."""
        objective = self.objective
        if not (self.own and objective.plain and np.isfinite(self.best.cost)):
            return False
        visible = min(SEEN, SEEN_PART * objective.rms_displacement)
        return objective.rmse(self.best.cost) > max(visible, self.rmse_tolerance)

    def verdict(self) -> Status:
        """How the search ended, if it ends here: converged or stalled."""
        flat = self.is_stationary or self._steepness() <= FLAT
        at_minimum = self._is_near() or (flat and not self.on_plateau())
        return Status.CONVERGED if at_minimum else Status.STALLED

    @property
    def is_stationary(self) -> bool:
        """Whether the best point is a minimum by the metric of Gauss–Newton."""
        return self.stationary is not None and np.array_equal(self.stationary, self.best.p)

    def _is_near(self) -> bool:
        """Whether the error is small enough."""
        return self.objective.rmse(self.best.cost) <= self.rmse_tolerance

    def on_plateau(self) -> bool:
        """Whether the cost around the best point hardly depends on the parameters."""
        if self._shaken != self.best.cost:
            self._shaken = self.best.cost
            self._plateau = all(abs(cost / self.best.cost - 1.0) < PLATEAU for cost in self._around())
        return self._plateau

    def _around(self) -> list[float]:
        """The costs on two sides of the best point."""
        y, signs = self.y, np.where(np.arange(int(self.fitted.sum())) % 2 == 0, 1.0, -1.0)
        shift = SHAKE * self.coordinates.weight[self.fitted] * signs
        points = [self.parameters(y + shift), self.parameters(y - shift)]
        self.budget.extra += len(points)
        return [self.objective.cost_or_infinity(p) for p in points]

    def _steepness(self) -> float:
        """Largest change of the best cost by a parameter's change by a factor e (by σ where its coordinate is linear),
        linearly, as a fraction of that cost.
        """
        if not (np.isfinite(self.best.cost) and self.best.cost > 0):
            return np.inf
        lower, upper = bounds(self.objective.scene)
        change = self.best.gradient * self.coordinates.change(self.best.p)
        change[~self.fitted] = 0.0
        held = (at_lower(self.best.p, lower) & (change > 0)) | (at_upper(self.best.p, upper) & (change < 0))
        change[held] = 0.0  # the bounds allow no descent
        return float(np.abs(change).max(initial=0.0) / self.best.cost)


def cost_and_gradient(objective: Objective, p: Array) -> tuple[float, Array]:
    """Cost and gradient (P,) at p (P,); infinite and 0 where the simulation diverges."""
    try:
        return objective.cost_and_gradient(p)
    except Diverged:
        return np.inf, np.zeros(len(p))
