"""A fit of many values, such as one for each constraint, by Levenberg–Marquardt.

With the residuals r (`Fit.residuals`) and their derivative J by the logarithms of the values, a step d is the least of
|J d + r|² + μ|d|². LSMR finds it by products with J and Jᵀ, that is by tangents and adjoints of the tool's steps, each
as long as about two simulations; J itself is never there. μ falls while steps lower the cost, and rises where not.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from clothfit.base.arrays import Array
from clothfit.objective.target import sample
from clothfit.simulators.values import RANGE, WEAK, Fit

PRODUCTS = 40
"""The most products with J in a step."""

FIRST, LEAST, RISE, FALL = 1e-4, 1e-12, 10.0, 0.3
"""μ at the start, its least value, and what it is multiplied by after a step that fails, or succeeds."""

TRIES = 4
"""Values of μ for a step, before the fit ends."""

LONGEST = 2.0
"""Change of a logarithm in a step."""

ENOUGH = 3e-3
"""The fit ends where a step lowers the cost by less than this share of it."""


class ManyFit(Fit):
    """A fit of a tool that has `push` and `pull`."""

    def search(self, most: int) -> None:
        """Levenberg–Marquardt, with at most so many steps."""
        from scipy.sparse.linalg import lsmr

        y, mu = self.start, FIRST
        r = self.residuals(y)
        for _ in range(most):
            operator, cost = self.operator(y), float(r @ r)
            for _ in range(TRIES):
                found = lsmr(operator, -r, damp=np.sqrt(mu), maxiter=PRODUCTS, atol=1e-8, btol=1e-8, conlim=0)[0]
                other = np.clip(y + shortened(found), self.start - RANGE, self.upper)
                after = self.residuals(other)
                if after @ after < cost:
                    break
                mu *= RISE
            else:
                return
            y, r, mu = other, after, max(mu * FALL, LEAST)
            if r @ r > (1.0 - ENOUGH) * cost:
                return

    def operator(self, y: Array) -> Any:
        """The derivative of the residuals at y."""
        from scipy.sparse.linalg import LinearOperator

        push, pull = self.tool.push, self.tool.pull
        assert push is not None
        assert pull is not None
        numbers, seen, count = np.exp(y), self.goal.observed, int(self.goal.observed.sum())
        scale = 1.0 / (self.travel * np.sqrt(count))

        def forward(d: Array) -> Array:
            d = d.reshape(-1)
            change = sample(self.goal, push(numbers, d))[seen]
            return np.concatenate([scale * change.reshape(-1), WEAK * d])

        def backward(r: Array) -> Array:
            r = r.reshape(-1)
            bars = np.zeros_like(self.goal.positions)
            bars[seen] = scale * r[: 3 * count].reshape(-1, 3)
            return pull(numbers, self.spread(bars)) + WEAK * r[3 * count :]

        return LinearOperator((3 * count + len(y), len(y)), forward, backward, dtype=float)

    def spread(self, bars: Array) -> Array:
        """The gradient by the tool's frames up to the last that counts, of a function of the target's frames: the
        adjoint of `sample`.
        """
        goal = self.goal
        found, fraction = np.zeros((goal.last_step + 1, *bars.shape[1:])), goal.fraction[:, None, None]
        np.add.at(found, goal.step, (1.0 - fraction) * bars)
        np.add.at(found, np.minimum(goal.step + 1, goal.last_step), fraction * bars)
        return found


def shortened(step: Array) -> Array:
    """A step, of at most LONGEST in each logarithm."""
    longest = float(np.abs(step).max(initial=0.0))
    return step * (LONGEST / longest) if longest > LONGEST else step
