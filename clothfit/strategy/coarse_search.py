"""Starting values that depend on the target only: the best of a coarse grid of one value per cloth.

Cloths do not touch, so each has a grid of its own: the decades within the bounds for its masses, stiffnesses, or both,
then steps of half, a quarter and an eighth of a decade around the best. Only the first frames are compared: near the
start the cost is smooth in the parameters, later a windy cloth is chaotic. The other kinds are not searched: they keep
the values that are given.
"""

from __future__ import annotations

import math
import sys
from collections.abc import Callable, Iterator, Sequence
from functools import partial
from itertools import product

import numpy as np

from clothfit.base.arrays import Array
from clothfit.objective.comparison import WHOLE
from clothfit.objective.experiment import Experiment
from clothfit.objective.objective import Objective
from clothfit.objective.target import first_step, target
from clothfit.scene.block import Block
from clothfit.scene.kinds import LETTERED

COARSE_FRAMES = 30  # that are compared, the one before the first that shows anything included
COARSE_TOLERANCE = 1e-4  # of the linear solver: far below the differences between grid points
ROUNDING = 1e-9  # of a logarithm
Exponents = tuple[float, ...]  # of ten, one per kind that is searched


def best_scales(objective: Objective, patterns: Sequence[Array]) -> list[Array]:
    """The patterns (P,) with the masses and stiffnesses of each cloth multiplied by the best factors, best first."""
    every = bool(WHOLE & set(objective.weights))  # a spectrum needs all frames
    frames = [e.scene.frames if every else min(e.scene.frames, window(e)) for e in objective.experiments]
    early = objective.until(frames, COARSE_TOLERANCE)
    found = [scaled(early, np.array(p, float)) for p in patterns]
    return [p for _, _, p in sorted((early.cost_or_infinity(p), i, p) for i, p in enumerate(found))]


def window(experiment: Experiment) -> int:
    """Frames of an experiment up to the last that a coarse search compares."""
    motion, scene = experiment
    return first_step(target(motion, i, scene.delta) for i in range(len(scene.cloths))) + COARSE_FRAMES - 1


def scaled(objective: Objective, p: Array) -> Array:
    """The parameters p (P,) with the masses and the stiffnesses of each cloth multiplied by the best of a grid."""
    for cloth in objective.cloths:
        own = [block for block in objective.blocks if block.cloth == cloth and block.name in LETTERED]
        if own:
            shapes = [shape(block, p[block.part]) for block in own]
            best = search_grid(partial(grid_cost, objective, cloth, own, shapes, p.copy()), [*map(decades, own)])
            fill(p, own, shapes, best)
    return p


def decades(block: Block) -> Exponents:
    """The exponents of the decades within the bounds of a block's values."""
    low, high = (math.log10(min(end, sys.float_info.max)) for end in block.ends)
    first, last = math.ceil(low - ROUNDING), math.floor(high + ROUNDING)
    return tuple(float(e) for e in range(first, last + 1)) or (0.5 * (low + high),)


def shape(block: Block, p: Array) -> Array:
    """Parameters p (count,) of a block for values whose geometric mean is 1; of a map only its level changes."""
    level = block.constant
    found = p.copy()
    found[level] = normalised(p[level]) * block.at_level(1.0)[level]
    return found


def fill(p: Array, own: Sequence[Block], shapes: Sequence[Array], exponents: Exponents) -> None:
    """Give each block its one value, times its proportions, within the bounds."""
    for block, proportion, exponent in zip(own, shapes, exponents, strict=True):
        p[block.part] = np.clip(np.where(block.constant, 10.0**exponent, 1.0) * proportion, *block.limits)


def grid_cost(
    objective: Objective, cloth: int, own: Sequence[Block], shapes: Sequence[Array], p: Array, exponents: Exponents
) -> float:
    """Cost of one cloth at a point of its grid, written into p (P,); infinite where the simulation diverges."""
    fill(p, own, shapes, exponents)
    return objective.cost_or_infinity(p, cloth)


def search_grid(cost: Callable[[Exponents], float], axes: Sequence[Exponents]) -> Exponents:
    """The best point of the decades of each kind, refined."""
    costs = {point: cost(point) for point in product(*axes)}
    best = min(costs, key=lambda point: costs[point])
    for width in (0.5, 0.25, 0.125):
        costs |= {point: cost(point) for point in neighbours(best, width, axes)}
        best = min(costs, key=lambda point: costs[point])
    return best


def neighbours(exponents: Exponents, width: float, axes: Sequence[Exponents]) -> Iterator[Exponents]:
    """The points one step away along each axis and diagonal, within the bounds."""
    for step in product((-width, 0.0, width), repeat=len(exponents)):
        point = tuple(float(e + s) for e, s in zip(exponents, step, strict=True))
        if any(step) and all(axis[0] <= e <= axis[-1] for e, axis in zip(point, axes, strict=True)):
            yield point


def normalised(values: Array) -> Array:
    """Values relative to their geometric mean; 1 where there is none."""
    known = values > 0
    middle = np.exp(np.log(values[known]).mean()) if known.any() else 1.0
    relative: Array = np.where(known, values, middle) / middle
    return relative
