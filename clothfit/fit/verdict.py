"""The verdict on the model: does the fitted motion explain the target but for noise, and if not, how much is left?

What is left counts as noise where `whiteness` finds no structure in it. Of what has structure, the share s of the
squares is no noise; the fraction of the motion that is not explained is then sqrt(s) RMSE / travel, with the travel
the RMS distance of the target's positions from the start.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from typing import NamedTuple

import numpy as np

from clothfit.base import interrupts
from clothfit.base.arrays import Array
from clothfit.fit.confidence import EXACT, Confidence
from clothfit.motion.divergence import Diverged
from clothfit.objective.objective import Objective
from clothfit.objective.whiteness import ResidualTest, residual_test
from clothfit.optimise.search import Search
from clothfit.scene.fit_vector import parameters

ADEQUATE, DIFFERS = "adequate", "differs"

NEGLIGIBLE = 1e-4
"""Unexplained fraction of the motion that nobody sees: 0.1 mm in a metre."""

MOMENT = 0.5
"""Seconds for the error of positions where the fit was asked to end."""


@dataclass(frozen=True)
class Verdict:
    """Whether the model can reproduce the target."""

    model: str  # "adequate": what is left is noise, rounding or nothing; "differs": it is not
    unexplained: float  # fraction of the motion, without noise

    @property
    def differs(self) -> bool:
        """Whether the model cannot reproduce the target."""
        return self.model == DIFFERS


class Judgement(NamedTuple):
    """What is said of a result: nothing of its values without a verdict on its model."""

    verdict: Verdict | None
    known: Confidence | None


UNKNOWN = Judgement(None, None)


def verdict(objective: Objective, p: Array, relative: float) -> Verdict | None:
    """The verdict on the motion of p (P,), whose error relative to the distance travelled is `relative`; None where
    only spectra are compared. Raises Diverged.
    """
    if relative <= NEGLIGIBLE:
        return Verdict(ADEQUATE, relative)
    test = residual_test(objective, p)
    return None if test is None else judged(test, relative)


def judged(test: ResidualTest, relative: float) -> Verdict:
    """The verdict on residuals whose size, relative to the motion, is `relative`."""
    unexplained = float(np.sqrt(test.structured)) * relative
    adequate = test.is_noise or unexplained <= NEGLIGIBLE
    return Verdict(ADEQUATE if adequate else DIFFERS, unexplained)


def judgement(search: Search, trial: bool, look: Callable[[Search, bool], Confidence | None]) -> Judgement:
    """What is said of the best point of a search, as in `with_verdict`; `look` finds the confidence, from whether what
    is left is no noise. Nothing where nothing moves, or only spectra are compared.
    """
    objective, p, cost = search.objective, search.best.p, search.best.cost
    rmse, travel = position_rmse(search, p, cost), objective.travel
    if not (travel > 0 and np.isfinite(rmse)):
        return UNKNOWN
    exact = objective.rmse(cost) <= min(search.rmse_tolerance, EXACT)
    left = Verdict(ADEQUATE, rmse / travel) if exact else verdict(objective, p, rmse / travel)
    if left is None:
        return UNKNOWN
    known = look(search, left.differs)
    enough = reproduced(objective, cost, search.rmse_tolerance, trial)
    return Judgement(Verdict(ADEQUATE, rmse / travel) if enough else left, known)


def reproduced(objective: Objective, cost: float, tolerance: float, trial: bool) -> bool:
    """Whether a cost is good enough, or the target is the scene's own motion and a model as free as that of the fit has
    the scene's own values.
    """
    own = partial(objective.cost_or_infinity, parameters(objective.scene))
    return objective.rmse(cost) <= tolerance or (trial and objective.rmse(own()) <= tolerance)


def position_rmse(search: Search, p: Array, cost: float) -> float:
    """Root mean square distance, m, of the observed positions at p (P,) of that cost; inf where they diverge, NaN where
    a request or the time leaves no moment to look.
    """
    if search.objective.plain or not np.isfinite(cost):
        return search.objective.rmse(cost)
    moment = MOMENT if interrupts.requested() else None
    try:
        with interrupts.heard(), interrupts.grace(MOMENT), interrupts.limited(moment):
            return search.objective.position_rmse(p)
    except Diverged:  # the cost saw only what is finite
        return np.inf
    except (interrupts.OutOfTime, KeyboardInterrupt):
        return np.nan
