"""Adam and AMSGrad: a step for each value by the running mean of its gradient, relative to that of its square.

D. P. Kingma, J. Ba, ICLR 2015; S. J. Reddi, S. Kale, S. Kumar, ICLR 2018, whose denominator never falls.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from clothfit.base.arrays import Array

FIRST, SECOND, LEAST = 0.9, 0.999, 1e-8


class Descent:
    """The means of some arrays' gradients."""

    def __init__(self, values: Sequence[Array], amsgrad: bool) -> None:
        self.mean = [np.zeros_like(each) for each in values]
        self.square = [np.zeros_like(each) for each in values]
        self.largest = [np.zeros_like(each) for each in values] if amsgrad else []
        self.count = 0

    def step(self, values: Sequence[Array], grad: Sequence[Array], rate: float) -> None:
        """Change the values along their gradients."""
        self.count += 1
        unbiased = np.sqrt(1.0 - SECOND**self.count)
        size = rate * unbiased / (1.0 - FIRST**self.count)
        for k, (value, g) in enumerate(zip(values, grad, strict=True)):
            kind = value.dtype.type
            self.mean[k] += kind(1.0 - FIRST) * (g - self.mean[k])
            self.square[k] += kind(1.0 - SECOND) * (g * g - self.square[k])
            if self.largest:
                np.maximum(self.largest[k], self.square[k], out=self.largest[k])
            root = np.sqrt(self.largest[k] if self.largest else self.square[k])
            value -= kind(size) * self.mean[k] / (root + kind(LEAST * unbiased))

    @property
    def state(self) -> list[Array]:
        """All its arrays."""
        return [*self.mean, *self.square, *self.largest]


def clipped(grad: Sequence[Array], most: float | None) -> bool:
    """Shorten a gradient to a norm, in place; returns whether it is finite."""
    norm = float(np.sqrt(sum(float((each * each).sum()) for each in grad)))
    if most is not None and norm > most:
        for each in grad:
            each *= each.dtype.type(most / norm)
    return bool(np.isfinite(norm))
