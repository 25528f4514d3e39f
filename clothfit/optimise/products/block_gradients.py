"""Block conjugate gradients: S X = B for several right sides at once, where S is only known by its products.

Each round adds as many directions as there are right sides, the residuals times a preconditioner D⁻¹, and X is the best
of the whole space W that was spanned so far, in the norm of S:

    X = X₀ + W (Wᵀ S W)⁻¹ Wᵀ (B − S X₀)

All right sides share W, so that they need far fewer rounds than conjugate gradients for each of them would. W is kept,
and orthogonalised anew, since S is only symmetric to the tolerance of its products. D. P. O'Leary, The block conjugate
gradient algorithm and related methods, Linear Algebra and its Applications 29, 1980.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from clothfit.base.arrays import Array
from clothfit.optimise import ball

DEPENDENT = 1e-6
"""Singular value of the new directions, of unit length, below which they say nothing new."""


class BlockGradients:
    """Solutions X (Q, K), better with each round."""

    def __init__(self, product: Callable[[Array], Array], B: Array, X: Array, SX: Array, diagonal: Array) -> None:
        """`product` gives S z (Q,); from X (Q, K) on, with its products `SX`; `diagonal` (Q,) of the preconditioner D,
        above 0.
        """
        self.product, self.first, self.X = product, X, X.copy()
        self.root = np.sqrt(diagonal)[:, None]
        self.residual = B - SX
        self.start = self.residual / self.root
        self.W, self.SW = np.zeros((len(X), 0)), np.zeros((len(X), 0))  # with D = 1, by the change of variables √D x

    @property
    def rank(self) -> int:
        """Directions so far."""
        return self.W.shape[1]

    @property
    def inner(self) -> Array:
        """Wᵀ S W, symmetric to the last bit."""
        inner = self.W.T @ self.SW
        return np.asarray((inner + inner.T) / 2.0)

    def within(self, b: Array, radius: float) -> tuple[Array, float]:
        """The x (Q,) of the space that makes xᵀ S x − 2 bᵀ x least with |x| at most the radius, and minus that."""
        basis = self.W / self.root
        triangle = np.linalg.qr(basis, mode="r")  # |W v| = |R v|
        back = np.linalg.inv(triangle)
        H, g = back.T @ self.inner @ back, -back.T @ (basis.T @ b)
        v = ball.within(ball.Quadratic((H + H.T) / 2.0, g), radius)
        return np.asarray(basis @ (back @ v)), -float(2.0 * g @ v + v @ H @ v)

    def round(self) -> bool:
        """One round; whether it has found new directions."""
        new = self._directions()
        if not new.shape[1]:
            return False
        products = [self.product(z / self.root[:, 0]) / self.root[:, 0] for z in new.T]
        self.W = np.concatenate([self.W, new], axis=1)
        self.SW = np.concatenate([self.SW, np.stack(products, axis=1)], axis=1)
        along = np.linalg.lstsq(self.inner, self.W.T @ self.start, rcond=None)[0]
        self.X = self.first + self.W @ along / self.root
        self.residual = (self.start - self.SW @ along) * self.root
        return True

    def _directions(self) -> Array:
        """New directions (Q, ·), orthonormal, and orthogonal to all before."""
        Z = self.residual / self.root
        size = np.linalg.norm(Z, axis=0)
        Z = Z[:, size > 0] / size[size > 0]
        for _ in range(2):
            Z = Z - self.W @ (self.W.T @ Z)
        left, values, _ = np.linalg.svd(Z, full_matrices=False)
        Z = left[:, values > DEPENDENT]
        return np.linalg.qr(Z - self.W @ (self.W.T @ Z))[0]
