"""The few values of a tool that a fit may change, and the fit: Gauss–Newton on their logarithms in a trust region.

A tool is a `Tool`: its values at the start, which a mapping gives, what its cloth does with others, and, where it has
one, the derivative of that; else finite differences of the length `difference` take its place. For values of each
constraint see `many_values`.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import NamedTuple, Protocol

import numpy as np

from clothfit.base import interrupts
from clothfit.base.arrays import Array, Flags
from clothfit.base.errors import InvalidInput
from clothfit.objective.target import Target, sample

RANGE = np.log(1e5)
"""How far a value may go from its start, in its logarithm, where it does not say."""

FAR = 30.0
"""Distance in travels that counts where a motion runs away."""

WEAK = 1e-5
"""Of the travel: an error as small as this outweighs a change of a value by a factor e. What the motion does not show
stays."""

TINY = 1e-12
"""m, the least travel."""


class Value(NamedTuple):
    """One value of a tool."""

    name: str
    unit: str
    start: float  # from the mapping, or where that has 0 the least that is tried
    mapped: float  # from the mapping
    spread: float = RANGE  # how far it may go from its start, in its logarithm


class State(Protocol):
    """A state of a tool's cloth of n vertices, and its changes along V logarithms of values, or none."""

    h: float  # s, a step
    free: Flags  # (n,), what is not fixed
    x: Array  # (n, 3), m
    v: Array  # (n, 3), m/s
    dx: Array  # (n, 3, V)
    dv: Array  # (n, 3, V)

    def advance(self, t: int) -> None:
        """Take step t."""
        ...


@dataclass(frozen=True)
class Tool:
    """What a fit needs of a tool for one cloth of n vertices; V values in the order of `values`."""

    name: str
    values: tuple[Value, ...]
    motion: Callable[[Array], Array | None]  # of values (V,): positions (frames, n, 3), m; None where it runs away
    columns: Callable[[Array], Array] | None = None  # of values: change of the positions by each logarithm (V, …)
    difference: float = 0.02  # of a logarithm, where there are no columns
    # of values: the state at the start, whose changes along all logarithms come with it, or not
    sweep: Callable[[Array, bool], State] | None = None


@dataclass(frozen=True)
class Fitted:
    """What was found for one cloth."""

    tool: Tool
    found: Array  # (V,)
    mapped_rmse: float  # m, of the mapped values; infinite where the cloth runs away with them
    rmse: float  # m
    travel: float  # m
    simulations: int
    positions: Array  # (frames, n, 3), of the tool's cloth
    few: Fitted | None = None  # of many values, the fit of the few, at which they start

    def kinds(self) -> list[tuple[str, str, Array, Array]]:
        """The values by name, in their order: name, unit, those of the mapping and those found."""
        names = np.array([value.name for value in self.tool.values])
        mapped = np.array([value.mapped for value in self.tool.values])
        unit = {value.name: value.unit for value in self.tool.values}
        return [(name, unit[name], mapped[names == name], self.found[names == name]) for name in unit]


class Fit:
    """A fit that is under way; `goal` counts its frames in those of the tool."""

    def __init__(self, tool: Tool, goal: Target, report: Callable[[float, int], None] | None) -> None:
        self.tool, self.goal, self.report = tool, goal, report
        self.simulations = 0
        self.kept: tuple[Array, Array] | None = None  # logarithms, and what they gave
        self.best: tuple[float, Array, Array] | None = None  # RMSE, values, positions
        self.start = np.log([value.start for value in tool.values])
        spread = np.array([value.spread for value in tool.values])
        self.lower, self.upper = self.start - spread, self.start + spread
        first = sample(goal, np.repeat(goal.positions[:1], goal.last_step + 1, axis=0))
        self.travel = max(rms((goal.positions - first)[goal.observed]), TINY)

    def apart(self, positions: Array) -> Array:
        """The distances (…, 3) of a motion from the target, where that is seen, m."""
        found: Array = (sample(self.goal, positions) - self.goal.positions)[self.goal.observed]
        return found

    def simulated(self, numbers: Array) -> Array | None:
        """The motion with some values, and whether it is the best so far."""
        interrupts.check()
        self.simulations += 1
        made = self.tool.motion(numbers)
        if made is None or not np.isfinite(made).all():
            return None
        error = rms(self.apart(made))
        if self.best is None or error < self.best[0]:
            self.best = error, numbers, made
        if self.report:
            self.report(self.best[0], self.simulations)
        return made

    def positions(self, y: Array) -> Array | None:
        """The motion at logarithms y; that of the last ones is kept."""
        if self.kept is None or not (self.kept[0] == y).all():
            made = self.simulated(np.exp(y))
            if made is None:
                return None
            self.kept = y.copy(), made
        return self.kept[1]

    def residuals(self, y: Array) -> Array:
        """The distances from the target in travels, and how far each value has gone, weakly."""
        made, weak = self.positions(y), WEAK * (y - self.start)
        count = int(self.goal.observed.sum())
        apart = np.full((count, 3), FAR) if made is None else self.apart(made) / self.travel
        return np.concatenate([apart.reshape(-1) / np.sqrt(max(count, 1)), weak])

    def jacobian(self, y: Array) -> Array:
        """The derivative of the residuals."""
        own = self.positions(y)
        columns = []
        if own is not None and self.tool.columns is not None:
            columns = [sample(self.goal, each) for each in self.tool.columns(np.exp(y))]
        elif own is not None:
            columns = [sample(self.goal, self.difference(y, own, k)) for k in range(len(y))]
        count = int(self.goal.observed.sum())
        top = np.zeros((3 * count, len(y)))
        for k, column in enumerate(columns):
            top[:, k] = column[self.goal.observed].reshape(-1) / self.travel / np.sqrt(count)
        return np.vstack([top, WEAK * np.eye(len(y))])

    def difference(self, y: Array, own: Array, k: int) -> Array:
        """The change of the positions by logarithm k."""
        step = self.tool.difference * (1.0 if y[k] < self.upper[k] - self.tool.difference else -1.0)
        other = y.copy()
        other[k] += step
        made = self.simulated(np.exp(other))
        return np.zeros_like(own) if made is None else (made - own) / step

    def run(self, most: int) -> Fitted:
        """Find the values, from those of the mapping, with at most so many steps. Raises InvalidInput where the cloth
        runs away with all of them.
        """
        values = np.array([value.mapped for value in self.tool.values])
        mapped = self.simulated(values)
        mapped_rmse = np.inf if mapped is None else rms(self.apart(mapped))
        self.search(most)
        if self.best is None:
            raise InvalidInput(f"{self.tool.name}: the cloth runs away, with the mapped values and with all that were "
                               "tried; take more substeps")
        rmse, found, positions = self.best
        return Fitted(self.tool, found, mapped_rmse, rmse, self.travel, self.simulations, positions)

    def search(self, most: int) -> None:
        """Gauss–Newton in a trust region, with at most so many steps."""
        from scipy.optimize import least_squares

        least_squares(
            self.residuals, self.start, self.jacobian, (self.lower, self.upper), max_nfev=most,
            xtol=1e-5, ftol=1e-5, gtol=1e-12,
        )  # fmt: skip


def rms(points: Array) -> float:
    """Root mean square of the lengths of (…, 3); 0 without any."""
    return float(np.sqrt((points**2).sum(axis=-1).mean())) if len(points) else 0.0
