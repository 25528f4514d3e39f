"""What the data say of the fitted parameters near the best point: its quadratic model and the posterior of that.

Near the result the residuals are r + J d (`trajectory`), with z = log p (p / σ_p for kinds that are fitted as
they are):

    H = JᵀJ,    A = the prior's matrix, 0 without one,    K = (H + A)⁻¹,    C = σ² K,    σ² = Σ r² / (N − γ)

with γ = tr H K the number of parameters that the data determine; without a prior that is their rank. With a prior, C is
the posterior's (G. Wahba, Bayesian confidence intervals, J. R. Statist. Soc. B 45, 1983).

Covariances where the model differs: from residuals as they are, correlated over many frames and many vertices.

A wrong model has no true value, so an interval is for the value that other frames would give. How far that may be is
seen from what the fit would be without each of B blocks of successive frames. With r + J d near the result, and of each
block H_b = JᵀJ and the score g_b = Jᵀr less the mean of all, leaving it out changes the values by

    d_b = (H + A − H_b)⁻¹ g_b,    C = 2 (B − 1) / B Σ_b d_b d_bᵀ + σ² K A K,    K = (H + A)⁻¹

the delete-a-block jackknife (CR3 of A. C. Cameron, D. L. Miller, A practitioner's guide to cluster-robust inference,
J. Human Resources 50, 2015); the 2, as other frames give another value, as uncertain as this one. A is the prior's
matrix, 0 without one. In place of K g_b, as in a sandwich of White, d_b does not forget that a block which says most of
a value has drawn it to itself. What a wrong model leaves in one part of a motion says little of another: the blocks are
as few and as long as can be, and Student's t has B − 1 degrees of freedom.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from clothfit.base.arrays import Array, Flags
from clothfit.base.eigen import eigen
from clothfit.optimise import trust_region
from clothfit.optimise.evidence import inverse, variance
from clothfit.optimise.gauss_newton import Model
from clothfit.optimise.prior import NARROWEST, Prior, none
from clothfit.optimise.search import Search
from clothfit.optimise.trajectory import Kept
from clothfit.scene.fit_vector import at_lower, at_upper, bounds

BLOCKS, SHORTEST_BLOCK = 3, 4
"""Blocks of all motions together, at least, below which nothing is said; and frames of one."""

OTHER_FRAMES = 2.0
"""Factor of the variance: other frames would give another value, as uncertain as this one."""

MOST_VALUES = 24
"""Values up to which so few blocks say something of each."""

CHAOS = 1e4
"""Growth of a sensitivity, from a quarter of a motion to its largest, above which no more is seen of it than that. A
motion that accelerates evenly has 16.
"""


class Blocks(NamedTuple):
    """What blocks of frames say."""

    information: Array  # H_b (B, Q, Q)
    scores: Array  # g_b (B, Q)

    @property
    def freedom(self) -> int:
        """Degrees of freedom."""
        return len(self.scores) - 1

    def covariance(self, own: NDArray[np.intp], K: Array) -> Array:
        """2 (B − 1) / B Σ_b d_b d_bᵀ (F, F) of the values `own` (F,), all others as they are, with their K (F, F); not
        finite where all that is known of them is from one block.
        """
        H, one = self.information[:, own[:, None], own], np.eye(len(own))
        try:
            changes = np.linalg.solve(one - K @ H, (self.scores[:, own] @ K)[..., None])[..., 0]
        except np.linalg.LinAlgError:
            return np.full((len(own), len(own)), np.inf)
        return np.asarray(OTHER_FRAMES * self.freedom / len(changes) * (changes.T @ changes))


def blocks_of(kept: Kept, scale: Array) -> Blocks | None:
    """The blocks of all runs in z, with ∂y/∂z = `scale` (Q,); None where there are too few, or too many values."""
    if len(scale) > MOST_VALUES:
        return None
    wanted = -(-BLOCKS // max(len(kept.runs), 1))  # of each run
    counts = [min(wanted, len(scores.parts) // SHORTEST_BLOCK) for _, scores in kept.runs]
    if sum(counts) < BLOCKS:
        return None
    found = [kept.blocks(run, count, len(scale)) for run, count in enumerate(counts)]
    H, g = (np.concatenate(each) for each in zip(*found, strict=True))
    g = g * scale
    return Blocks(H * np.outer(scale, scale), g - np.mean(g, axis=0))


COVERAGE = 0.95

VARIANCE_ROUNDS = 10  # of finding σ² and γ, which depend on each other
NULL_EIGENVALUE = 1e-12
"""Eigenvalue of H with a unit diagonal, relative to the largest, below which it is rounding."""


def half_width(freedom: float) -> float:
    """How many standard deviations half an interval of `COVERAGE` has: Student's t for `freedom` degrees, above 0."""
    from scipy.special import stdtrit  # takes long to import

    return float(stdtrit(freedom, 0.5 + COVERAGE / 2))


@dataclass(frozen=True)
class Local:
    """The cost around the best point of a search, in the coordinates z (Q,) of the fitted parameters."""

    search: Search
    model: Model  # in the coordinates of the search, y = scale · z
    squares: float  # Σ r²
    count: int  # N
    prior: Prior

    @cached_property
    def scale(self) -> Array:
        """∂y/∂z (Q,)."""
        return np.asarray(self.search.coordinates.weight[self.search.fitted])

    @cached_property
    def information(self) -> Array:
        """H = JᵀJ (Q, Q)."""
        return np.asarray(self.model.H * np.outer(self.scale, self.scale))

    @property
    def width(self) -> Array:
        """Distance (Q,) of the bounds."""
        ends = self.search.coordinates
        return (ends.upper - ends.lower)[self.search.fitted] / self.scale

    def derivative(self, sigma2: float) -> Array:
        """Half the derivative (Q,) of cost and penalty by z."""
        A = self.prior.matrix(sigma2)
        return np.asarray(self.scale * (self.model.g + A @ (self.model.y - self.prior.centre)))

    def held(self) -> Flags:
        """Which parameters (Q,) the data push against a bound, more than noise does: where the cost hardly depends on a
        value, or on a factor of all, chance alone may have led there, and the others are not known any better for it.
        """
        p, (lower, upper) = self.search.best.p, bounds(self.search.objective.scene)
        sigma2 = variance(self.squares, self.count, 0.0)
        derivative = self.derivative(sigma2)
        derivative[derivative**2 <= sigma2 * np.diag(self.information)] = 0.0
        down, up = at_lower(p, lower)[self.search.fitted], at_upper(p, upper)[self.search.fitted]
        return np.asarray((down & (derivative > 0)) | (up & (derivative < 0)))


@dataclass(frozen=True)
class Posterior:
    """What the data say of the F parameters that they do not hold at a bound."""

    local: Local
    free: NDArray[np.intp]  # (F,), among the Q
    null: Array  # (F, ·), orthonormal: directions that leave the motion as it is
    K: Array  # (F, F)
    determined: float  # γ
    sigma2: float
    blocks: Blocks | None = None  # of scores in z (B, Q), where residuals are no noise

    @cached_property
    def deviation(self) -> Array:
        """Standard deviations (F,)."""
        if self.blocks is None:
            return np.asarray(np.sqrt(self.sigma2 * np.maximum(np.diag(self.K), 0.0)))
        scale, here = self.local.scale, np.ix_(self.free, self.free)
        A = (self.local.prior.matrix(self.sigma2) * np.outer(scale, scale))[here]
        believed = self.sigma2 * np.einsum("ij,jk,ki->i", self.K, A, self.K)
        variances = np.diag(self.blocks.covariance(self.free, self.K)) + believed
        return np.asarray(np.sqrt(np.maximum(variances, 0.0)))

    @property
    def covariance(self) -> Array:
        """C (F, F)."""
        if self.blocks is None:
            return np.asarray(self.sigma2 * self.K)
        scale, here = self.local.scale, np.ix_(self.free, self.free)
        A = (self.local.prior.matrix(self.sigma2) * np.outer(scale, scale))[here]
        return np.asarray(self.blocks.covariance(self.free, self.K) + self.sigma2 * self.K @ A @ self.K)

    @cached_property
    def t(self) -> float:
        """How many standard deviations half an interval has."""
        freedom = self.local.count - self.determined if self.blocks is None else self.blocks.freedom
        return half_width(max(freedom, 1.0))

    def alone(self, places: NDArray[np.intp]) -> Array:
        """Standard deviations (H,) of parameters of the Q if all others were known."""
        information = np.diag(self.local.information)[places]
        with np.errstate(divide="ignore", invalid="ignore"):
            if self.blocks is None:
                return np.asarray(np.sqrt(self.sigma2 / information))
            given = [1.0 / np.full((1, 1), each) for each in information]
            own = [float(self.blocks.covariance(at, K)[0, 0]) for at, K in zip(places[:, None], given, strict=True)]
            return np.asarray(np.where(information > 0, np.sqrt(own), np.inf))

    @cached_property
    def derivative(self) -> Array:
        """Half the derivative (F,) of cost and penalty by z."""
        return self.local.derivative(self.sigma2)[self.free]

    @property
    def at_minimum(self) -> bool:
        """Whether the step that is left would save no more than noise does, so that σ² is that of noise."""
        return float(self.derivative @ self.K @ self.derivative) <= self.sigma2 * max(len(self.free), 1)

    def whole(self, flags: Flags) -> Flags:
        """Flags (P,) of all parameters from those of the free ones (F,)."""
        found = np.zeros(len(self.local.search.fitted), bool)
        found[np.flatnonzero(self.local.search.fitted)[self.free[flags]]] = True
        return found


def posterior(local: Local) -> Posterior:
    """The posterior of the parameters that the data do not hold at a bound."""
    free = np.flatnonzero(~local.held())
    H, scale = local.information[np.ix_(free, free)], local.scale[free]
    null = null_space(H)
    determined = float(len(free) - null.shape[1])
    sigma2 = variance(local.squares, local.count, determined)
    if not local.prior.groups:
        return Posterior(local, free, null, inverse_outside(H, null), determined, sigma2)
    for _ in range(VARIANCE_ROUNDS):
        A = local.prior.matrix(sigma2)[np.ix_(free, free)] * np.outer(scale, scale)
        K = inverse(H + A)
        determined = float((H * K).sum())
        sigma2 = variance(local.squares, local.count, determined)
    return Posterior(local, free, null, K, determined, sigma2)


def learned_prior(search: Search, model: Model, squares: float, count: int) -> Prior:
    """The prior of the fit. A width that is learned may be less than while fitting, down to nothing beside the standard
    deviation of the mean, so that a cloth of one fabric gets the intervals of one value.
    """
    prior = search.best.prior
    if prior is None or prior.guards:
        return none(len(model.y))
    if not (prior.learns and prior.groups and squares > 0):
        return prior
    sigma2 = variance(squares, count, len(model.y))
    sums = [float(model.H[np.ix_(group, group)].sum()) for group in prior.groups]
    prior = replace(prior, narrowest=min([NARROWEST, *(0.1 * float(np.sqrt(sigma2 / s)) for s in sums if s > 0)]))
    return prior.learned_fully(model.H, model.g, model.y, squares, count)[0]


def null_space(H: Array) -> Array:
    """An orthonormal basis (F, ·) of the directions in which H is zero but for rounding."""
    unit, by = scaled(H)
    if is_regular(unit):
        return np.zeros((len(H), 0))
    found = eigen(unit)
    if found is None:  # nothing is known of any
        return np.eye(len(H))
    values, vectors = found
    null = vectors[:, values <= NULL_EIGENVALUE * values.max(initial=0.0)] / by[:, None]
    return np.asarray(np.linalg.qr(null / np.maximum(np.linalg.norm(null, axis=0), np.finfo(float).tiny))[0])


def is_regular(unit: Array) -> bool:
    """Whether no eigenvalue of a symmetric matrix (F, F) is near the rounding of the largest; faster than these."""
    largest = float(np.abs(unit).sum(axis=0).max(initial=0.0))  # at least
    return trust_region.factorised(trust_region.with_diagonal(unit, -2.0 * NULL_EIGENVALUE * largest)) is not None


def inverse_outside(H: Array, null: Array) -> Array:
    """The inverse (F, F) of H on the complement of its null space (F, ·)."""
    unit, by = scaled(H)
    if not null.shape[1]:
        return np.asarray(inverse(unit) / np.outer(by, by))
    basis = null * by[:, None]
    basis = np.linalg.qr(basis)[0]
    K = inverse(unit + basis @ basis.T) / np.outer(by, by)
    across = np.eye(len(H)) - null @ null.T
    return np.asarray(across @ K @ across)


def scaled(H: Array) -> tuple[Array, Array]:
    """H (F, F) with a unit diagonal, and the divisors (F,) of its rows and columns; zeros stay."""
    size = np.sqrt(np.maximum(np.diag(H), 0.0))
    size[size <= NULL_EIGENVALUE * size.max(initial=0.0)] = 0.0
    by = np.where(size > 0, size, 1.0)
    return H / np.outer(by, by) * np.outer(size > 0, size > 0), by
