"""Several starts for one fit: where one ends in a poor minimum, another may not.

Start number 0 is the one that a fit takes anyway. Each other start multiplies the masses, stiffnesses and lengths of a
cloth by one factor per kind, drawn log-uniformly between 1/10 and 10, and shifts values that may be negative by up to
their typical size. A start depends only on the seed and its number, so the fifth of eight is also the fifth of a
hundred. Values that are not identifiable stay as they are.
"""

from __future__ import annotations

import numpy as np

from clothfit.base.arrays import Array
from clothfit.base.limits import FIT_TOLERANCE, checked_tolerance
from clothfit.motion.simulate import simulate_cloths
from clothfit.objective.experiment import Targets
from clothfit.objective.identifiability import identifiable
from clothfit.objective.objective import Objective
from clothfit.scene.fit_vector import bounds, fitted_cloths, parameters, with_parameters
from clothfit.scene.scene import Scene
from clothfit.strategy.start import choose_start

FACTOR = 10.0


def numbered(
    scene: Scene, target: Targets | None, start: float | Array | Scene | None, number: int, seed: int,
    tolerance: float | None = None,
) -> float | Array | Scene | None:
    """The start with that number: `start` itself for 0, else a scene with drawn values.

    They are drawn around `start`. Without one they are drawn around the scene's values, or, where these are the hidden
    truth (`target` is None), around the best values of a coarse search. `tolerance` is that of the fit.
    """
    if number == 0:
        return start
    hidden = target is None
    if target is None:
        target = simulate_cloths(scene, fitted_cloths(scene), tolerance=checked_tolerance(tolerance, FIT_TOLERANCE))
    middle = choose_start(Objective(scene, target), start, hidden)
    return with_parameters(scene, drawn(scene, middle, np.random.default_rng([seed, number])))


def drawn(scene: Scene, middle: Array, draw: np.random.Generator) -> Array:
    """Draw values (P,) around `middle` (P,), within the bounds."""
    p = middle.copy()
    lower, upper = bounds(scene)
    for block in scene.blocks:
        kind, part = block.kind, block.part
        if kind.log:
            p[part] *= np.where(block.constant, FACTOR ** draw.uniform(-1.0, 1.0), 1.0)
        else:
            steps = draw.uniform(-1.0, 1.0, kind.components)
            p[part] += np.resize(steps, block.count) * max(kind.scale, float(np.abs(middle[part]).max()))
    return np.where(identifiable(scene), np.clip(p, lower, upper), parameters(scene))
