"""How much of what a fit leaves another clock or another place would explain.

Near the result the cost is |r|² + 2 gᵀz + zᵀH z in the values and the coordinates of a registration. What one kind of
registration saves beyond what the values save alone, relative to the cost, is the share of the squares that it
promises to explain. As that is linear, a few steps of Gauss–Newton then show what it does explain. Places are judged by
weighted residuals, as in `search`: what is held must not move away from where it is held.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from clothfit.base.arrays import Flags
from clothfit.motion.divergence import Diverged
from clothfit.objective.experiment import Experiment
from clothfit.objective.loss import Loss
from clothfit.optimise import ball
from clothfit.optimise.gauss_newton import Model
from clothfit.registration.record import Registration
from clothfit.registration.residuals import OFFSET, PLACE, RATE, THETA, summed
from clothfit.registration.search import Stage, Wanted, trust_in
from clothfit.registration.unknowns import Unknowns
from clothfit.scene.scene import Scene

STEPS = 5
"""Steps of Gauss–Newton."""

TOLERANCE = 1e-5
"""Of the linear systems: a share of what a model that differs leaves needs no better motion."""

KINDS = {"offset": slice(OFFSET, OFFSET + 1), "rate": slice(RATE, RATE + 1), "placement": PLACE}
"""The coordinates of each kind of registration."""


@dataclass(frozen=True)
class Explained:
    """What one kind of registration explains."""

    what: str  # one of `KINDS`
    share: float  # of the squares that the values leave, weighted for a place
    registration: Registration  # of the first target


def stage_of(scene: Scene, given: Sequence[Experiment], loss: Loss, wanted: Wanted) -> Stage:
    """The targets and the values of a scene, where registrations are looked for."""
    stage = Stage.of(scene, given, wanted)
    return replace(stage, registered=replace(stage.registered, tolerance=TOLERANCE))


def promised(scene: Scene, given: Sequence[Experiment], loss: Loss) -> dict[str, float]:
    """The share of the squares that each kind promises to explain, all from one motion. Raises Diverged."""
    stage = stage_of(scene, given, loss, Wanted(True, True, loss))
    unmoved = [Registration()] * len(given)
    every = Unknowns(stage.registered, stage.start, stage.near(unmoved), np.ones(THETA, bool))
    plain = every.sums(every.begin)
    weighted = summed(len(plain.g), plain.parts, trust_in(plain.parts))
    values, found = len(stage.start), {}
    for what, part in KINDS.items():
        model = every.model_of(every.begin, weighted if what == "placement" else plain)
        own = np.arange(len(model.g)) < values
        base = model.cost - saving(model, own)
        moved = np.zeros(THETA, bool)
        moved[part] = True
        free = np.concatenate([own[:values], np.tile(moved, len(unmoved))])
        found[what] = 1.0 - (model.cost - saving(model, free)) / base if base > 0 else 0.0
    return found


def saving(model: Model, free: Flags) -> float:
    """What the best step of some coordinates saves of a cost."""
    H, g = model.H[np.ix_(free, free)], model.g[free]
    scale = 1.0 / np.sqrt(np.maximum(np.diag(H), np.finfo(float).tiny))
    step = scale * ball.within(ball.Quadratic(H * np.outer(scale, scale), g * scale))
    return -float(2.0 * g @ step + step @ H @ step)


def explained(scene: Scene, given: Sequence[Experiment], loss: Loss, what: str) -> Explained | None:
    """What one kind of registration explains of the residuals; None where the motion diverges."""
    place = what == "placement"
    stage = stage_of(scene, given, loss, Wanted(not place, place, loss))
    unmoved = [Registration()] * len(given)
    try:
        stage = stage.weighted() if place else stage
    except Diverged:
        return None
    before, after = stage.cost(stage.start, unmoved), stage.only(KINDS[what]).descended(stage.start, unmoved, STEPS)
    return Explained(what, 1.0 - after.cost / before, after.registrations[0]) if after and before > 0 else None
