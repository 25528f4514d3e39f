"""The coordinates in which a fit moves its parameters, so that all kinds and modes are of comparable weight.

    masses, stiffnesses, rest lengths, and factors on them:  y = c log p
    all other kinds:                    y = c p / σ,   σ = max(|start|, the kind's typical size)
    what the wind's keys add to it:     the same with σ at least the speed of the wind to which they add

with c = sqrt(vertices or springs that the parameter moves): one value for a whole cloth and one value per element then
weigh the same. For a mode of a map c² is the sum of its squares over the vertices or springs, which is what c² is for
all: the squared change of the logarithms of the values by that of the parameter's.
"""

from __future__ import annotations

import numpy as np

from clothfit.base.arrays import Array
from clothfit.scene.fit_vector import bounds
from clothfit.scene.scene import Scene


class Coordinates:
    """Between the fit vector p (P,) of a scene and its coordinates y (P,)."""

    def __init__(self, scene: Scene, start: Array) -> None:
        """`start` (P,): where the fit starts."""
        found = scene.blocks
        counts = np.array([block.count for block in found], int)
        mean = float(np.linalg.norm(scene.wind))
        sizes = [max(block.kind.scale, mean if block.name == "gusts" else 0.0) for block in found]
        scales = np.repeat(sizes, counts)
        self.log = np.repeat(np.array([block.kind.log for block in found], bool), counts)
        self.scale = np.where(self.log, 1.0, np.maximum(np.abs(start), scales))  # σ, (P,)
        self.weight = np.sqrt(np.concatenate([np.zeros(0), *(block.weights for block in found)]))  # c, (P,)
        self._ends = bounds(scene)

    @property
    def lower(self) -> Array:
        """Lower bounds (P,) of y."""
        return self.y(self._ends[0])

    @property
    def upper(self) -> Array:
        """Upper bounds (P,) of y."""
        return self.y(self._ends[1])

    def y(self, p: Array) -> Array:
        """Coordinates (P,) of parameters p (P,), moved into the bounds."""
        inside = self.clipped(p)
        plain = np.where(self.log, np.log(np.where(self.log, inside, 1.0)), inside / self.scale)
        return np.asarray(self.weight * plain)

    def p(self, y: Array) -> Array:
        """Parameters (P,) at coordinates y (P,), moved into the bounds."""
        plain = y / self.weight
        with np.errstate(over="ignore"):  # far outside the bounds
            return self.clipped(np.where(self.log, np.exp(np.where(self.log, plain, 0.0)), plain * self.scale))

    def clipped(self, p: Array) -> Array:
        """Parameters p (P,) moved into the bounds."""
        return np.clip(p, *self._ends)

    def change(self, p: Array) -> Array:
        """Change (P,) of the parameters that counts as one at p (P,): their size, or σ where y is linear in p."""
        return np.where(self.log, p, self.scale)

    def relative_change(self, p: Array, q: Array) -> Array:
        """Change (P,) from p to q, relative to the size of p, and of what counts as one there; 0 where both are 0."""
        size = np.maximum(np.abs(p), self.change(p))
        return np.where(size > 0, np.abs(q - p) / np.where(size > 0, size, 1.0), 0.0)

    def derivative(self, p: Array) -> Array:
        """∂p/∂y (P,) at p (P,)."""
        return np.asarray(self.change(p) / self.weight)
