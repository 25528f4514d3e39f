"""How well the data determine the fitted parameters: which the motion does not show, and 95 % intervals for the rest.

An interval is z ± t √C_jj (`posterior`) with Student's t of N − γ degrees of freedom, mapped back and cut at the
bounds. With a prior it covers the truth as often as it says on the average over the parameters, not for each of them
(docs/accuracy.md). Where the fit did not reach its minimum, the step that is left is added to the half width, so that
an interval reaches as far as that around the minimum would.

What the motion does not show: with H scaled to a unit diagonal, a direction whose eigenvalue is rounding leaves the
motion as it is. A parameter that has a share in such a direction, or at a minimum a standard deviation beyond the
whole width of its bounds, is not determined. Its way from the start along such directions is taken back: a parameter
that does nothing keeps its start, and masses and stiffnesses that are free up to a common factor keep the start's
mean.

Where the fit is exact and the target shows every balance of momentum, these replace the residuals: a direction that
they do not show is one that the motion does not show, and they are found in a tenth of the time. What is left of them
is no noise but the error of the linear systems, so an interval is the bound that its size sets.

Where the residuals are no noise at all, as the model differs, the covariance comes from blocks of them, or
there are no intervals. Of too many values for a matrix they come from samples (`sampled`). Where the motion is chaotic,
its sensitivities grow so far that all but one direction look like rounding beside that: nothing is said of what the
motion shows.

Intervals of so many values that the matrix of their fit would take minutes: by samples of the posterior.

The standard deviations are those of K samples (`matrix_free.Sampling`), so each of them is known to 1 / √(2 K), and the
intervals have Student's t of K degrees of freedom, wider for it. The rest is meant as above: the step that is
left adds to the half width, values that the data push against a bound have intervals inwards only, and a value that
changes nothing which is compared has none, nor one whose deviation is beyond the width of its bounds. What the motion
does not show as a combination of values, the prior alone determines; it is not named, nor taken back.
"""

from __future__ import annotations

import time
from dataclasses import dataclass, replace
from functools import partial

import numpy as np
from numpy.typing import NDArray

from clothfit.base import interrupts
from clothfit.base.arrays import Array, Flags
from clothfit.base.eigen import eigen
from clothfit.engine.system import mobile
from clothfit.fit import inextensible
from clothfit.fit.alternatives import Alternatives
from clothfit.fit.options import RMSE_TOLERANCE
from clothfit.fit.posterior import CHAOS, MOST_VALUES, Local, Posterior, blocks_of, half_width, learned_prior, posterior
from clothfit.motion.divergence import Diverged
from clothfit.objective.identifiability import Correlation, strongest
from clothfit.objective.objective import Objective
from clothfit.objective.running_cost import running_cost
from clothfit.optimise import momentum, trajectory
from clothfit.optimise.evidence import variance
from clothfit.optimise.gauss_newton import Model
from clothfit.optimise.matrix_free import Products, Sampling
from clothfit.optimise.search import Search
from clothfit.optimise.trajectory import Kept, Trajectory
from clothfit.scene.fit_vector import at_lower, at_upper, bounds, of_kinds

NULL_SHARE = 1e-4
"""Part of a parameter in the directions that are not shown, from which on it counts as not determined."""

SAME_COST = 1e-2
"""Rise of the cost, in variances of a residual, that means nothing."""


LOOSE = 1e-5
"""Tolerance of the linear systems of sensitivities, where what a wrong model leaves sets the intervals."""

CHAOTIC = (
    "no intervals: the motion is chaotic, its sensitivity to the values grows by {:.1g} within {} frames; fit fewer "
    "frames"
)
UNTRUSTED = "no intervals: the model differs, and for so many values, or so few frames, none could be trusted"
DISAGREEING = "no intervals: the model differs, and what one part of the motion says of the values, no other confirms"


SAMPLES = 16
"""K: of as many the deviations are known to a sixth."""

PRODUCTS_TOLERANCE = 1e-6
"""Of the linear systems of products."""

CONVERGED, ROUGHLY = 0.05, 0.2
"""Change of the samples in a round, in standard deviations, at which they are done; and up to which they are of use
where the time is up.
"""

SHARE, LEAST_SECONDS = 1.0, 30.0
"""Seconds that they may take, relative to those of the fit; and at least."""

ROUNDS = 60

COPIES = 3
"""Arrays of all directions that a round works with."""

SEED = 20


@dataclass(frozen=True)
class Samples:
    """The samples that intervals are by."""

    count: int  # K
    accuracy: float  # relative standard error of a standard deviation


@dataclass(frozen=True)
class Confidence:
    """What the data say of all parameters (P,) of a fit."""

    p: Array  # the result, with what the motion does not show set back
    cost: float  # there
    low: Array  # of the intervals; NaN where there is none
    high: Array
    undetermined: Flags  # fitted parameters that the motion does not determine
    rank: int | None  # directions that it shows; None where that cannot be known
    sigma: float  # standard deviation of a residual; m where positions are compared
    warning: str | None = None  # why there are no intervals
    correlations: tuple[Correlation, ...] = ()  # of what is hard to tell apart, strongest first
    samples: Samples | None = None  # that the intervals are by; None: by the matrix
    least: Array | None = None  # (P,): lower bounds of what has no upper end; NaN where there is none


@dataclass(frozen=True)
class NullSpace:
    """What the motion does not show of the F free parameters."""

    flags: Flags  # (F,): parameters that are not determined
    directions: Array  # (F, ·), orthonormal


def confidence(search: Search, differs: bool, others: Alternatives | None = None) -> Confidence | None:
    """What the data say at the best point of a search, where what is left is no noise if the model `differs`; `others`
    may be there unnoticed.

    None where that would take too long (`trajectory.LARGEST`) or too much memory, or where nothing could be evaluated
    or a step of the motion is singular.
    """
    loose = max(LOOSE, search.objective.tolerance) if differs else None
    problem = Trajectory(search.aside(budget=100), search.objective, loose)
    near = search.own and search.objective.rmse(search.best.cost) <= search.objective.rounding
    exact = near or search.proven is not None or is_exact(search, search.best.cost)
    quick = balances(search) if exact else None
    expensive = quick is None and (problem.operations() > trajectory.LARGEST or not problem.fits())
    if not np.isfinite(search.best.cost):
        return None
    try:
        if expensive:
            return None if differs or exact else found_by_samples(search)
        return found_with(problem, quick, differs, others)
    except (Diverged, np.linalg.LinAlgError):
        return None


def found_with(
    problem: Trajectory, quick: tuple[Model, float, int] | None, differs: bool, others: Alternatives | None
) -> Confidence:
    """The confidence by the model of a trajectory, or by a `quick` one with its squares and count. Raises Diverged."""
    search, kept = problem.search, Kept(problem.size <= MOST_VALUES)
    seen = residual_squares(search.objective, search.best.p)
    model, squares, count = quick or (problem.model(search.y, kept.keep), *seen)
    known = posterior(Local(search, model, squares, count, learned_prior(search, model, squares, count)))
    noise = variance(*seen, known.determined)  # of a residual of the motion
    if kept.growth > CHAOS:
        return without_intervals(known, noise, CHAOTIC.format(kept.growth, search.objective.steps + 1))
    wrong = quick is None and differs
    known = replace(known, blocks=blocks_of(kept, known.local.scale) if wrong else None)
    width, reach = reaches(known, quick is not None, None if wrong else others)
    stiff = np.zeros(problem.size, bool) if wrong or quick else unlimited(known, reach)
    null_space = null_space_of(known, not wrong, stiff)
    p, cost = set_back(known, null_space, noise, search.start)
    rank, spread = problem.size - null_space.directions.shape[1], float(np.sqrt(noise))
    low, high = intervals(known, null_space, reach)
    found = Confidence(p, cost, low, high, known.whole(null_space.flags), rank, spread)
    found = from_below(found, problem, known, stiff, width) if stiff.any() else found
    if wrong and known.blocks is None:
        # what changes the motion together with others is not trusted either; what changes nothing is not shown
        nothing, alone = np.full(len(p), np.nan), np.linalg.norm(known.null, axis=1) > 1.0 - NULL_SHARE
        unseen = known.whole(null_space.flags & alone)
        return replace(found, low=nothing, high=nothing, undetermined=unseen, warning=UNTRUSTED)
    found = replace(found, correlations=correlated(known, null_space))
    return replace(found, warning=DISAGREEING) if wrong and np.isnan(low).all() else found


def found_by_samples(search: Search) -> Confidence | None:
    """The confidence by samples, without combinations of values; None where they are of no use. Raises Diverged."""
    squares, count = residual_squares(search.objective, search.best.p)
    sampling = sampled(search, squares, count)
    if sampling is None:
        return None
    noise, coordinates, fitted = variance(squares, count, sampling.determined), search.coordinates, search.fitted
    t = half_width(min(float(SAMPLES), max(count - sampling.determined, 1.0)))
    deviation = np.sqrt(noise / sampling.sigma2) * sampling.deviation
    lost = ~sampling.shown | (deviation > (coordinates.upper - coordinates.lower)[fitted])
    down = np.where(lost, np.nan, t * deviation + np.abs(sampling.step))
    up, stuck = down.copy(), np.flatnonzero(~sampling.free)
    with np.errstate(divide="ignore"):
        reach = t * np.sqrt(noise / sampling.diagonal[stuck])
    weight, log = coordinates.weight[fitted][stuck], coordinates.log[fitted][stuck]
    reach = np.where(log, weight * np.log1p(reach / weight), reach)
    down[stuck], up[stuck] = inwards(search, stuck, reach)
    null_space = np.zeros(len(fitted), bool)
    null_space[fitted] = lost
    samples = Samples(SAMPLES, float(1.0 / np.sqrt(2.0 * SAMPLES)))
    best, spread, (low, high) = search.best, float(np.sqrt(noise)), ends_of(search, down, up)
    return Confidence(best.p, best.cost, low, high, null_space, None, spread, samples=samples)


def sampled(search: Search, squares: float, count: int) -> Sampling | None:
    """Samples at the best point of a search, whose residuals are noise with this sum of `squares` and `count`. None
    without a prior, or where they would take more memory or more seconds. Raises Diverged.
    """
    prior, part = search.best.prior, Trajectory(search, search.objective)
    fits = 8 * COPIES * part.size * (SAMPLES + 1) * ROUNDS <= part.objective.room  # all directions
    if prior is None or not prior.groups or not np.isfinite(prior.tau).all() or not fits:
        return None
    y, until = search.y, time.monotonic() + max(SHARE * search.progress.seconds, LEAST_SECONDS)
    products, generator = Products(part, y, PRODUCTS_TOLERANCE), np.random.default_rng(SEED)
    search.enter("intervals")
    if products.growth(generator.standard_normal(len(y))) > CHAOS:
        return None
    sigma2 = variance(squares, count, len(y) / 2.0)  # corrected below
    lower, upper = bounds(search.objective.scene)
    held = at_lower(search.best.p, lower)[search.fitted], at_upper(search.best.p, upper)[search.fitted]
    sampling = Sampling(products, prior, y, sigma2, SAMPLES, generator, held)
    for _ in range(ROUNDS):
        change = sampling.round()
        search.report()
        interrupts.check()
        if change <= CONVERGED or time.monotonic() > until:
            break
    return sampling if change <= ROUGHLY else None


def correlated(known: Posterior, null_space: NullSpace) -> tuple[Correlation, ...]:
    """The parameters that are hard to tell apart, of those that are determined."""
    search, own = known.local.search, np.flatnonzero(~null_space.flags)
    places = np.flatnonzero(search.fitted)[known.free[own]]
    return strongest(known.covariance[np.ix_(own, own)], places, search.objective.blocks)


def without_intervals(known: Posterior, noise: float, why: str) -> Confidence:
    """No intervals, and the result as it is: the model says nothing of which values the motion shows."""
    search = known.local.search
    nothing, none = np.full(len(search.fitted), np.nan), np.zeros(len(search.fitted), bool)
    return Confidence(search.best.p, search.best.cost, nothing, nothing, none, None, float(np.sqrt(noise)), why)


def is_exact(search: Search, cost: float) -> bool:
    """Whether a cost is that of an exact target, and good enough."""
    return search.objective.rmse(cost) <= min(search.rmse_tolerance, RMSE_TOLERANCE)


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


def null_space_of(known: Posterior, is_noise: bool, stiff: Flags | None = None) -> NullSpace:
    """The free parameters that are not determined, and the directions that the motion does not show; what a wrong model
    leaves, not `is_noise`, does not hide a parameter, nor are those (Q,) hidden of which it shows a lower bound.
    """
    width = known.local.width[known.free]
    flags = np.linalg.norm(known.null, axis=1) > NULL_SHARE
    bounded = False if stiff is None else stiff[known.free]
    wide = np.flatnonzero((known.deviation > width) & known.at_minimum & ~flags & is_noise & ~bounded)
    found = eigen(known.sigma2 * known.K[np.ix_(wide, wide)] / np.outer(width[wide], width[wide]))
    values, vectors = (np.full(len(wide), np.inf), np.eye(len(wide))) if found is None else found
    more = np.zeros((len(known.free), int((values > 1.0).sum())))
    more[wide] = width[wide, None] * vectors[:, values > 1.0]
    flags[wide] = True
    return NullSpace(flags, np.linalg.qr(np.concatenate([known.null, more], axis=1))[0])


def reaches(known: Posterior, exact: bool, others: Alternatives | None = None) -> tuple[Array, Array]:
    """How far (Q,) noise lets half the intervals reach in z, and how far they reach, as the result may be off a
    minimum. `exact`: what is left is no noise; `others` may be there unnoticed.
    """
    local, search, t = known.local, known.local.search, known.t
    width, moved, more = np.zeros((3, len(local.scale)))
    if others is not None:
        A = local.prior.matrix(known.sigma2) * np.outer(local.scale, local.scale)
        moved, more = others.widening(residual_variance(search), A)
    more = half_width(np.inf) ** 2 * more[known.free]
    if exact:  # |K Cᵀ r| ≤ sqrt(K_jj) |r|, whatever the r of a linear solver's tolerance are like
        t = max(t, float(np.sqrt(local.count)))
    held = np.setdiff1d(np.arange(len(width)), known.free)
    width[known.free], width[held] = np.sqrt((t * known.deviation) ** 2 + more), t * known.alone(held)
    reach = width.copy()
    reach[known.free] += np.abs(known.K @ known.derivative) + moved[known.free]
    return width, reach


def intervals(known: Posterior, null_space: NullSpace, reach: Array) -> tuple[Array, Array]:
    """Both ends (P,) of the intervals that reach so far (Q,) in z; NaN where there is none."""
    local, search = known.local, known.local.search
    down = np.zeros(len(local.scale))
    down[known.free] = np.where(null_space.flags, np.nan, reach[known.free])
    up = down.copy()
    held = np.setdiff1d(np.arange(len(down)), known.free)
    # the effect of a mass or stiffness at its lower bound grows in proportion to it; at the upper bound, to 1 / p
    beyond = np.where(search.coordinates.log[search.fitted][held], np.log1p(reach[held]), reach[held])
    down[held], up[held] = inwards(search, held, beyond)
    ends = ends_of(search, local.scale * down, local.scale * up)
    if known.blocks is not None:  # from bound to bound: nothing is known
        lower, upper = bounds(search.objective.scene)
        ends[:, (at_lower(ends[0], lower) & at_upper(ends[1], upper)) | ~np.isfinite(ends).all(axis=0)] = np.nan
    return ends[0], ends[1]


def unlimited(known: Posterior, reach: Array) -> Flags:
    """The parameters (Q,) that are stiffnesses of edges which hardly stretch, and whose 1/k has an interval, which
    reaches so far (Q,), that contains 0; those that the motion does not show at all have none, nor is there any away
    from a minimum.
    """
    search, found = known.local.search, np.zeros(len(reach), bool)
    if not known.at_minimum:
        return found
    shown = np.linalg.norm(known.null, axis=1) <= NULL_SHARE
    found[known.free] = (reach[known.free] >= 1.0) & shown
    held = np.setdiff1d(np.arange(len(found)), known.free)
    step = known.local.derivative(known.sigma2)[held] / np.maximum(np.diag(known.local.information)[held], 1e-300)
    found[held] = reach[held] - step >= 1.0  # −step ≥ 0 at an upper bound
    found &= of_kinds(search.objective.scene, ("stiffness",))[search.fitted]
    return found & inextensible.hardly_stretching(search.objective)[search.fitted] if found.any() else found


def from_below(found: Confidence, problem: Trajectory, known: Posterior, stiff: Flags, width: Array) -> Confidence:
    """What the data say with lower bounds of the parameters that are `stiff` (Q,), which are then kept so stiff that
    nobody sees it, where that costs as good as nothing. For many values the model at the best point says the bounds.
    Raises Diverged.
    """
    search, local, at = problem.search, known.local, np.flatnonzero(problem.fitted)[stiff]
    low, high, ratio = found.low.copy(), found.high.copy(), np.full(len(stiff), np.nan)
    ratio[stiff] = 1.0 / (1.0 + inextensible.SURE_BOUND * width[stiff])
    curvature = np.diag(local.information).copy()
    curvature[known.free] = 1.0 / np.diag(known.K)
    rises = (inextensible.SURE_BOUND * width) ** 2 * curvature
    if problem.size <= MOST_VALUES:
        for j in np.flatnonzero(stiff):
            exact = inextensible.lower_bound(problem, known, int(j), rises[j])
            ratio[j] = ratio[j] if np.isnan(exact) else exact
    ends = np.flatnonzero(problem.fitted)[np.intersect1d(known.free, np.flatnonzero(stiff))]  # others end at a bound
    least = np.full(len(low), np.nan)
    low[ends], high[ends], least[at] = np.nan, np.nan, search.best.p[at] * ratio[stiff]
    p, best, objective = inextensible.played(known, ratio, found.p), search.best.cost, search.objective
    cost, most = objective.cost_or_infinity(p), best + inextensible.UNSEEN * rises[stiff].min()
    if not cost <= max(min(most, objective.cost_or_infinity(search.start)), best):
        p, cost = found.p, found.cost
    return replace(found, p=p, cost=cost, low=low, high=high, least=least)


def ends_of(search: Search, down: Array, up: Array) -> Array:
    """Both ends (2, P) of intervals that reach so far (Q,) from the best point of a search; NaN where there is none."""
    ends = np.full((2, len(search.fitted)), np.nan)
    for end, y in zip(ends, (search.y - down, search.y + up), strict=True):
        end[search.fitted] = search.parameters(y)[search.fitted]
    return ends


def inwards(search: Search, held: NDArray[np.intp], reach: Array) -> tuple[Array, Array]:
    """How far (H,) down and up the intervals of parameters reach, of the Q, that are at a bound: from there only."""
    low = at_lower(search.best.p, bounds(search.objective.scene)[0])[search.fitted][held]
    return np.where(low, 0.0, reach), np.where(low, reach, 0.0)


def set_back(known: Posterior, null_space: NullSpace, noise: float, start: Array) -> tuple[Array, float]:
    """The best point (P,) without its way from the start along what is not shown, and its cost; the point as it is
    where that costs more, measured by the variance of a residual, `noise`. Raises Diverged.
    """
    search = known.local.search
    cost = search.best.cost
    for directions in (null_space.directions, known.null):
        if not directions.shape[1]:
            continue
        p = without(known, null_space.flags, directions, start)
        value = search.objective.cost_or_infinity(p)
        if value <= cost + SAME_COST * noise or (is_exact(search, value) and is_exact(search, cost)):
            return p, value
    return search.best.p, cost


def without(known: Posterior, lost: Flags, directions: Array, start: Array) -> Array:
    """The best point (P,) without its way from `start` (P,) along the directions (F, ·), which `lost` (F,) share."""
    search, free = known.local.search, known.free
    y, scale = search.y, known.local.scale[free]
    way = (y - search.coordinates.y(start)[search.fitted])[free] / scale
    y[free] -= scale * (directions @ (directions.T @ way))
    alone = known.whole(np.linalg.norm(directions, axis=1) > 1.0 - NULL_SHARE)
    return np.where(alone, start, np.where(known.whole(lost), search.parameters(y), search.best.p))


def residual_variance(search: Search) -> float:
    """The variance of a residual at the best point of a search, m² where positions are compared. Raises Diverged."""
    squares, count = residual_squares(search.objective, search.best.p)
    return variance(squares, count, float(min(search.fitted.sum(), count // 2)))


def residual_squares(objective: Objective, p: Array) -> tuple[float, int]:
    """Sum of squares and number N of the residuals that can change: not of the initial state nor of fixed vertices."""
    squares, count = 0.0, 0
    for run in objective.runs:
        show = partial(objective.simulate, run, p)
        part, number = running_cost(run.comparison).squares(mobile(run.system), show)
        squares, count = squares + part, count + number
    return squares, count
