"""Intervals of so many values that the matrix of their fit would take minutes: by samples of the posterior.

The standard deviations are those of K samples (`products.sampling`), so each of them is known to 1 / √(2 K), and the
intervals have Student's t of K degrees of freedom, wider for it. The rest is meant as in `confidence`: the step that is
left adds to the half width, values that the data push against a bound have intervals inwards only, and a value that
changes nothing which is compared has none, nor one whose deviation is beyond the width of its bounds. What the motion
does not show as a combination of values, the prior alone determines; it is not named, nor taken back.
"""

from __future__ import annotations

import time
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from clothfit.base import interrupts
from clothfit.base.arrays import Array, Flags
from clothfit.fit.posterior import CHAOS, half_width
from clothfit.optimise.evidence import variance
from clothfit.optimise.matrix_free import Products, Sampling
from clothfit.optimise.search import Search
from clothfit.optimise.trajectory import Trajectory
from clothfit.scene.fit_vector import at_lower, at_upper, bounds

SAMPLES = 16
"""K: of as many the deviations are known to a sixth."""

TOLERANCE = 1e-6
"""Of the linear systems of products."""

SETTLED, ROUGHLY = 0.05, 0.2
"""Change of the samples in a round, in standard deviations, at which they are done; and up to which they are of use
where the time is up.
"""

SHARE, LEAST = 1.0, 30.0
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


class Sampled(NamedTuple):
    """What samples say of the Q fitted coordinates y."""

    down: Array  # (Q,), how far an interval reaches; NaN where there is none
    up: Array
    hidden: Flags  # (Q,): values that the motion does not determine
    sigma: float  # standard deviation of a residual
    samples: Samples


def sampled(search: Search, squares: float, count: int, seconds: float | None = None) -> Sampled | None:
    """The intervals at the best point of a search, whose residuals are noise with this sum of `squares` and `count`.
    None without a prior, or where they would take more memory or more seconds. Raises Diverged.
    """
    prior = search.best.prior
    part = Trajectory(search, search.objective)
    if prior is None or not prior.groups or not np.isfinite(prior.tau).all() or not fits(part):
        return None
    y, began = search.y, time.monotonic()
    until = began + (max(SHARE * search.progress.seconds, LEAST) if seconds is None else seconds)
    sigma2 = variance(squares, count, len(y) / 2.0)  # corrected below
    products = Products(part, y, TOLERANCE)
    search.enter("intervals")
    generator = np.random.default_rng(SEED)
    if products.growth(generator.standard_normal(len(y))) > CHAOS:
        return None
    sampling = Sampling(products, prior, y, sigma2, SAMPLES, generator, held(search))
    change = np.inf
    for _ in range(ROUNDS):
        change = sampling.round()
        search.report()
        interrupts.check()
        if change <= SETTLED or time.monotonic() > until:
            break
    if change > ROUGHLY:
        return None
    noise = variance(squares, count, sampling.determined)
    return found(search, sampling, noise, count)


def found(search: Search, sampling: Sampling, noise: float, count: int) -> Sampled:
    """The intervals by samples that are done, with the variance of a residual, `noise`."""
    t = half_width(min(float(SAMPLES), max(count - sampling.determined, 1.0)))
    deviation = np.sqrt(noise / sampling.sigma2) * sampling.deviation
    ends = search.coordinates
    hidden = ~sampling.shown | (deviation > (ends.upper - ends.lower)[search.fitted])
    half = np.where(hidden, np.nan, t * deviation + np.abs(sampling.step))
    down, up = half.copy(), half.copy()
    stuck = np.flatnonzero(~sampling.free)
    with np.errstate(divide="ignore"):
        reach = t * np.sqrt(noise / sampling.diagonal[stuck])
    weight, log = ends.weight[search.fitted][stuck], ends.log[search.fitted][stuck]
    reach = np.where(log, weight * np.log1p(reach / weight), reach)
    low = at_lower(search.best.p, bounds(search.objective.scene)[0])[search.fitted][stuck]
    down[stuck], up[stuck] = np.where(low, 0.0, reach), np.where(low, reach, 0.0)
    return Sampled(down, up, hidden, float(np.sqrt(noise)), Samples(SAMPLES, float(1.0 / np.sqrt(2.0 * SAMPLES))))


def held(search: Search) -> tuple[Flags, Flags]:
    """Which values (Q,) are at their lower and at their upper bound."""
    p, (lower, upper) = search.best.p, bounds(search.objective.scene)
    return at_lower(p, lower)[search.fitted], at_upper(p, upper)[search.fitted]


def fits(part: Trajectory) -> bool:
    """Whether all directions fit into what the objective may hold."""
    return 8 * COPIES * part.size * (SAMPLES + 1) * ROUNDS <= part.objective.room
