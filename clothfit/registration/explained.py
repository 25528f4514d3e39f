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
from clothfit.objective.experiment import Experiment
from clothfit.objective.loss import Loss
from clothfit.optimise import bounded
from clothfit.optimise.gauss_newton import Model
from clothfit.registration.record import Registration
from clothfit.registration.residuals import OFFSET, PLACE, RATE, THETA
from clothfit.registration.search import Stage, Wanted
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


def stage_of(scene: Scene, given: Sequence[Experiment], loss: Loss, place: bool) -> Stage:
    """The targets and the values of a scene, where clocks, or where places are looked for. Raises Diverged."""
    stage = Stage.of(scene, given, Wanted(not place, place, loss))
    stage = replace(stage, registered=replace(stage.registered, tolerance=TOLERANCE))
    return stage.weighted() if place else stage


def promised(stage: Stage) -> dict[str, float]:
    """The share of the squares that each kind that a stage seeks promises to explain. Raises Diverged."""
    unmoved = [Registration()] * len(stage.registered.given)
    every = Unknowns(stage.registered, stage.start, stage.near(unmoved), np.ones(THETA, bool))
    model, values = every.model(every.begin), len(stage.start)
    own = np.arange(len(model.g)) < values
    base = model.cost - saving(model, own)
    found = {}
    for what, part in KINDS.items():
        if stage.free[part].all() and base > 0:
            moved = np.zeros(THETA, bool)
            moved[part] = True
            free = np.concatenate([own[:values], np.tile(moved, len(unmoved))])
            found[what] = 1.0 - (model.cost - saving(model, free)) / base
    return found


def saving(model: Model, free: Flags) -> float:
    """What the best step of some coordinates saves of a cost."""
    H, g = model.H[np.ix_(free, free)], model.g[free]
    scale = 1.0 / np.sqrt(np.maximum(np.diag(H), np.finfo(float).tiny))
    step = scale * bounded.within(H * np.outer(scale, scale), g * scale)
    return -float(2.0 * g @ step + step @ H @ step)


def explained(stage: Stage, what: str) -> Explained | None:
    """What one kind of registration explains of the residuals at the start; None where the motion diverges."""
    unmoved = [Registration()] * len(stage.registered.given)
    before, after = stage.cost(stage.start, unmoved), stage.only(KINDS[what]).descended(stage.start, unmoved, STEPS)
    return Explained(what, 1.0 - after.cost / before, after.registrations[0]) if after and before > 0 else None
