"""Where a fit starts when it may not know the scene's own values: the best of a coarse grid of one value per cloth.

Cloths do not touch, so each has a grid of its own: the decades within the bounds for every flagged kind (masses,
stiffnesses, or both), then steps of half, a quarter and an eighth of a decade around the best. Only the first frames
are compared: near the start the cost is smooth in the parameters, later a windy cloth is chaotic.
"""

from __future__ import annotations

from collections.abc import Iterator
from itertools import product

import numpy as np

from clothfit.arrays import Array
from clothfit.errors import Diverged
from clothfit.fit_vector import LOWER, UPPER
from clothfit.motion import Motion
from clothfit.objective import Objective
from clothfit.scene import Scene

WINDOW = 30  # frames
LOOSE = 1e-4  # tolerance of the linear solver: far below the differences between grid points
DECADES = np.arange(round(np.log10(LOWER)), round(np.log10(UPPER)) + 1.0)


def neutral_start(scene: Scene, motion: Motion, frames: int) -> Array:
    """Starting values (P,) from the target and from what is not flagged; independent of the scene's flagged values."""
    objective = Objective(scene, motion, LOOSE, frames=min(frames, WINDOW))
    p = np.ones(sum(block.count for block in objective.blocks))
    for cloth in objective.cloths:
        own = [block for block in objective.blocks if block.cloth == cloth]

        def cost(exponents: tuple[float, ...], cloth: int = cloth, own: list = own) -> float:  # type: ignore[type-arg]
            for block, exponent in zip(own, exponents, strict=True):
                p[block.part] = 10.0**exponent
            try:
                value = objective.cost_of(cloth, p)
            except Diverged:
                return np.inf
            return value if np.isfinite(value) else np.inf

        best = min(product(DECADES, repeat=len(own)), key=cost)
        best_cost = cost(best)
        for width in (0.5, 0.25, 0.125):
            for near in neighbours(best, width):
                near_cost = cost(near)
                if near_cost < best_cost:
                    best, best_cost = near, near_cost
        cost(best)  # leaves the best values in p
    return p


def neighbours(exponents: tuple[float, ...], width: float) -> Iterator[tuple[float, ...]]:
    """The points one step away along each axis and diagonal, within the bounds."""
    for step in product((-width, 0.0, width), repeat=len(exponents)):
        point = tuple(float(e + s) for e, s in zip(exponents, step, strict=True))
        if any(step) and all(DECADES[0] <= e <= DECADES[-1] for e in point):
            yield point
