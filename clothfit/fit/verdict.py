"""The verdict on the model: does the fitted motion explain the target but for noise, and if not, how much is left?

What is left counts as noise where `whiteness` finds no structure in it. Of what has structure, the share s of the
squares is no noise; the fraction of the motion that is not explained is then sqrt(s) RMSE / travel, with the travel
the RMS distance of the target's positions from the start.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from clothfit.base.arrays import Array
from clothfit.objective.objective import Objective
from clothfit.objective.whiteness import ResidualTest, residual_test

ADEQUATE, DIFFERS = "adequate", "differs"

NEGLIGIBLE = 1e-4
"""Unexplained fraction of the motion that nobody sees: 0.1 mm in a metre."""


@dataclass(frozen=True)
class Verdict:
    """Whether the model can reproduce the target."""

    model: str  # "adequate": what is left is noise, rounding or nothing; "differs": it is not
    unexplained: float  # fraction of the motion, without noise

    @property
    def differs(self) -> bool:
        """Whether the model cannot reproduce the target."""
        return self.model == DIFFERS


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
