"""How far a fit is, and how it reports that."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from typing import TYPE_CHECKING

import numpy as np

from clothfit.base.arrays import Array
from clothfit.base.messages import metres
from clothfit.kernels.clock import computing, elapsed

if TYPE_CHECKING:
    from clothfit.scene.scene import Scene

FEWEST_MARKS, SHORTEST_TREND = 6, 3.0
"""Reports, and seconds, from which on a trend is looked at."""

SLOWING, ENOUGH = 0.8, 1e-3
"""Fall of the cost in a span relative to that before, above which nothing is said; relative to the cost, below which a
fit ends.
"""

FARTHEST_TREND = 3.0
"""Time left relative to that of the trend, above which nothing is said."""


@dataclass(frozen=True)
class Progress:
    """What a fit reports while it runs."""

    evaluations: int  # of the cost so far
    budget: int  # evaluations allowed
    cost: float  # best so far, m²
    rmse: float  # best so far, m; of what is compared
    seconds: float  # since the fit began, without compilation
    iteration: int = 0  # changes of the parameters that were accepted so far
    step: float = np.nan  # the largest relative change of a parameter by the last of them
    stage: str = ""  # what is being done: a method, or what prepares it
    window: int = 0  # frames that are compared at this stage …
    frames: int = 0  # … of so many
    window_rmse: float = np.nan  # of the last accepted point, m, where that is of fewer than all frames
    unit: str = "m"  # of the errors: "m", "m/s", or none
    best: Callable[[], Scene] | None = field(default=None, repr=False)  # makes the scene with the best values so far

    def __str__(self) -> str:
        return f"{self.seconds:.1f} s  {self.reached}  evaluation {self.evaluations}  {self.stage}"

    @property
    def reached(self) -> str:
        """The error of the best values so far."""
        return f"RMSE {metres(self.rmse) if self.unit == 'm' else f'{self.rmse:.3g} {self.unit}'.strip()}"


class Trend:
    """The time that a fit will still take, from how its cost has fallen lately.

    Once all frames are compared, let the cost fall by d₁ and then by d₂ in two successive spans of Δ seconds. If it
    goes on so, by q = d₂ / d₁ less each time, the fall in a span is below the fraction `ENOUGH` of the cost c, where
    fits end, after Δ log(d₂ / (ENOUGH c)) / log(1 / q). Nothing is said where the fall does not slow down, or of a time
    many times as long as what was seen.
    """

    def __init__(self) -> None:
        self.marks: list[tuple[float, float]] = []  # seconds and cost, since all frames are compared
        self.stage = ""

    def update(self, progress: Progress) -> float | None:
        """The seconds left at some progress; None where they cannot be told."""
        if progress.window != progress.frames or progress.stage != self.stage:
            self.marks, self.stage = [], progress.stage
        self.marks.append((progress.seconds, progress.cost))
        span = (progress.seconds - self.marks[0][0]) / 3.0
        if len(self.marks) < FEWEST_MARKS or 3.0 * span < SHORTEST_TREND or progress.window != progress.frames:
            return None
        times, costs = zip(*self.marks, strict=True)
        c = np.interp(progress.seconds - span * np.arange(3), times, costs)
        last, before = float(c[0] - c[1]), float(c[1] - c[2])  # not above 0
        if not (last < 0.0 and last > SLOWING * before):
            return None
        left = span * np.log(max(last / (-ENOUGH * c[0]), 1.0)) / np.log(before / last)
        return float(left) if left <= FARTHEST_TREND * 3.0 * span else None


class Reporter:
    """The stage of a fit, the frames that it compares, its last accepted point, and who wants to know."""

    def __init__(
        self, report: Callable[[Progress], None] | None, p: Array, frames: int, unit: str = "m",
        clock: Callable[[], float] = computing,
    ) -> None:  # fmt: skip
        """`p` (P,): the first point; `frames`: all that are compared; `unit`: of the errors; `clock`: by which the fit
        goes (`kernels.clock`).
        """
        self.receiver, self.p, self.frames, self.unit = report, p, frames, unit
        self.stage, self.window, self.window_rmse = "start", frames, np.nan
        self.iterations, self.step = 0, np.nan
        self.clock, self.began, self.began_computing = clock, elapsed(), clock()

    @property
    def computing(self) -> float:
        """Seconds since then by the clock of the fit, without compilation; other work of the machine does not count."""
        return self.clock() - self.began_computing

    @property
    def seconds(self) -> float:
        """Seconds since the fit began, without compilation."""
        return elapsed() - self.began

    def enter(self, stage: str, window: int) -> None:
        """Name what is done from now on, and the frames that it compares."""
        self.stage, self.window = stage, window

    def advance(self, p: Array, step: float, window_rmse: float) -> None:
        """Make parameters (P,) the last accepted point; it counts where they changed, by at most `step`, relative."""
        self.window_rmse = window_rmse
        if not np.array_equal(p, self.p):
            self.p, self.step, self.iterations = p, step, self.iterations + 1

    def report(
        self, evaluations: int, budget: int, cost: float, rmse: float, best: Callable[[], Scene] | None = None
    ) -> None:
        """Report the best point of that cost; `best` makes its scene."""
        if self.receiver:
            at = (self.iterations, self.step, self.stage, self.window, self.frames, self.window_rmse, self.unit)
            self.receiver(Progress(evaluations, budget, cost, rmse, self.seconds, *at, best))
