"""How a fit and its stages end, and the budget that can end it."""

from __future__ import annotations

import math
from enum import StrEnum
from typing import TYPE_CHECKING, NamedTuple

if TYPE_CHECKING:  # helps are printed without NumPy
    from clothfit.base.arrays import Array

STALL_EVALUATIONS, STALL_REDUCTION = 50, 1e-3
"""A search stalls where so many evaluations in a row lower the best cost by less than this fraction."""


class Status(StrEnum):
    """How a fit ended; each is equal to its text, which summaries and logs show."""

    CONVERGED = "converged"  # at a minimum, at the floor that noise or the model sets, or within the tolerance
    STALLED = "stalled"  # no longer getting better, though not at a minimum
    LIMIT = "limit"  # at the end of its budget
    DIVERGED = "diverged"  # no simulation stayed finite, so there is no result
    INTERRUPTED = "interrupted"  # by the user, with the best point so far


class ModelFit(NamedTuple):
    """What one model of a hierarchy, from coarse to fine, has come to."""

    model: str  # a letter: F, R, M or L; G where there is no other
    values: int  # fitted
    rmse: float  # m
    p: Array  # (P,), in the parameters of the search
    seconds: float  # of its stage


class Stop(Exception):
    """Ends an optimisation from within the cost; `status` says why."""

    def __init__(self, status: Status) -> None:
        self.status = status
        super().__init__(status)


class Budget:
    """The evaluations of cost and gradient: how many there were, how many are allowed, and what each was good for."""

    def __init__(self, limit: int) -> None:
        """`limit`: evaluations allowed."""
        self.limit = limit
        self.history: list[float] = []  # best cost at each evaluation of an optimiser
        self.extra = 0  # simulations that only look around a point, and end nothing
        self.stage = 0  # evaluations before the present stage, which only its own evaluations can stall

    @property
    def evaluations(self) -> int:
        """How many there were."""
        return len(self.history) + self.extra

    def check(self) -> None:
        """Raise Stop when none is left."""
        if len(self.history) >= self.limit:
            raise Stop(Status.LIMIT)

    def count(self, best_cost: float) -> None:
        """Count an evaluation of an optimiser."""
        self.history.append(best_cost)

    def enter_stage(self) -> None:
        """Begin a stage: a search by other parameters."""
        self.stage = len(self.history)

    @property
    def is_stalled(self) -> bool:
        """Whether the last evaluations hardly lowered the best cost."""
        if len(self.history) - self.stage <= STALL_EVALUATIONS:
            return False
        before, now = self.history[-1 - STALL_EVALUATIONS], self.history[-1]
        return math.isfinite(before) and now > (1.0 - STALL_REDUCTION) * before
