"""The global minimum of a fit of few values: a dense scan over the bounds, then a descent from its best points.

One value for a whole cloth has a cost with many minima, above all in wind. Cloths do not touch, so each is scanned
alone: 400 values between the bounds, equally spaced in the logarithm, for masses or stiffnesses; for both a grid of 28
by 28. Costs add up over the frames, so a value whose first frames already cost more than the best value's motion is
out: most of the scan simulates little.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from itertools import product

import numpy as np

from clothfit.arrays import Array
from clothfit.block import Block
from clothfit.kinds import LETTERED
from clothfit.objective import Objective

POINTS = {1: 400, 2: 28}
"""Along each axis, by the number of values."""

SHARES = (0.12, 0.35, 1.0)
"""Of the frames, after which a value is judged."""

LOOSE = (1e-4, 1e-4, 1e-5)
"""Tolerances of the linear systems there, relative: as for playing."""

KEPT = 4
"""Local minima of the scan that are followed down."""

Point = tuple[int, ...]


def scannable(objective: Objective, cloth: int) -> list[Block]:
    """The blocks of a cloth that a scan finds: one value of masses, of stiffnesses, or of both."""
    own = [block for block in objective.blocks if block.cloth == cloth and block.name in LETTERED]
    fitted = objective.identifiable
    return own if own and all(block.mode == "G" and fitted[block.start] for block in own) else []


def scan(objective: Objective, cloth: int, p: Array) -> list[Array]:
    """The best points (P,) of a scan over the values of one cloth, best first, the others as in p (P,)."""
    own = scannable(objective, cloth)
    axes = [np.geomspace(b.kind.lower, b.kind.upper, POINTS.get(len(own), 12)) for b in own]

    def at(point: Point) -> Array:
        q = p.copy()
        for block, axis, i in zip(own, axes, point, strict=True):
            q[block.start] = axis[i]
        return q

    adds = "spectrum" not in objective.weights  # a spectrum's cost is not a sum over frames
    kept = list(zip(SHARES, LOOSE, strict=True))[0 if adds else -1 :]
    stages = [objective.until(max(2, round(share * objective.steps)) + 1, loose) for share, loose in kept]
    costs = pruned(stages, cloth, at, list(product(*(range(len(axis)) for axis in axes))))
    lowest = sorted((c, point) for point, c in costs.items() if np.isfinite(c) and is_minimum(costs, point, c))
    return [at(point) for _, point in lowest[:KEPT]]


def pruned(
    stages: Sequence[Objective], cloth: int, at: Callable[[Point], Array], points: list[Point]
) -> dict[Point, float]:
    """The full costs of the points that are not out before, by stages of more and more frames."""
    known = {point: stages[0].cost_or_infinity(at(point), cloth) for point in points}
    order = sorted((point for point in points if np.isfinite(known[point])), key=lambda point: known[point])
    full, best = {}, np.inf
    for point in order:
        cost = known[point]
        for stage in stages[1:]:
            if cost > best:
                cost = np.inf
                break
            cost = stage.cost_or_infinity(at(point), cloth)
        full[point] = cost
        best = min(best, cost)
    return full


def is_minimum(costs: dict[Point, float], point: Point, cost: float) -> bool:
    """Whether no neighbour on the grid costs less."""
    around = product(*((i - 1, i, i + 1) for i in point))
    return all(costs.get(other, np.inf) >= cost for other in around)
