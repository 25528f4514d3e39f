"""Where a fit starts: at the given values, or at the scene's. Where these are the truth, which the fit may not know, it
starts at the best of a coarse search in the proportions of a fabric or with equal values.

A fabric has one density and one stiffness; the editor shares them out by geometry: a vertex' mass is proportional
to the area of its triangles, a traction spring's stiffness to the area at its edge over its length squared, a bending
spring's to a quarter of twice that of the second triangle at the edge it bends over (`meshes.mesh`). Springs and
vertices that belong to no triangle get the geometric mean of the others.

Starting values that depend on the target only: the best of a coarse grid of one value per cloth.

Cloths do not touch, so each has a grid of its own: the decades within the bounds for its masses, stiffnesses, or both,
then steps of half, a quarter and an eighth of a decade around the best. Only the first frames are compared: near the
start the cost is smooth in the parameters, later a windy cloth is chaotic. The other kinds are not searched: they keep
the values that are given.

Values over time go from coarse to fine. The first frames of a motion show a steady wind and its drag in few
simulations, also from still air, in which the cost hardly depends on what the wind does later. So where all keys have
the same value at the start, the wind is fitted as one value of the whole motion first, and the keys go on from it.
"""

from __future__ import annotations

import math
import sys
from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace
from functools import partial
from itertools import product

import numpy as np
from numpy.typing import NDArray

from clothfit.base.arrays import Array
from clothfit.base.errors import InvalidInput
from clothfit.base.messages import owned
from clothfit.meshes.mesh import BENDING_SHARE, Mesh, any_sides, areas, stretched
from clothfit.objective.comparison import WHOLE
from clothfit.objective.identifiability import identifiable
from clothfit.objective.objective import Objective
from clothfit.objective.target import first_step
from clothfit.scene.block import Block
from clothfit.scene.cloth import Cloth
from clothfit.scene.directions import keys, places
from clothfit.scene.factors import geometric_mean
from clothfit.scene.fit_vector import bounds, of_kinds, parameters
from clothfit.scene.kinds import LETTERED
from clothfit.scene.scene import Scene

COARSE_FRAMES = 30  # that are compared, the one before the first that shows anything included
COARSE_TOLERANCE = 1e-4  # of the linear solver: far below the differences between grid points
ROUNDING = 1e-9  # of a logarithm
Exponents = tuple[float, ...]  # of ten, one per kind that is searched


def best_scales(objective: Objective, patterns: Sequence[Array]) -> list[Array]:
    """The patterns (P,) with the masses and stiffnesses of each cloth multiplied by the best factors, best first."""
    frames = []
    for k, (_, scene) in enumerate(objective.experiments):
        own = [run.comparison for run in objective.runs if run.experiment == k]
        shown = first_step((each.goal, each.observed) for each in own)
        every = bool(WHOLE & set(objective.weights))  # a spectrum needs all frames
        frames.append(scene.frames if every else min(scene.frames, shown + COARSE_FRAMES - 1))
    early = objective.until(frames, COARSE_TOLERANCE)
    found = [scaled(early, np.array(p, float)) for p in patterns]
    return [p for _, _, p in sorted((early.cost_or_infinity(p), i, p) for i, p in enumerate(found))]


def scaled(objective: Objective, p: Array) -> Array:
    """The parameters p (P,) with the masses and the stiffnesses of each cloth multiplied by the best of a grid."""
    for cloth in objective.objects:
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


SELF_STARTING = ("auto", "momentum")
"""Methods that look for a start themselves where none is given."""


def first_point(
    objective: Objective, start: float | Array | Scene | None, twin: bool, method: str
) -> tuple[Array, float, list[str]]:
    """The first point (P,) of a method, its cost, as far as that is known, else infinite, and warnings; `start` is what
    the user gives.

    `twin`: the scene's own values are the truth, which the fit may not know. Raises InvalidInput as `choose_start`.
    """
    scene = objective.scene
    if twin and start is None and method in SELF_STARTING:
        p = np.where(objective.identifiable, fabric(scene), parameters(scene))
        return p, np.inf, start_warnings(objective, p)
    p = choose_start(objective, start, twin)
    warnings = start_warnings(objective, p)
    cost = objective.cost_or_infinity(p)
    if not np.isfinite(cost):
        instead = "the fit starts from the best of a coarse search instead"
        warnings.append(f"the simulation diverges at the start; {instead}")
        p = best_scales(objective, [p])[0]
    return p, cost, warnings


def choose_start(objective: Objective, start: float | Array | Scene | None, twin: bool) -> Array:
    """Starting values (P,) of all parameters. Raises InvalidInput when they are not numbers within the bounds."""
    scene = objective.scene
    if twin and start is None:
        return np.where(identifiable(scene), neutral_start(objective), parameters(scene))
    return start_of(scene, start, twin)


def start_of(scene: Scene, start: float | Array | Scene | None, twin: bool = False) -> Array:
    """What is given as a start as values (P,); those of the scene where nothing is. Raises InvalidInput."""
    if start is None:
        return parameters(scene)
    if isinstance(start, Scene):
        return parameters(start, flags=scene)
    return given_start(scene, start, neutral(scene) if twin else parameters(scene))


def given_start(scene: Scene, start: float | Array, others: Array) -> Array:
    """Starting values (P,) from numbers: one for all masses and stiffnesses, beside which the other kinds have the
    values of `others` (P,), or one for each parameter. Where factors are fitted, one number is the geometric mean of
    the values, which keep their proportions. Raises InvalidInput.
    """
    count = len(others)
    try:
        values = np.asarray(start, float)
    except (TypeError, ValueError):
        raise InvalidInput(f"start: {start!r} is not a number, an array of numbers or a scene") from None
    if values.ndim > 1 or values.size not in (1, count):
        raise InvalidInput(f"start: {values.size} values given, {scene.name} has {count} parameters")
    lower, upper = bounds(scene)
    p, given = np.broadcast_to(values.reshape(-1), (count,)).copy(), np.ones(count, bool)
    if values.ndim == 0:
        p = np.concatenate([block.at_level(float(values)) for block in scene.blocks])
        if (lettered := of_kinds(scene, LETTERED)).any():
            given = lettered
            p = np.where(given, p, others)
    wrong = given & ~((p >= lower) & (p <= upper))  # True for NaN
    if wrong.any():
        i = int(np.argmax(wrong))
        raise InvalidInput(f"start: {p[i]:g} is not within the bounds {lower[i]:g} … {upper[i]:g}")
    return p


def neutral_start(objective: Objective) -> Array:
    """The best starting values (P,) that a coarse search finds, in the proportions of a fabric or equal: they do not
    depend on the scene's flagged values.
    """
    return best_scales(objective, (fabric(objective.scene), neutral(objective.scene)))[0]


def other_starts(objective: Objective, start: Array, twin: bool, given: bool = False) -> list[Array]:
    """Values (P,) to try beside the `start` (P,), best first: in the proportions of a fabric, equal ones, and, where
    the scene's values are not `twin`, in those of the start, with the start's values of the other kinds; of a start
    that the user has `given` only in its own.
    """
    scene = objective.scene
    if given:
        return best_scales(objective, [start])
    patterns = [fabric(scene), neutral(scene)]
    if not twin:
        patterns = [start, *(np.where(of_kinds(scene, LETTERED), p, start) for p in patterns)]
    return best_scales(objective, patterns)


def neutral(scene: Scene) -> Array:
    """Values (P,) that do not depend on the scene's flagged ones: the neutral value of each kind; of factors, which
    keep the proportions of the scene's values, it is their geometric mean.
    """
    parts = [np.zeros(0)]
    for block in scene.blocks:
        lengths = scene.cloths[block.cloth].lengths if block.cloth is not None and block.name == "rest" else None
        if block.name == "path" and block.cloth is not None:
            own = scene.cloths[block.cloth]
            parts.append(own.path[own.datums].reshape(-1))  # they stand still
        elif block.factors is not None:
            parts.append(block.at_level(block.kind.neutral[0] if lengths is None else geometric_mean(lengths)))
        else:
            values = block.kind.neutral if lengths is None or block.mode == "G" else lengths
            parts.append(np.resize(values, block.count))
    return np.concatenate(parts)


def fabric(scene: Scene) -> Array:
    """The `neutral` values (P,), with masses and stiffnesses per element in the proportions of a uniform fabric."""
    p = neutral(scene)
    for block in scene.blocks:
        if block.mode == "L" and block.name in LETTERED and block.cloth is not None:
            p[block.part] = proportions(scene.cloths[block.cloth])[LETTERED.index(block.name)]
    return p


def proportions(cloth: Cloth) -> tuple[Array, Array]:
    """Relative masses (n,) and stiffnesses (S,) of a uniform fabric, each with geometric mean 1."""
    area = areas(Mesh(cloth.positions, cloth.triangles))
    mass = np.zeros(len(cloth.mass))
    np.add.at(mass, cloth.triangles, area[:, None] / 3)
    return normalised(mass), normalised(spring_areas(cloth, area) / cloth.lengths**2)


def spring_areas(cloth: Cloth, area: Array) -> Array:
    """The area (S,) that each spring stands for, m²; 0 where it is neither an edge nor bends over one."""
    ends, shared, bends = stretched(any_sides(cloth.triangles), area, BENDING_SHARE)
    own = keys(cloth.springs)
    traction, across = (summed(keys(ends[some]), shared[some], own) for some in (~bends, bends))
    return np.where(traction > 0, traction, across)


def summed(keys: NDArray[np.int64], values: Array, wanted: NDArray[np.int64]) -> Array:
    """Sum of the values of each wanted key; 0 where there is none."""
    distinct, group = np.unique(keys, return_inverse=True)
    sums = np.bincount(group.reshape(-1), weights=values, minlength=len(distinct))
    return np.append(sums, 0.0)[places(wanted, distinct)]


def start_warnings(objective: Objective, p: Array) -> list[str]:
    """The warnings of a fit that starts at p (P,)."""
    return [*undetermined(objective.scene), *outside_bounds(objective, p)]


def undetermined(scene: Scene) -> list[str]:
    """Warnings of cloths whose fitted masses and stiffnesses the motion shows only up to a common factor.

    Weight, inertia, node damping and springs all scale with them, and so do air drag and contacts where they are
    fitted, too; only those that are known do not.
    """
    found = []
    scaled = scene.mode("contact") != "n" and not scene.spheres  # the contacts' stiffness is as free as the others
    for i, cloth in enumerate(scene.cloths if scaled or not scene.obstacles else ()):
        if "n" in cloth.settings:
            continue
        if not cloth.feels_air:
            what = "feels neither air nor spheres, so its motion shows masses and stiffnesses"
        elif cloth.mode("drag") != "n":
            what = "feels no spheres, so its motion shows masses, stiffnesses and drag"
        else:
            continue
        if scaled:
            what = f"shows masses, stiffnesses{', drag' if cloth.feels_air else ''} and those of contacts"
        found.append(f"objects[{i}] {what} only up to one common factor")
    return found


def outside_bounds(objective: Objective, p: Array) -> list[str]:
    """Warnings of starting values (P,) that the bounds will move."""
    lower, upper = bounds(objective.scene)
    outside = identifiable(objective.scene) & ((p < lower) | (p > upper))
    return [
        f"{owned(block.cloth, block.name)}: {count} of {block.count} starting values lie outside the bounds "
        f"{block.ends[0]:g} … {block.ends[1]:g} and start at the bound; the truth may lie outside as well"
        for block in objective.blocks if (count := int(outside[block.part].sum()))
    ]  # fmt: skip


def is_steady(scene: Scene) -> bool:
    """Whether keys of the wind are fitted, and all have the same value."""
    keys = scene.gusts
    return scene.mode("gusts") != "n" and len(keys) > 1 and bool((keys == keys[0]).all())


def steadied(scene: Scene) -> Scene:
    """The scene of a steady wind, which is fitted as one value in place of its keys."""
    keys = scene.gusts
    flags = {**{name: mode for name, mode in scene.fits.items() if name != "gusts"}, "wind": "G"}
    return replace(with_wind(scene, scene.wind + keys[0], np.zeros_like(keys)), fits=flags)


def with_wind(scene: Scene, wind: Array, keys: Array) -> Scene:
    """The scene with another steady wind (3,), and other keys (K, 3) beside it, m/s."""
    masses, stiffnesses = zip(*((cloth.mass, cloth.stiffness) for cloth in scene.cloths), strict=True)
    return scene.with_values(masses, stiffnesses, wind=wind, gusts=keys)


def values_by(scene: Scene, flags: Scene) -> Array:
    """The parameters (P,) of a scene by the flags of another one; of a scene that was `steadied` for it, the keys have
    the steady wind.
    """
    if scene.mode("gusts") != "n" or flags.mode("gusts") == "n":
        return parameters(scene, flags=flags)
    steady = scene.wind if flags.mode("wind") != "n" else flags.wind
    made = with_wind(scene, steady, np.broadcast_to(scene.wind - steady, scene.gusts.shape))
    return np.asarray(np.clip(parameters(made, flags=flags), *bounds(flags)))
