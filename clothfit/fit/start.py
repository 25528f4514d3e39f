"""Where a fit starts when it may not know the scene's own values: the best of a coarse grid of one value per cloth.

Cloths do not touch, so each has a grid of its own: the decades within the bounds for its masses, stiffnesses, or both,
then steps of half, a quarter and an eighth of a decade around the best. Only the first frames are compared: near the
start the cost is smooth in the parameters, later a windy cloth is chaotic. The other kinds are not searched: they have
neutral values, or those that are given.

A fabric has one density and one stiffness; the front end shares them out by geometry: a vertex' mass is proportional
to the area of its triangles, a traction spring's stiffness to the area at its edge over its length squared, a bending
spring's to a quarter of twice that of the second triangle at the edge it bends over (`meshes.mesh`). Springs and
vertices that belong to no triangle get the geometric mean of the others. A fit of each value by itself starts from
these proportions.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Sequence
from functools import partial
from itertools import product
from typing import Any

import numpy as np
from numpy.typing import NDArray

from clothfit.base.arrays import Array
from clothfit.meshes.mesh import BENDING_SHARE, Mesh, areas
from clothfit.objective.experiment import Experiment, Targets, experiments
from clothfit.objective.objective import Objective
from clothfit.objective.target import first_step, target
from clothfit.scene.block import Block
from clothfit.scene.fit_vector import LOWER, UPPER, blocks
from clothfit.scene.kinds import LETTERED
from clothfit.scene.scene import Cloth, Scene

WINDOW = 30  # frames, the one before the first that shows anything included
LOOSE = 1e-4  # tolerance of the linear solver: far below the differences between grid points
DECADES = [float(e) for e in range(round(math.log10(LOWER)), round(math.log10(UPPER)) + 1)]
Exponents = tuple[float, ...]  # of ten, one per kind that is searched


def neutral(scene: Scene) -> Array:
    """Values (P,) that do not depend on the scene's flagged ones: the neutral value of each kind."""
    p = np.zeros(sum(block.count for block in blocks(scene)))
    for block in blocks(scene):
        value = np.resize(block.kind.neutral, block.count)
        lengths = block.name == "rest" and block.mode == "L" and block.cloth is not None
        p[block.part] = scene.cloths[block.cloth or 0].lengths if lengths else value
    return p


def fabric(scene: Scene) -> Array:
    """Values (P,) as `neutral`, but what is fitted per vertex or spring as a uniform fabric shares it out."""
    p = neutral(scene)
    for block in blocks(scene):
        if block.mode == "L" and block.name in LETTERED and block.cloth is not None:
            p[block.part] = proportions(scene.cloths[block.cloth])[LETTERED.index(block.name)]
    return p


def neutral_start(
    scene: Scene, motion: Targets, frames: int, patterns: Sequence[Array] | None = None, **options: Any
) -> list[Array]:
    """Starting values (P,) from the target and from what is not flagged, independent of the scene's flagged values: one
    for each of the `patterns` (P,) that its masses and stiffnesses may follow up to a factor (default: a fabric's, and
    all alike), best first.

    Kinds that are not searched keep their values in the pattern. `frames` of the scene are compared at most, of an
    experiment's own scene as many as that says; `options` are those of Objective.
    """
    given = experiments(scene, motion)
    windows = [min(frames if e.scene is scene else e.scene.frames, window(e, **options)) for e in given]
    objective = Objective(scene, motion, LOOSE, windows, **options)
    found = [scaled(objective, np.array(p, float)) for p in patterns or (fabric(scene), neutral(scene))]
    return [p for _, _, p in sorted((objective.cost_or_infinity(p), i, p) for i, p in enumerate(found))]


def scaled(objective: Objective, p: Array) -> Array:
    """The parameters p (P,) with the masses and the stiffnesses of each cloth multiplied by the best of a grid."""
    for cloth in objective.cloths:
        own = [block for block in objective.blocks if block.cloth == cloth and block.name in LETTERED]
        if own:
            shapes = [normalised(p[block.part]) for block in own]
            best = search_grid(partial(grid_cost, objective, cloth, own, shapes, p.copy()), len(own))
            fill(p, own, shapes, best)
    return p


def window(experiment: Experiment, **options: Any) -> int:
    """How many frames of an experiment are compared: a spectrum needs all, for the others the first will do."""
    asked = options.get("objective", "position")
    return experiment.scene.frames if "spectrum" in asked else first_seen(experiment) + WINDOW - 1


def first_seen(experiment: Experiment) -> int:
    """The first step after the start at which, or before which, something was observed; 0 where nothing was."""
    motion, scene = experiment
    return first_step(target(motion, cloth, scene.delta) for cloth in range(len(scene.cloths)))


def fill(p: Array, own: Sequence[Block], shapes: Sequence[Array], exponents: Exponents) -> None:
    """Give each block its one value, times its proportions, within the bounds."""
    for block, proportion, exponent in zip(own, shapes, exponents, strict=True):
        p[block.part] = np.clip(10.0**exponent * proportion, LOWER, UPPER)


def grid_cost(
    objective: Objective,
    cloth: int,
    own: Sequence[Block],
    shapes: Sequence[Array],
    p: Array,
    exponents: Exponents,
) -> float:
    """Cost of one cloth at a point of its grid, written into p (P,); infinite where the simulation diverges."""
    fill(p, own, shapes, exponents)
    return objective.cost_or_infinity(p, cloth)


def search_grid(cost: Callable[[Exponents], float], kinds: int) -> Exponents:
    """The best point of the decades, refined."""
    costs = {point: cost(point) for point in product(DECADES, repeat=kinds)}
    best = min(costs, key=lambda point: costs[point])
    for width in (0.5, 0.25, 0.125):
        costs |= {point: cost(point) for point in neighbours(best, width)}
        best = min(costs, key=lambda point: costs[point])
    return best


def neighbours(exponents: Exponents, width: float) -> Iterator[Exponents]:
    """The points one step away along each axis and diagonal, within the bounds."""
    for step in product((-width, 0.0, width), repeat=len(exponents)):
        point = tuple(float(e + s) for e, s in zip(exponents, step, strict=True))
        if any(step) and all(DECADES[0] <= e <= DECADES[-1] for e in point):
            yield point


def proportions(cloth: Cloth) -> tuple[Array, Array]:
    """Relative masses (n,) and stiffnesses (S,) of a uniform fabric, each with geometric mean 1."""
    area = areas(Mesh(cloth.positions, cloth.triangles))
    mass = np.zeros(len(cloth.mass))
    np.add.at(mass, cloth.triangles, area[:, None] / 3)
    return normalised(mass), normalised(spring_areas(cloth, area) / cloth.lengths**2)


def spring_areas(cloth: Cloth, area: Array) -> Array:
    """The area (S,) that each spring stands for, m²; 0 where it is neither an edge nor bends over one."""
    n = len(cloth.mass)
    sides = np.sort(cloth.triangles[:, [[0, 1], [1, 2], [2, 0]]].reshape(-1, 2), axis=1)
    opposite, shared = cloth.triangles[:, [2, 0, 1]].reshape(-1), np.repeat(area, 3)
    key = sides[:, 0].astype(np.int64) * n + sides[:, 1]
    order = np.argsort(key, kind="stable")
    pairs = np.flatnonzero(np.diff(key[order]) == 0)  # two triangles at one edge
    first, second = order[pairs], order[pairs + 1]
    across = np.sort(np.stack([opposite[first], opposite[second]], axis=1), axis=1)
    bend_key = across[:, 0].astype(np.int64) * n + across[:, 1]
    bend_area = BENDING_SHARE * 2.0 * shared[second]
    ends = np.sort(cloth.springs, axis=1)
    own = ends[:, 0].astype(np.int64) * n + ends[:, 1]
    traction = summed(key, shared, own)
    return np.where(traction > 0, traction, summed(bend_key, bend_area, own))


def summed(keys: NDArray[np.int64], values: Array, wanted: NDArray[np.int64]) -> Array:
    """Sum of the values of each wanted key; 0 where there is none."""
    distinct, group = np.unique(keys, return_inverse=True)
    if not len(distinct):
        return np.zeros(len(wanted))
    sums = np.bincount(group.reshape(-1), weights=values, minlength=len(distinct))
    place = np.clip(np.searchsorted(distinct, wanted), 0, len(distinct) - 1)
    found: Array = np.where(distinct[place] == wanted, sums[place], 0.0)
    return found


def normalised(values: Array) -> Array:
    """Values relative to their geometric mean; 1 where there is none."""
    known = values > 0
    middle = np.exp(np.log(values[known]).mean()) if known.any() else 1.0
    relative: Array = np.where(known, values, middle) / middle
    return relative
