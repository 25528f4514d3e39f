"""How far a fit is, and how it reports that."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from clothfit.base.arrays import Array


@dataclass(frozen=True)
class Progress:
    """What a fit reports while it runs."""

    evaluations: int
    budget: int  # evaluations allowed
    cost: float  # best so far, m²
    rmse: float  # best so far, m; of what is compared
    seconds: float
    iteration: int = 0  # changes of the parameters that were accepted so far
    step: float = np.nan  # the largest relative change of a parameter by the last of them
    stage: str = ""  # what is being done: a method, or what prepares it
    window: int = 0  # frames that are compared at this stage …
    frames: int = 0  # … of so many
    window_rmse: float = np.nan  # of the last accepted point, m, where that is of fewer than all frames


class Reporter:
    """The stage of a fit, the frames that it compares, its last accepted point, and who wants to know."""

    def __init__(self, report: Callable[[Progress], None] | None, p: Array, frames: int) -> None:
        """`p` (P,): the first point; `frames`: all that are compared."""
        self.receiver, self.p, self.frames = report, p, frames
        self.stage, self.window, self.window_rmse = "start", frames, np.nan
        self.iterations, self.step = 0, np.nan
        self.began = time.perf_counter()

    @property
    def seconds(self) -> float:
        """Time since the fit began."""
        return time.perf_counter() - self.began

    def enter(self, stage: str, window: int) -> None:
        """Name what is done from now on, and the frames that it compares."""
        self.stage, self.window = stage, window

    def advance(self, p: Array, step: float, window_rmse: float) -> None:
        """Make parameters (P,) the last accepted point; it counts where they changed, by at most `step`, relative."""
        self.window_rmse = window_rmse
        if not np.array_equal(p, self.p):
            self.p, self.step, self.iterations = p, step, self.iterations + 1

    def report(self, evaluations: int, budget: int, cost: float, rmse: float) -> None:
        """Report the best point of that cost."""
        if self.receiver:
            at = (self.iterations, self.step, self.stage, self.window, self.frames, self.window_rmse)
            self.receiver(Progress(evaluations, budget, cost, rmse, self.seconds, *at))
