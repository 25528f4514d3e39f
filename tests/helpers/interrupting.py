"""Requests to end that come at a certain simulation."""

from typing import Any

import pytest

from clothfit.base import interrupts
from clothfit.objective.objective import Objective


def interrupt_after(monkeypatch: pytest.MonkeyPatch, simulations: int) -> None:
    """Ask for an end at the simulation of an objective after so many."""
    count, original = iter(range(simulations)), Objective.simulate

    def simulate_some(self: Objective, *given: Any, **options: Any) -> Any:
        if next(count, None) is None:
            interrupts.request()
        return original(self, *given, **options)

    monkeypatch.setattr(Objective, "simulate", simulate_some)
