"""An evolution strategy with an adapted covariance (CMA-ES): the way through a cost with many small minima.

Points are drawn from a normal distribution, x = m + σ N(0, C). The better half of them moves its mean and shapes its
covariance, by their order alone: neither a step in the cost nor a motion that diverges misleads it, and what is smaller
than the distribution is averaged out. N. Hansen, The CMA evolution strategy: a tutorial, arXiv:1604.00772, whose
equations are named here; bounds are kept by moving a point to them.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from clothfit.base.arrays import Array

NARROW = 1e-3
"""Standard deviations, relative to the first ones, below which it has come to a minimum."""

SPARED = 2.0
"""Times the middle cost of the points before, above which the cost of a point is not asked for to its end."""

LEAST = 1e-20
"""Variance at least, so that rounding leaves C positive."""

Costs = Callable[[Array, int, float], Array]
"""The costs (k,) of points (k, n) that are drawn together, as far as their order counts: of so many of the cheapest,
where they are below a limit; those of all others may be any larger numbers.
"""


class Evolution:
    """The distribution of points x (n,)."""

    def __init__(self, mean: Array, widths: Array, ends: tuple[Array, Array], count: int, seed: int = 0) -> None:
        """It begins at `mean` (n,) with standard deviations `widths` (n,), within `ends`, two of (n,); `count` points
        are drawn at a time.
        """
        n, better = len(mean), count // 2
        self.mean, self.C, self.sigma = np.array(mean, float), np.diag(np.square(widths)), 1.0
        self.first, self.ends, self.count = np.array(widths, float), ends, count
        self.random = np.random.default_rng(seed)
        weights = np.log((count + 1) / 2) - np.log(np.arange(1, better + 1))  # (49)
        self.weights = weights / weights.sum()
        self.mass = 1.0 / float(self.weights @ self.weights)  # μ_eff
        self.c_sigma = (self.mass + 2.0) / (n + self.mass + 5.0)  # (55)
        self.damping = 1.0 + 2.0 * max(0.0, np.sqrt((self.mass - 1.0) / (n + 1.0)) - 1.0) + self.c_sigma
        self.c_path = (4.0 + self.mass / n) / (n + 4.0 + 2.0 * self.mass / n)  # (56)
        self.c_one = 2.0 / ((n + 1.3) ** 2 + self.mass)  # (57)
        c_rank = 2.0 * (self.mass - 2.0 + 1.0 / self.mass) / ((n + 2.0) ** 2 + self.mass)
        self.c_rank = min(1.0 - self.c_one, c_rank)  # (58)
        self.length = np.sqrt(n) * (1.0 - 1.0 / (4.0 * n) + 1.0 / (21.0 * n * n))  # of N(0, I), in the mean
        self.path, self.sigma_path, self.generation = np.zeros(n), np.zeros(n), 0
        self.axes, self.spread = np.eye(n), np.array(widths, float)  # of the points that were drawn last
        self.best, self.least, self.limit = self.mean, np.inf, np.inf  # the cheapest point, its cost, and where to end

    @property
    def widths(self) -> Array:
        """Standard deviations (n,)."""
        return np.asarray(self.sigma * np.sqrt(np.diag(self.C)))

    @property
    def is_narrow(self) -> bool:
        """Whether it has come to a minimum."""
        return bool((self.widths < NARROW * self.first).all())

    def draw(self) -> Array:
        """Points (count, n)."""
        values, self.axes = np.linalg.eigh(self.C)
        self.spread = np.sqrt(np.maximum(values, LEAST))
        normal = self.random.standard_normal((self.count, len(self.mean)))
        return np.asarray(np.clip(self.mean + self.sigma * (normal * self.spread) @ self.axes.T, *self.ends))

    def learn(self, points: Array, costs: Array) -> None:
        """Adapt to the costs (count,) of the points (count, n) that were drawn last."""
        better = (points[np.argsort(costs, kind="stable")[: len(self.weights)]] - self.mean) / self.sigma
        step = self.weights @ better
        self.mean = self.mean + self.sigma * step  # (41)
        self.generation += 1
        whitened = self.axes @ ((self.axes.T @ step) / self.spread)
        keep = 1.0 - self.c_sigma
        self.sigma_path = keep * self.sigma_path + np.sqrt((1.0 - keep**2) * self.mass) * whitened  # (43)
        long = float(np.linalg.norm(self.sigma_path)) / self.length
        steady = long / np.sqrt(1.0 - keep ** (2 * self.generation)) < 1.4 + 2.0 / (len(self.mean) + 1.0)
        keep = 1.0 - self.c_path
        self.path = keep * self.path + steady * np.sqrt((1.0 - keep**2) * self.mass) * step  # (45)
        rank = (better.T * self.weights) @ better
        self.C = (1.0 - self.c_one - self.c_rank) * self.C + self.c_one * np.outer(self.path, self.path)
        self.C += self.c_rank * rank  # (47)
        self.sigma *= np.exp(self.c_sigma / self.damping * (long - 1.0))  # (44)


def minimise(costs: Costs, evolution: Evolution, is_over: Callable[[], bool]) -> tuple[Array, float]:
    """The best point (n,) that is drawn until the distribution is narrow, or `is_over`, and its cost. It may go on
    later; the mean and ∞ where nothing was ever drawn.
    """
    half = len(evolution.weights)
    while not (evolution.is_narrow or is_over()):
        points = evolution.draw()
        found = costs(points, half, evolution.limit)
        if found.min() < evolution.least:
            evolution.best, evolution.least = points[int(np.argmin(found))], float(found.min())
        evolution.learn(points, found)
        evolution.limit = SPARED * float(np.partition(found, half - 1)[half - 1])
    return evolution.best, evolution.least
