"""Gauss–Newton of many parameters on a large cloth, where no matrix of the fit is ever formed.

Each iteration solves for the step from products with J and Jᵀ (`products`), some dozens of sweeps along the motion. Two
samples of the posterior go along: the directions that they ask for are good for the step as well, and they say how many
of the n values of an effect u (`priors.prior`) the data determine, from which its width follows:

    τ² = |u|² / γ,    γ = n − tr C / τ²,    C the covariance of u in the posterior

D. J. C. MacKay, Bayesian interpolation, Neural Computation 4, 1992.

A step that is too long for its trust region is the best one of the space that its solution has spanned. It ends as
`gauss_newton` does, where another step would save little beside the noise.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from clothfit.base.arrays import Array, Flags
from clothfit.motion.divergence import Diverged
from clothfit.optimise.evidence import variance
from clothfit.optimise.gauss_newton import EACH, ENOUGH, FIRST_RADIUS, GOOD, LEFT, MOST, POOR, SMALL, SMALLEST
from clothfit.optimise.prior import Prior
from clothfit.optimise.products import Products, Sampling
from clothfit.optimise.status import Status
from clothfit.optimise.trajectory import Trajectory

SAMPLES = 2
"""Samples beside each step."""

ITERATIONS, ROUGH_ITERATIONS = 40, 8
"""Steps at most, of all frames and of a part of them."""

ROUNDS, FEWEST_ROUNDS = 60, 5
"""Rounds of the solution of a step."""

FEW = 3 * ROUNDS
"""Values up to which the step is solved whole."""

SAVED, FINELY = 0.05, 0.01
"""Share of what a step saves that another round must add: at first, and near the end, where the step before saved less
than a tenth of the cost.
"""

TOLERANCE = 1e-7
"""Of the linear systems of products, relative."""

SLOW, ROUGH = 1e-4, 1e-3
"""Saving relative to the cost that ends a fit; and one of a part."""

LATE, SPAN = 0.01, 5.0
"""Saving relative to the cost in so many seconds of computing, below which a fit ends that is late and leaves more than
noise.
"""

WIDER = 2.0
"""Factor by which a width changes at most from one step to the next, and the radius."""

VECTORS = 12
"""Arrays of the size of the residuals that the method works with."""


def fits(part: Trajectory) -> bool:
    """Whether the method fits into what the objective may hold."""
    matrices = sum(run.comparison.jacobian_bytes for run in part.objective.runs)
    moves = sum((run.steps + 1) * run.system.x0.nbytes for run in part.objective.runs)
    spanned = 16 * (SAMPLES + 1) * ROUNDS * part.size
    return 8 * VECTORS * part.residuals() + matrices + 3 * moves + spanned <= part.objective.room


def minimise(part: Trajectory, y: Array, prior: Prior, whole: bool) -> tuple[Array, Prior, Status]:
    """Go down from y (Q,); returns the last point, the prior that it learned and how it ended. Raises Stop."""
    prior, radius = prior.reopened(), FIRST_RADIUS * np.sqrt(max(part.size, 1))
    generator, cost, last = np.random.default_rng(part.size), part.cost(y), np.inf
    determined = 0.5 * part.size
    tolerance = max(TOLERANCE, part.objective.tolerance)
    for _ in range(ITERATIONS if whole else ROUGH_ITERATIONS):
        sigma2, began = variance(cost, part.residuals(), determined), part.search.progress.computing
        part.believe(prior, sigma2)
        part.search.count()
        try:
            products = Products(part, y, tolerance)
        except Diverged:
            return y, prior, Status.STALLED
        ends = at_ends(y, *part.bounds)
        sampling = Sampling(products, prior, y, sigma2, SAMPLES, generator, ends, wide=False)
        saving = rounds(sampling, float(np.clip(0.1 * last, FINELY, SAVED)), part.search.report)
        determined = min(max(sampling.determined, 1.0), float(part.size))
        least = max(LEFT * sigma2, min(EACH * determined * sigma2, MOST * cost), (SLOW if whole else ROUGH) * cost)
        if saving <= least or max(saving / max(cost, np.finfo(float).tiny), last) <= SMALL:
            return y, prior, Status.CONVERGED
        last = saving / cost
        total = cost + prior.value(y, sigma2)
        while radius > SMALLEST * np.sqrt(part.size):
            step, predicted = sampling.within(radius)
            new = np.clip(y + step, *part.bounds)
            found = part.cost(new)
            saved = total - found - prior.value(new, sigma2)
            if saved >= ENOUGH * predicted:
                break
            radius = POOR * min(radius, float(np.linalg.norm(step)))
        else:
            return y, prior, Status.STALLED
        radius = WIDER * radius if saved > GOOD * predicted else radius / WIDER if saved < POOR * predicted else radius
        spans = (part.search.progress.computing - began) / SPAN
        slow = part.search.is_late and cost - found < LATE * spans * cost
        y, cost = new, found
        if prior.learns:
            prior = prior.rescaled(y - prior.centre, list(sampling.samples.T), 1.0 / WIDER, WIDER)
        best = part.search.best
        best.follow(best.descent and best.descent._replace(prior=prior, y=y.copy()))  # a resumed fit begins there
        part.search.report()
        if slow and not part.is_noise(y):
            return y, prior, Status.STALLED
    return y, prior, Status.LIMIT


def rounds(sampling: Sampling, least: float, waiting: Callable[[], None]) -> float:
    """Solve for the step until another round adds less than the share `least`; returns what it saves of the model.
    `waiting` is called after each round.
    """
    saved, size = 0.0, len(sampling.gradient)
    fewest = ROUNDS if size <= FEW else FEWEST_ROUNDS
    for number in range(ROUNDS):
        changed = sampling.round()
        waiting()
        before, saved = saved, -float(sampling.gradient @ sampling.step)
        if changed == 0.0 or (number + 1 >= fewest and saved - before <= least * saved):
            break
    return saved


def at_ends(y: Array, lower: Array, upper: Array) -> tuple[Flags, Flags]:
    """Which coordinates (Q,) are at their ends."""
    return y <= lower, y >= upper
