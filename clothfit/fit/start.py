"""Where a fit starts: at the given values, or at the scene's. Where these are the truth, which the fit may not know, it
starts at the best of a coarse search (`coarse_search`) in the proportions of a fabric (`fabric`) or with equal values.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from clothfit.base.arrays import Array, Flags
from clothfit.base.errors import InvalidInput
from clothfit.fit.coarse_search import best_scales
from clothfit.fit.fabric import proportions
from clothfit.fit.start_warnings import start_warnings
from clothfit.objective.identifiability import identifiable
from clothfit.objective.objective import Objective
from clothfit.scene.fit_vector import bounds, parameters
from clothfit.scene.kinds import LETTERED
from clothfit.scene.scene import Scene

SELF_STARTING = ("auto", "momentum")
"""Methods that look for a start themselves where none is given."""


def first_point(
    objective: Objective, start: float | Array | Scene | None, hidden: bool, method: str
) -> tuple[Array, list[str]]:
    """The first point (P,) of a method, with warnings; `start` is what the user gives.

    `hidden`: the scene's own values are the truth, which the fit may not know. Raises InvalidInput as `choose_start`.
    """
    scene = objective.scene
    if hidden and start is None and method in SELF_STARTING:
        p = np.where(objective.identifiable, fabric(scene), parameters(scene))
        return p, start_warnings(objective, p)
    p = choose_start(objective, start, hidden)
    warnings = start_warnings(objective, p)
    if not np.isfinite(objective.cost_or_infinity(p)):
        instead = "the fit starts from the best of a coarse search instead"
        warnings.append(f"the simulation diverges at the start; {instead}")
        p = neutral_start(objective, [p])
    return p, warnings


def choose_start(objective: Objective, start: float | Array | Scene | None, hidden: bool) -> Array:
    """Starting values (P,) of all parameters. Raises InvalidInput when they are not numbers within the bounds."""
    scene = objective.scene
    if isinstance(start, Scene):
        return parameters(start, flags=scene)
    if start is not None:
        return given_start(scene, start, neutral(scene) if hidden else parameters(scene))
    if hidden:
        return np.where(identifiable(scene), neutral_start(objective), parameters(scene))
    return parameters(scene)


def given_start(scene: Scene, start: float | Array, others: Array) -> Array:
    """Starting values (P,) from numbers: one for all masses and stiffnesses, beside which the other kinds have the
    values of `others` (P,), or one for each parameter. Raises InvalidInput.
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
    if values.ndim == 0 and lettered(scene).any():
        given = lettered(scene)
        p = np.where(given, p, others)
    wrong = given & ~((p >= lower) & (p <= upper))  # True for NaN
    if wrong.any():
        i = int(np.argmax(wrong))
        raise InvalidInput(f"start: {p[i]:g} is not within the bounds {lower[i]:g} … {upper[i]:g}")
    return p


def neutral_start(objective: Objective, patterns: Sequence[Array] | None = None) -> Array:
    """The best starting values (P,) that a coarse search finds, in the proportions of one of the `patterns` (P,):
    those of a fabric and equal ones where none are given, so that nothing depends on the scene's flagged values.
    """
    scene = objective.scene
    return best_scales(objective, patterns or (fabric(scene), neutral(scene)))[0]


def other_starts(objective: Objective, start: Array, hidden: bool) -> list[Array]:
    """Values (P,) to try beside the `start` (P,), best first: in the proportions of a fabric, equal ones, and, where
    the scene's values are not `hidden`, in those of the start, with the start's values of the other kinds.
    """
    scene = objective.scene
    patterns = [fabric(scene), neutral(scene)]
    if not hidden:
        patterns = [start, *(np.where(lettered(scene), p, start) for p in patterns)]
    return best_scales(objective, patterns)


def neutral(scene: Scene) -> Array:
    """Values (P,) that do not depend on the scene's flagged ones: the neutral value of each kind."""
    parts = [np.zeros(0)]
    for block in scene.blocks:
        lengths = block.name == "rest" and block.mode == "L" and block.cloth is not None
        values = scene.cloths[block.cloth or 0].lengths if lengths else block.kind.neutral
        parts.append(np.resize(values, block.count))
    return np.concatenate(parts)


def fabric(scene: Scene) -> Array:
    """The `neutral` values (P,), with masses and stiffnesses per element in the proportions of a uniform fabric."""
    p = neutral(scene)
    for block in scene.blocks:
        if block.mode == "L" and block.name in LETTERED and block.cloth is not None:
            p[block.part] = proportions(scene.cloths[block.cloth])[LETTERED.index(block.name)]
    return p


def lettered(scene: Scene) -> Flags:
    """Which parameters (P,) are masses or stiffnesses."""
    found = scene.blocks
    return np.repeat(np.array([block.name in LETTERED for block in found], bool), [block.count for block in found])
