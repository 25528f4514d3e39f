"""Motions in which rounding decides: a cloth that buckles, or hops on what it touches, from some step on.

Two motions with the same values whose starts differ by as much as the numbers of files are rounded grow apart. Where
they end about as far from each other as from the target, and values reproduce all of it before, no values can bring the
rest nearer, and a search there follows chance: those of the first steps are kept.
"""

from __future__ import annotations

from collections.abc import Sequence
from contextlib import suppress
from dataclasses import replace

import numpy as np

from clothfit.base.arrays import Array
from clothfit.motion.divergence import Diverged
from clothfit.motion.simulate import simulate
from clothfit.objective.objective import Objective
from clothfit.scene.fit_vector import with_parameters
from clothfit.scene.scene import Scene

TEXT = (
    "then rounding decides: starts that differ by as much as numbers in files grow as far apart as this motion and the "
    "target are, so these values are those of the first steps"
)

ROUNDING = 1e-7
"""Change of the start relative to the size of the cloth: that of single precision."""

EXACT = 1e-4
"""Error relative to how far the target moves, up to which the first steps are reproduced."""

SHARE, SPAN = 0.2, 0.2
"""Share of the error that the twins must be apart, and of all steps that must be reproduced."""


def begins(objective: Objective, exact: Sequence[tuple[Objective, Array]]) -> int:
    """The steps that are reproduced before rounding decides, from windows with the values (P,) that do so; 0 where it
    does not decide, or they are too few.
    """
    good = [(window, p) for window, p in exact if window.cost_or_infinity(p) <= EXACT**2 * window.still]
    if not good or len(good) < len(exact) or len(objective.experiments) > 1:
        return 0
    window, p = good[-1]
    if window.steps < SPAN * objective.steps:
        return 0
    with suppress(Diverged):
        scene = with_parameters(objective.experiments[0].scene, p)
        apart = twins(scene, objective.steps + 1)
        if apart >= SHARE * objective.rmse(objective.cost_or_infinity(p)):
            return int(window.steps)
    return 0


def twins(scene: Scene, frames: int) -> float:
    """How far two motions of a scene are apart whose starts differ by rounding, m (RMS)."""
    random = np.random.default_rng(0)
    cloths = []
    for cloth in scene.cloths:
        size = float(np.linalg.norm(np.ptp(cloth.positions, axis=0)))
        noise = ROUNDING * size * random.uniform(-1.0, 1.0, cloth.positions.shape)
        cloths.append(replace(cloth, positions=cloth.positions + np.where(cloth.fixed[:, None], 0.0, noise)))
    one, other = (simulate(each, frames).positions for each in (scene, replace(scene, cloths=tuple(cloths))))
    return float(np.sqrt(((one - other) ** 2).sum(axis=2).mean()))
