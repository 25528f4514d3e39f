"""Samples of the posterior of many values, and the step to its mean, by products with J and the prior alone.

With e ~ N(0, 1) of the residuals, and x₀ a draw from the prior with the precision A (for σ² = 1), the solution of

    (H + σ² A) x = σ Jᵀ e + σ² A x₀,    H = JᵀJ,

has the covariance σ² (H + σ² A)⁻¹ of the posterior (G. Papandreou, A. Yuille, Gaussian sampling by local perturbations,
NIPS 2010). All of them are solved together (`block_gradients`), from the draws x₀ on: what few rounds leave undone is
then as wide as the prior, too wide and not too narrow. Beside them goes the step (H + σ² A) d = −g.

The preconditioner is the geometric mean of the diagonals of H and of σ² A: that of H + σ² A itself would leave what the
data hardly show to the end. The diagonal of H is the mean of (Jᵀ e)².
"""

from __future__ import annotations

import numpy as np

from clothfit.base.arrays import Array, Flags
from clothfit.optimise.priors.prior import Prior
from clothfit.optimise.products.block_gradients import BlockGradients
from clothfit.optimise.products.products import Products

PULLS = 8
"""Draws, at least, that the diagonal of H is the mean of."""

LEAST = 1e-12
"""Diagonal of H relative to the largest, below which a value changes nothing that is compared."""


class Sampling:
    """K samples x (Q, K), and the step d (Q,), better with each round."""

    def __init__(
        self, products: Products, prior: Prior, y: Array, sigma2: float, count: int, generator: np.random.Generator,
        ends: tuple[Flags, Flags] | None = None, wide: bool = True,
    ) -> None:  # fmt: skip
        """`products` are those at y (Q,); `sigma2` is the variance of a residual. Draws `count` samples. `ends`: which
        values are at their lower and upper bound; those that the data push against it, more than noise does, stay.
        `wide`: few rounds leave the samples too wide, else too narrow.
        """
        self.products, self.prior, self.sigma2, self.count = products, prior, sigma2, count
        self.gradient = products.back(products.r) + sigma2 * prior.times(y - prior.centre)
        draws = np.stack([prior.drawn(generator) for _ in range(count)], axis=1)
        pulls = [products.back(generator.standard_normal(len(products.r))) for _ in range(max(count, PULLS))]
        self.diagonal = np.mean(np.square(pulls), axis=0)  # of H
        push = np.where(self.gradient**2 > sigma2 * self.diagonal, np.sign(self.gradient), 0.0)
        low, high = ends or (np.zeros(len(y), bool), np.zeros(len(y), bool))
        self.free: Flags = ~((low & (push > 0)) | (high & (push < 0)))  # (Q,)
        believed = sigma2 * prior.believed
        draws *= self.free[:, None]
        B = np.stack([*(np.sqrt(sigma2) * pull for pull in pulls[:count]), -self.gradient], axis=1)
        B[:, :count] += sigma2 * np.stack([prior.times(x) for x in draws.T], axis=1)
        draws *= float(wide)
        X = np.concatenate([draws, np.zeros((len(y), 1))], axis=1)
        B *= self.free[:, None]
        SX = np.stack([*(self.product(x) if wide else x for x in draws.T), np.zeros(len(y))], axis=1)
        mean = np.where(believed > 0, np.sqrt(self.diagonal * believed) + believed, self.diagonal)
        self.block = BlockGradients(self.product, B, X, SX, np.where(mean > 0, mean, max(float(mean.max()), 1.0)))

    @property
    def shown(self) -> Flags:
        """Which values (Q,) change anything that is compared."""
        return np.asarray(self.diagonal > LEAST * self.diagonal.max(initial=0.0))

    def product(self, z: Array) -> Array:
        """(H + σ² A) z (Q,)."""
        whole = self.products.back(self.products.forward(z)) + self.sigma2 * self.prior.times(z)
        return np.asarray(np.where(self.free, whole, 0.0))

    def round(self) -> float:
        """One round; how much it has changed the samples, in standard deviations of theirs, root mean square."""
        before = self.samples
        if not self.block.round():
            return 0.0
        spread = np.maximum(self.deviation, np.finfo(float).tiny)[:, None]
        return float(np.sqrt(np.mean(((self.samples - before) / spread) ** 2)))

    @property
    def samples(self) -> Array:
        """x (Q, K)."""
        return self.block.X[:, : self.count]

    @property
    def step(self) -> Array:
        """d (Q,)."""
        return self.block.X[:, self.count]

    def within(self, radius: float) -> tuple[Array, float]:
        """The step (Q,) in a ball, and what it saves of the cost and the penalty of the model."""
        return self.block.within(np.where(self.free, -self.gradient, 0.0), radius)

    @property
    def deviation(self) -> Array:
        """Standard deviations (Q,) of the posterior, each of K samples."""
        return np.asarray(np.sqrt(np.mean(self.samples**2, axis=1)))

    @property
    def determined(self) -> float:
        """The number of combinations of values that the data determine, γ = tr H (H + σ² A)⁻¹."""
        return float(self.free.sum() - np.mean([x @ self.prior.times(x) for x in self.samples.T]))
