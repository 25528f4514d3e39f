"""L-BFGS in the metric of Gauss–Newton: many values, and a target that their model cannot reproduce.

Where large residuals stay, steps of Gauss–Newton are no good ones: its quadratic model leaves out how the residuals
bend, and each step needs a new sensitivity, which costs as much as dozens of gradients. But its matrix knows which
combinations of the values the motion feels strongly and which hardly. In rounds, with that matrix at y₀,

    H + A = L Lᵀ,    u = Lᵀ (y − y₀),

the cost is nearly as steep in all directions of u, and L-BFGS needs few of its exact gradients. A is the ridge of a
weak belief that the values stay near y₀ in logarithms: it bounds the steps along what the motion does not show. Where
a chaotic motion makes H useless, and where values lie at their bounds, a round in the coordinates y themselves comes to
its help. J. Nocedal, S. J. Wright, Numerical Optimization, 2006, chapter 7.
"""

from __future__ import annotations

from bisect import bisect_right
from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np

from clothfit.base.arrays import Array
from clothfit.motion.divergence import Diverged
from clothfit.optimise.scipy_methods import lbfgs
from clothfit.optimise.search import Search
from clothfit.optimise.trajectory import Trajectory

FEW_VALUES = 16
"""Values up to which a round that has settled ends the descent: no direction is left that its metric does not know."""

ROUND, SHORT_ROUND = 60, 15
"""Evaluations of a round, after which the metric is worth a new one, and of one that is only to compare."""

SLOW_EVALUATIONS, SLOW_SECONDS, SLOW_SAVING = 12, 0.5, 5e-3
"""A round also ends where so many evaluations, and so many seconds of computing, lower the cost by less than this
fraction.
"""

STATIONARY = 0.1 * SLOW_SAVING / SLOW_EVALUATIONS
"""A round in the metric also ends where its gradient promises less than this fraction of the cost by one more step: a
tenth of what a slow round saves.
"""

METRIC_TOLERANCE = 1e-5
"""Of the linear systems for the metric, which it changes by less than a percent."""

POOR_ROUND = 0.01
"""Relative reduction of the cost, below which a round is followed by one of the other kind, or ends the descent."""

FARTHEST = 1e20
"""Bounds of coordinates that have none."""

WIDTH = 0.3
"""Standard deviation of the belief in the ridge, in logarithms."""

LEAST_RIDGE, STEEPER = 1e-10, 100.0
"""Ridge relative to the largest entry of H at least, and the factor of the next one where that is not enough."""


@dataclass
class Patience:
    """Ends a descent where so many more seconds of computing have saved less than a fraction of the cost; other work of
    the machine does not count.
    """

    clock: Callable[[], float]  # that of the fit (`kernels.clock`)
    seconds: float = 5.0
    saving: float = 0.01
    marks: list[tuple[float, float]] = field(default_factory=list)  # times, s, and the best costs then
    uncounted: float = 0.0  # seconds of computing that do not count

    def is_over(self, cost: float) -> bool:
        """Whether the descent ends here, at this best cost."""
        now = self.clock() - self.uncounted
        self.marks.append((now, cost))
        while len(self.marks) > 1 and self.marks[1][0] <= now - self.seconds:
            self.marks.pop(0)
        then, before = self.marks[0]
        return bool(now - then >= self.seconds and cost > (1.0 - self.saving) * before)


class RoundOver(Exception):
    """Ends a round from within the cost."""


class Stationary(RoundOver):
    """Ends it where another step would save next to nothing."""


def minimise(search: Search, patience: Patience | None = None) -> None:
    """Go down from the best point of a search, until two rounds in a row save little, or it is late. Raises Stop as the
    search does.
    """
    patience = patience or Patience(search.progress.clock)
    part, in_metric, poor = for_metric(search), True, 0
    while poor < 2 and not patience.is_over(search.best.cost) and not search.is_late:
        before, began = search.best.cost, patience.clock()
        root = metric(part, search.y) if in_metric else None
        patience.uncounted += patience.clock() - began
        search.budget.enter_stage()  # a round has its own end
        if in_metric and root is None:
            poor += 1
        elif descend(search, root, patience, least_saving=STATIONARY) and len(search.y) <= FEW_VALUES:
            search.stationary = search.best.p
            return
        else:
            poor = poor + 1 if search.best.cost > (1.0 - POOR_ROUND) * before else 0
        in_metric = in_metric != (poor > 0)


def one_round(search: Search, root: Array | None, most: int = SHORT_ROUND) -> None:
    """A round from the best point of a search, by default a short one, as `descend`. Raises Stop as the search does."""
    search.budget.enter_stage()  # a round has its own end
    if descend(search, root, Patience(search.progress.clock), most, STATIONARY):
        search.stationary = search.best.p


def for_metric(search: Search) -> Trajectory:
    """The trajectory whose sensitivity gives the metric: its systems are solved loosely."""
    return Trajectory(search, search.objective, max(METRIC_TOLERANCE, search.objective.tolerance))


def metric(part: Trajectory, y: Array) -> Array | None:
    """L (Q, Q), lower triangular, at y (Q,); None where the sensitivity overflows, or takes too much memory or time: as
    long as a simulation for each of a few values, for more of them hardly longer.
    """
    from scipy.linalg import lapack

    if not (part.fits() and part.search.has_time(part.search.each * min(len(y), FEW_VALUES))):
        return None
    try:
        with np.errstate(over="ignore", invalid="ignore"):
            model = part.model(y)
    except Diverged:
        return None
    if not (np.isfinite(model.H).all() and model.cost > 0):
        return None
    ridge = model.cost / max(part.residuals(), 1) / WIDTH**2
    ridge = max(ridge, LEAST_RIDGE * float(np.abs(model.H).max(initial=0.0)))
    fault = 1
    while fault:
        L, fault = lapack.dpotrf((model.H + ridge * np.eye(len(y))) / model.cost, lower=1, clean=1)
        ridge *= STEEPER
    return np.asarray(L)


def descend(
    search: Search, root: Array | None, patience: Patience, most: int = ROUND, least_saving: float = 0.0
) -> bool:
    """A round of L-BFGS from the best point, in the metric of L = `root` (Q, Q) or in the coordinates themselves.
    Returns whether it has ended in the metric where another step would save less than the fraction `least_saving`.
    """
    from scipy.linalg import solve_triangular

    y0, costs, times, first = search.y, [search.best.cost], [patience.clock()], 0.0
    lower, upper = np.array(search.bounds).T

    # near y₀ the cost c₀ changes by gᵀu + c₀ |u|²: by gᵀz + |z|²/2 in z = √(2 c₀) u
    scale = np.sqrt(2.0 * search.best.cost / search.unit) if search.unit else np.sqrt(2.0)

    def cost(z: Array) -> tuple[float, Array]:
        nonlocal first
        since = min(len(costs) - 1 - SLOW_EVALUATIONS, bisect_right(times, times[-1] - SLOW_SECONDS) - 1)
        slow = since >= 0 and costs[-1] > (1.0 - SLOW_SAVING) * costs[since]
        if slow or len(costs) > most or search.is_late or patience.is_over(search.best.cost):
            raise RoundOver
        y = z if root is None else y0 + solve_triangular(root, z / scale, lower=True, trans=1, check_finite=False)
        if not np.isfinite(y).all():
            raise RoundOver  # its numbers have overflowed
        value, gradient = search(np.clip(y, lower, upper))
        costs.append(search.best.cost)
        times.append(patience.clock())
        if root is None:
            return value, gradient
        inside = np.where((y > lower) & (y < upper), gradient, 0.0)
        by_z = np.asarray(solve_triangular(root, inside, lower=True, check_finite=False)) / scale
        with np.errstate(over="ignore"):
            promise = float(by_z @ by_z) / 2.0  # by which the cost changes at best, less where it is larger than c₀
        if least_saving * value > promise * min((first or value) / value, 1.0):
            raise Stationary
        first = first or value
        return value, by_z

    # of values with two ends L-BFGS-B takes the first step as long as the gradient, which is right for z; many values
    # come lower from a longer one, of 1
    far = FARTHEST if len(y0) <= FEW_VALUES else np.inf
    start, ends = (y0, search.bounds) if root is None else (np.zeros(len(y0)), [(-far, far)] * len(y0))
    try:
        lbfgs(cost, start, ends, limit=10 * ROUND)
    except RoundOver as end:
        return isinstance(end, Stationary)
    return False
