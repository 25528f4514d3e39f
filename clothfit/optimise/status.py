"""How a fit ends."""

from __future__ import annotations

from enum import StrEnum


class Status(StrEnum):
    """How a fit ended; each is equal to its text, which summaries and logs show."""

    CONVERGED = "converged"  # at a minimum, at the floor that noise or the model sets, or within the tolerance
    STALLED = "stalled"  # no longer getting better, though not at a minimum
    LIMIT = "limit"  # at the end of its budget
    DIVERGED = "diverged"  # no simulation stayed finite, so there is no result
    INTERRUPTED = "interrupted"  # by the user, with the best point so far


class Stop(Exception):
    """Ends an optimisation from within the cost; `status` says why."""

    def __init__(self, status: Status) -> None:
        self.status = status
        super().__init__(status)
