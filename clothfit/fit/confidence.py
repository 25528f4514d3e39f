"""How well the data determine what was fitted: what the motion does not show, and 95 % intervals for the rest.

Near the result the residuals are r + J d (`normal`), with z = log p (p / σ_p for kinds that are fitted as they are):

    H = JᵀJ,    A = the prior's matrix, 0 without one,    K = (H + A)⁻¹,    C = σ² K,    σ² = Σ r² / (N − γ)

with γ = tr H K the number of parameters that the data determine; without a prior that is their rank. An interval is
z ± t √C_jj with Student's t of N − γ degrees of freedom, mapped back and cut at the bounds. With a prior, C is the
posterior's (G. Wahba, Bayesian confidence intervals, J. R. Statist. Soc. B 45, 1983): such intervals cover the truth
as often as they say on the average over the parameters, not for each of them. Where the fit did not reach its
minimum, the step that is left is added to the half width, so that an interval reaches as far as that around the
minimum would.

What the motion does not show: with H scaled to a unit diagonal, a direction whose eigenvalue is rounding leaves the
motion as it is. A parameter that has a share in such a direction, or at a minimum a standard deviation beyond the
whole width of its bounds, is not determined. Its way from the start along such directions is taken back: a parameter
that does nothing keeps its start, and masses and stiffnesses that are free up to a common factor keep the start's
mean.

Where the fit is exact and the target shows every balance of momentum, these are taken in place of the residuals: a
direction that they do not show is one that the motion does not show, and they are found in a tenth of the time. What
is left of them is no noise but the tolerance of the linear systems, so an interval is the bound that its size sets.

Measured: noisy targets of a cloth of 5 × 5 vertices, 12 to 50 of each case, for masses, stiffnesses and both; of a
uniform fabric, equal, and scattering by 0.3 in their logarithm; 30 and 100 frames; noise of 0.2, 1 and 5 mm: 92 to
99 % of the intervals hold the truth, 96 % on the average. Where a scatter of a few percent drowns in the noise, the
data may say that there is none; the intervals are then those of one value, too narrow for some: 87 % at a scatter
of 3 % and 5 mm.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import partial

import numpy as np
from numpy.typing import NDArray

from clothfit.base.arrays import Array, Flags
from clothfit.fit.null_space import inverse_beside, null_space
from clothfit.motion.divergence import Diverged
from clothfit.objective.objective import Objective
from clothfit.objective.running_cost import running_cost
from clothfit.optimise import momentum, trajectory
from clothfit.optimise.gauss_newton import Model
from clothfit.optimise.prior import NARROWEST, Prior, inverse, none, variance
from clothfit.optimise.search import Search
from clothfit.optimise.trajectory import Trajectory
from clothfit.scene.fit_vector import at_lower, at_upper, bounds

COVERAGE = 0.95

SHARE = 1e-4
"""Part of a parameter in the directions that are not shown, from which on it counts as not determined."""

SAME = 1e-2
"""Rise of the cost, in variances of a residual, that says nothing."""

EXACT = 1e-8
"""Error, m, that no noise of a target is below."""

ROUNDS = 10  # of finding σ² and γ, which depend on each other
LEARNED = 4  # times that the prior learns its width, some rounds each


@dataclass(frozen=True)
class Confidence:
    """What the data say of all parameters (P,) of a fit."""

    p: Array  # the result, with what the motion does not show set back
    cost: float  # there
    low: Array  # of the intervals; NaN where there is none
    high: Array
    hidden: Flags  # fitted parameters that the motion does not determine
    rank: int  # directions that it shows
    sigma: float  # standard deviation of a residual; m where positions are compared


def confidence(search: Search, start: Array) -> Confidence | None:
    """What the data say at the best point of a search that began at `start` (P,).

    None where that would take too long (`trajectory.LARGEST`) or too much memory, or where nothing could be evaluated.
    """
    problem = Trajectory(search.aside(budget=100), search.objective)
    exact = search.objective.rmse(search.best.cost) <= min(search.rmse_tolerance, EXACT)
    quick = balances(search) if exact else None
    dear = quick is None and (problem.operations() > trajectory.LARGEST or not problem.fits())
    if not np.isfinite(search.best.cost) or dear:
        return None
    try:
        local = Local(problem, quick)
        p, cost = local.set_back(start)
    except Diverged:
        return None
    low, high = local.intervals()
    shown = problem.size - local.hidden.shape[1]
    return Confidence(p, cost, low, high, local.whole(local.lost), shown, float(np.sqrt(local.noise)))


def balances(search: Search) -> tuple[Model, float, int] | None:
    """The balances of momentum near the best point, as a model, with their sum of squares and number; None where the
    target does not show all of them.
    """
    y, p = search.y, search.best.p
    found = momentum.information(search.objective, p, search.fitted, search.coordinates.derivative(p))
    if found is None:
        return None
    H, g, squares, count = found
    return Model(y, squares, H, g), squares, count


class Local:
    """The cost around the best point of a search, in the coordinates z (Q,) of what is fitted.

    What the data push against a bound is held there; the other F parameters are free.
    """

    def __init__(self, problem: Trajectory, quick: tuple[Model, float, int] | None = None) -> None:
        """`quick`: what to take instead of the residuals of the motion. Raises Diverged."""
        self.search, self.fitted = problem.search, problem.fitted
        ends = self.search.coordinates
        self.per = ends.weight[self.fitted]  # y = per · z
        self.width = (ends.upper - ends.lower)[self.fitted] / self.per
        seen = residual_squares(self.search.objective, self.search.best.p)
        self.model, self.squares, self.count = quick or (problem.model(self.search.y), *seen)
        self.exact = quick is not None
        self.prior = self._prior()
        self.H = self.model.H * np.outer(self.per, self.per)
        self.free = np.flatnonzero(~self._held())
        self.null = null_space(self.H[np.ix_(self.free, self.free)])  # (F, ·), orthonormal
        self._solve()
        self._judge()
        self.noise = variance(*seen, self.determined)  # of a residual of the motion; σ² unless there is `quick`

    def _prior(self) -> Prior:
        """The prior of the fit; a width that is learned may be less than while fitting, down to nothing beside the
        standard deviation of the mean, so that a cloth of one fabric gets the intervals of one value.
        """
        prior, model = self.search.best.prior or none(int(self.fitted.sum())), self.model
        if not (prior.learns and prior.groups and self.squares > 0):
            return prior
        sigma2 = variance(self.squares, self.count, len(model.y))
        sums = [float(model.H[np.ix_(group, group)].sum()) for group in prior.groups]
        prior = replace(prior, narrowest=min([NARROWEST, *(0.1 * float(np.sqrt(sigma2 / s)) for s in sums if s > 0)]))
        for _ in range(LEARNED):
            prior, _ = prior.learned(model.H, model.g, model.y, self.squares, self.count)
        return prior

    def _held(self) -> Flags:
        """Which parameters (Q,) the data push against a bound."""
        p, (lower, upper) = self.search.best.p, bounds(self.search.objective.scene)
        slope = self._slope(variance(self.squares, self.count, 0.0))
        down, up = at_lower(p, lower)[self.fitted], at_upper(p, upper)[self.fitted]
        return np.asarray((down & (slope > 0)) | (up & (slope < 0)))

    def _slope(self, sigma2: float) -> Array:
        """Half the derivative (Q,) of cost and penalty by z."""
        A = self.prior.matrix(sigma2)
        return np.asarray(self.per * (self.model.g + A @ (self.model.y - self.prior.centre)))

    def _solve(self) -> None:
        """Find K (F, F), σ² and γ."""
        H, per = self.H[np.ix_(self.free, self.free)], self.per[self.free]
        self.determined = float(len(self.free) - self.null.shape[1])
        self.sigma2 = variance(self.squares, self.count, self.determined)
        if not self.prior.groups:
            self.K = inverse_beside(H, self.null)
            return
        for _ in range(ROUNDS):
            A = self.prior.matrix(self.sigma2)[np.ix_(self.free, self.free)] * np.outer(per, per)
            self.K = inverse(H + A)
            self.determined = float((H * self.K).sum())
            self.sigma2 = variance(self.squares, self.count, self.determined)

    def _judge(self) -> None:
        """Find which of the free parameters (F,) are not determined, and in which directions `hidden` (F, ·)."""
        width = self.width[self.free]
        self.deviation = np.sqrt(self.sigma2 * np.maximum(np.diag(self.K), 0.0))
        shared = np.linalg.norm(self.null, axis=1) > SHARE
        wide = np.flatnonzero((self.deviation > width) & self._arrived() & ~shared)
        values, vectors = np.linalg.eigh(self.sigma2 * self.K[np.ix_(wide, wide)] / np.outer(width[wide], width[wide]))
        more = np.zeros((len(self.free), int((values > 1.0).sum())))
        more[wide] = width[wide, None] * vectors[:, values > 1.0]
        self.hidden = np.linalg.qr(np.concatenate([self.null, more], axis=1))[0]
        self.lost = shared.copy()
        self.lost[wide] = True

    def _arrived(self) -> bool:
        """Whether the way that is left would save no more than noise does, so that σ² is that of noise."""
        slope = self._slope(self.sigma2)[self.free]
        return float(slope @ self.K @ slope) <= self.sigma2 * max(len(self.free), 1)

    def whole(self, flags: Flags) -> Flags:
        """Flags (P,) of all parameters from those of the free ones (F,)."""
        found = np.zeros(len(self.fitted), bool)
        found[np.flatnonzero(self.fitted)[self.free[flags]]] = True
        return found

    def intervals(self) -> tuple[Array, Array]:
        """Both ends (P,) of the intervals; NaN where there is none."""
        from scipy.special import stdtrit

        t = float(stdtrit(max(self.count - self.determined, 1.0), 0.5 + 0.5 * COVERAGE))
        if self.exact:  # |K Cᵀ r| ≤ sqrt(K_jj) |r|, whatever the r of a linear solver's tolerance are like
            t = max(t, float(np.sqrt(self.count)))
        left = self.K @ self._slope(self.sigma2)[self.free]
        down = np.zeros(len(self.width))
        down[self.free] = np.where(self.lost, np.nan, t * self.deviation + np.abs(left))
        up = down.copy()
        held = np.setdiff1d(np.arange(len(down)), self.free)
        down[held], up[held] = self._from_bound(held, t)
        ends = np.full((2, len(self.fitted)), np.nan)
        y, best = self.search.y, self.search.parameters
        ends[:, self.fitted] = best(y - self.per * down)[self.fitted], best(y + self.per * up)[self.fitted]
        return ends[0], ends[1]

    def _from_bound(self, held: NDArray[np.intp], t: float) -> tuple[Array, Array]:
        """How far (H,) down and up those reach that are at a bound: inwards only, and linearly in what they do.

        What a mass or stiffness at its lower bound does grows in proportion to it; at the upper bound, to 1 / p.
        """
        p, lower = self.search.best.p, bounds(self.search.objective.scene)[0]
        with np.errstate(divide="ignore"):
            reach = t * np.sqrt(self.sigma2 / np.diag(self.H)[held])
        reach = np.where(self.search.coordinates.log[self.fitted][held], np.log1p(reach), reach)
        low = at_lower(p, lower)[self.fitted][held]
        return np.where(low, 0.0, reach), np.where(low, reach, 0.0)

    def set_back(self, start: Array) -> tuple[Array, float]:
        """The best point (P,) without its way from the start along what is not shown, and its cost; the point as it is
        where that costs more. Raises Diverged.
        """
        best, cost = self.search.best.p, self.search.best.cost
        objective = self.search.objective
        for directions in (self.hidden, self.null):
            if not directions.shape[1]:
                continue
            p = self._without(directions, start)
            value = objective.cost_or_infinity(p)
            reached = max(objective.rmse(value), objective.rmse(cost)) <= min(self.search.rmse_tolerance, EXACT)
            if value <= cost + SAME * self.noise or reached:
                return p, value
        return best, cost

    def _without(self, directions: Array, start: Array) -> Array:
        """The best point without what it has of the directions (F, ·) more than `start` (P,)."""
        y, per = self.search.y, self.per[self.free]
        way = (y - self.search.coordinates.y(start)[self.fitted])[self.free] / per
        y[self.free] -= per * (directions @ (directions.T @ way))
        p = self.search.parameters(y)
        alone = self.whole(np.linalg.norm(directions, axis=1) > 1.0 - SHARE)
        return np.where(alone, start, np.where(self.whole(self.lost), p, self.search.best.p))


def residual_squares(objective: Objective, p: Array) -> tuple[float, int]:
    """Sum of squares and number N of the residuals that can change: not of the initial state nor of fixed vertices."""
    squares, count = 0.0, 0
    for run in objective.runs:
        show = partial(objective.simulate, run, p)
        part, number = running_cost(run.comparison).squares(run.system.vertex.free, show)
        squares, count = squares + part, count + number
    return squares, count
