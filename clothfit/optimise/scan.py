"""The global minimum of a fit of few values: a scan over the bounds, then a descent from its best points.

One value for a whole cloth has a cost with many minima, above all in wind. Cloths do not touch, so each is scanned
alone, over values between the bounds that are equally spaced in the logarithm: 400 for masses or stiffnesses, a grid of
20 by 20 for both. Near its start the cost of a motion is smooth in one value and has one minimum. So the scan of one
value looks at the first frames with some of the values, at all frames with those that are likely by that and some
between, and with every value around the best of these.

Costs add up over the frames, so a motion whose first frames already cost more than the best whole motion is not
followed further. The points come in a random order, so that a good one is found soon. Of large cloths only the first
frames are looked at, around the start.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from itertools import product

import numpy as np

from clothfit.base.arrays import Array
from clothfit.engine.tape import Plan, Tape
from clothfit.objective.objective import Objective
from clothfit.objective.running_cost import running_cost
from clothfit.scene.block import Block
from clothfit.scene.kinds import LETTERED

POINTS = {1: 400, 2: 20}
"""Along each axis, by the number of values."""

FIRST, SECOND = 10, 5
"""Every how many of the values are looked at over the first frames, and over all."""

EARLY, SHARE = 20, 0.2
"""Frames after the first that shows something, and no less than this share of all, that the scan looks at first."""

LIKELY = 6.0
"""A point is likely if its cost is within this factor of the lowest: its error within 2.5."""

CHECKS = 12
"""How often a motion's cost is looked at on its way."""

LARGE = 400
"""Vertices of a cloth whose steps are expensive. A scan simulates only its first frames, `STATES` vertices times
frames and no fewer than `FIRST_FRAMES`, at `SOME` points by the number of values, within a factor of `REACH` of the
start.
"""

STATES, FIRST_FRAMES, SOME, REACH = 60_000, 20, {1: 60, 2: 11}, 100.0

LOOSE = 3e-4
"""Tolerance of the linear systems, relative."""

KEPT, FEW = 4, 2
"""Local minima of the scan that are followed down; of a large cloth."""

CLOSE = 1.1
"""… if their cost is within this factor of the lowest."""

Point = tuple[int, ...]
Bracket = tuple[float, float, float]


def scannable(objective: Objective, cloth: int) -> list[Block]:
    """The blocks of a cloth that a scan finds: one value, or one factor, of masses, of stiffnesses, or of both."""
    own = [block for block in objective.blocks if block.cloth == cloth and block.name in LETTERED]
    fitted = objective.identifiable
    return own if own and all(block.is_one and fitted[block.start] for block in own) else []


def scan(objective: Objective, cloth: int, p: Array) -> list[list[Bracket]]:
    """The best points of a scan over the values of one cloth, best first, the others as in p (P,): for each of its
    blocks the value between those on the grid.
    """
    own = scannable(objective, cloth)
    large = is_large(objective, cloth)
    axes = [axis_of(block, p[block.start], len(own), large) for block in own]
    places = [block.start for block in own]

    def at(point: Point) -> Array:
        q = p.copy()
        q[places] = [axis[i] for axis, i in zip(axes, point, strict=True)]
        return q

    lengths = [len(axis) for axis in axes]
    if large or len(own) > 1:
        partial = PartialCost(beginning(objective) if large else objective, cloth)
        costs, most = costs_at(partial, at, grid(lengths), CLOSE), FEW if large else KEPT
    else:
        costs, most = around_likely(objective, cloth, at, lengths), KEPT
    return [[brackets(axis, i) for axis, i in zip(axes, point, strict=True)] for point in minima(costs, CLOSE)[:most]]


def around_likely(
    objective: Objective, cloth: int, at: Callable[[Point], Array], lengths: Sequence[int]
) -> dict[Point, float]:
    """The costs of all points around the best of those that are likely by the first frames; `at` gives the parameters
    (P,) of a point.
    """
    points = grid(lengths, SECOND)
    if "spectrum" not in objective.weights:  # whose beginning says nothing of the whole
        first = objective.until(objective.first_step + max(EARLY, round(SHARE * objective.steps)))
        likely = within(costs_at(PartialCost(first, cloth), at, grid(lengths, FIRST), LIKELY), LIKELY)
        points = [point for point in points if any(is_adjacent(point, other, FIRST) for other in likely)]
    partial = PartialCost(objective, cloth)
    costs = costs_at(partial, at, points, LIKELY)
    kept = minima(costs, LIKELY, SECOND)[:KEPT]
    around = [point for point in grid(lengths) if any(is_adjacent(point, other, SECOND - 1) for other in kept)]
    known = {point: costs[point] for point in around if point in costs}
    return known | costs_at(partial, at, [point for point in around if point not in known], CLOSE, known)


def costs_at(
    partial: PartialCost,
    at: Callable[[Point], Array],
    points: Iterable[Point],
    factor: float,
    known: Mapping[Point, float] | None = None,
) -> dict[Point, float]:
    """The cost at each point; infinite where it is above the lowest, `known` ones included, by more than a factor."""
    costs: dict[Point, float] = {}
    best = min((known or {}).values(), default=np.inf)
    for point in points:
        costs[point] = partial.cost(at(point), factor * best)
        best = min(best, costs[point])
    return costs


def within(costs: Mapping[Point, float], factor: float) -> list[Point]:
    """The points whose cost is within a factor of the lowest, best first."""
    most = factor * min(costs.values(), default=np.inf)
    return [point for cost, point in sorted((c, p) for p, c in costs.items()) if np.isfinite(cost) and cost <= most]


def minima(costs: Mapping[Point, float], factor: float, step: int = 1) -> list[Point]:
    """The local minima, best first, among points `step` apart along each axis, within a factor of the lowest."""
    return [point for point in within(costs, factor) if is_minimum(costs, point, step)]


def is_adjacent(point: Point, other: Point, reach: int) -> bool:
    """Whether a point is within `reach` of another along each axis."""
    return all(abs(i - j) <= reach for i, j in zip(point, other, strict=True))


def is_large(objective: Objective, cloth: int) -> bool:
    """Whether a cloth's steps are expensive."""
    return objective.scene.vertex_counts[cloth] >= LARGE


def axis_of(block: Block, value: float, count: int, large: bool) -> Array:
    """The values of a block that a scan of so many values tries."""
    (lower,), (upper,) = block.limits
    if not large:
        return np.geomspace(lower, upper, POINTS[count])
    middle = min(max(value, lower), upper)
    return np.geomspace(max(lower, middle / REACH), min(upper, middle * REACH), SOME[count])


def beginning(objective: Objective) -> Objective:
    """The objective over the first frames, of which something shows; a spectrum needs all."""
    if "spectrum" in objective.weights:
        return objective
    frames = STATES // max(objective.scene.vertex_counts)
    return objective.until(objective.first_step + max(frames, FIRST_FRAMES))


def brackets(axis: Array, i: int) -> Bracket:
    """A value of an axis between its neighbours."""
    return float(axis[max(i - 1, 0)]), float(axis[i]), float(axis[min(i + 1, len(axis) - 1)])


def grid(lengths: Sequence[int], step: int = 1) -> list[Point]:
    """Every `step`-th point along each axis of a grid.

    In a random order: along the grid many a motion would be the best so far, and be followed to its end.
    """
    points = list(product(*(range(0, length, step) for length in lengths)))
    return [points[i] for i in np.random.default_rng(0).permutation(len(points))]


class PartialCost:
    """The cost of one cloth of an objective on its way through the frames."""

    def __init__(self, objective: Objective, cloth: int) -> None:
        length = max(1, -(-objective.steps // CHECKS))
        adds = "spectrum" not in objective.weights  # a spectrum's cost is not a sum over frames
        parts = {end: objective.until(end + 1).runs for end in range(length, objective.steps, length) if adds}
        self.plan = Plan(length)
        self.legs = [
            (run, {end: shorter[i].comparison for end, shorter in parts.items()})
            for i, run in enumerate(objective.runs)
            if cloth in run.scene.together(run.cloth)
        ]

    def cost(self, p: Array, most: float) -> float:
        """The cost at p (P,); infinite where it is above `most` before the end, or the simulation diverges."""
        total = 0.0
        for run, shorter in self.legs:
            tape, cost = Tape(run.changed(p), run.steps, LOOSE, self.plan), running_cost(run.comparison)
            for part in tape.forward():
                cost.update(part)
                step = part.first + part.steps
                if step < run.steps and step in shorter and cost.value_over(shorter[step]) > most - total:
                    return np.inf
            if tape.good < tape.steps:
                return np.inf
            total += cost.value
        return total


def is_minimum(costs: Mapping[Point, float], point: Point, step: int = 1) -> bool:
    """Whether no neighbour on the grid, `step` away along each axis, costs less."""
    around = product(*((i - step, i, i + step) for i in point))
    return all(costs.get(other, np.inf) >= costs[point] for other in around)
