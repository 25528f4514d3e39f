"""The values of a tool that a fit may change, and the fits: of few by Gauss–Newton on their logarithms in a trust
region, of many, some for each constraint and vertex, by Levenberg–Marquardt.

A tool is a `Tool`: its values at the start, which a mapping gives, what its cloth does with others, and, where it has
one, the derivative of that; else finite differences of the length `difference` take its place.

With the residuals r (`Fit.residuals`) and their derivative J by the logarithms of the values, a step d of many is the
least of |J d + r|² + μ|d|². JᵀJ is added up frame by frame, with the changes of the state along all values side by side
(`directions`).

Far from the values that fit, the cost of a whole motion has many minima. So descents are nudged after a first one that
is not: after each step the state goes a part of the way, one of PULLS after the other, to where the target is, so that
an error counts for about 1/pull steps; see `fit.few_values`. They go on without a pull. One begins where the
first does, one with the mapped values, and the last, of smaller parts, leaves the best minimum so far; the best end
counts.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import NamedTuple, Protocol

import numpy as np

from clothfit.base import interrupts
from clothfit.base.arrays import Array, Flags
from clothfit.base.errors import InvalidInput
from clothfit.motion.motion import rms
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




MOST_ELEMENTS = 800
"""The most values of a cloth that are fitted one by one: JᵀJ is made of them, and there is more than one descent."""

NUDGES, LEAVING, NUDGED = (0.5, 0.2, 0.05), (0.05, 0.01), 12
"""Parts of the way to the target, those with which a minimum is left, and the most steps of the fit with each."""

FIRST, LEAST, RISE, FALL = 1e-4, 1e-14, 4.0, 0.2
"""μ at the start, its least value, both of the trace of JᵀJ, and what it is multiplied by after a step that fails, or
does as was predicted.
"""

TRIES = 10
"""Values of μ for a step, before the fit ends."""

LONGEST = 1.0
"""Change of a logarithm in a step."""

SMALL_SAVING, PASSING = 2e-3, 1e-2
"""A descent ends where a step lowers the cost by less than this share of it; one that is nudged is only passed."""


class Nudge(NamedTuple):
    """Where a target shows the ends of steps, 0 … T."""

    place: Array  # (T + 1, n, 3), m
    seen: Flags  # (T + 1, n)
    way: Array  # (T + 1, n, 3), m, from the place one step before
    goes: Flags  # (T + 1, n), where that is known


def nudge_of(goal: Target) -> Nudge:
    """The pull of a target."""
    count, n = goal.last_step + 1, goal.positions.shape[1]
    place, way = np.zeros((2, count, n, 3))
    seen, goes = np.zeros((2, count, n), bool)
    exact = np.flatnonzero(goal.fraction < 1e-6)
    place[goal.step[exact]], seen[goal.step[exact]] = goal.positions[exact], goal.observed[exact]
    goes[1:] = seen[1:] & seen[:-1]
    way[1:] = np.where(goes[1:, :, None], place[1:] - place[:-1], 0.0)
    return Nudge(place, seen, way, goes)


class ElementFit(Fit):
    """A fit of a tool that has `sweep`; `begin` (V,) are the values that it begins with."""

    def __init__(self, tool: Tool, goal: Target, report: Callable[[float, int], None] | None, begin: Array) -> None:
        super().__init__(tool, goal, report)
        self.begin = np.clip(np.log(begin), self.lower, self.upper)

    def search(self, most: int) -> None:
        """Levenberg–Marquardt, with at most so many steps of each descent."""
        self.descend(self.begin, most)
        for nudges, y in ((NUDGES, self.begin), (NUDGES, self.start), (LEAVING, None)):
            if y is None:
                y = self.begin if self.best is None else np.log(self.best[1])
            for nudge in nudges:
                y = self.descend(y, min(most, NUDGED), nudge)
            self.descend(y, most)

    def descend(self, y: Array, most: int, nudge: float = 0.0) -> Array:
        """Take steps from y, of motions that are pulled so far; returns the last logarithms."""
        mu, r = FIRST, self.nudged_residuals(y, nudge)
        for _ in range(most):
            steps, cost = self.by_normal_equations(y, r, nudge, mu), float(r @ r)
            for mu, step, predicted in steps:  # noqa: B007  the last one is kept
                other = np.clip(y + step, self.lower, self.upper)
                after = self.nudged_residuals(other, nudge)
                if after @ after < cost:
                    break
            else:
                return y
            gain = (cost - after @ after) / max(cost - predicted, 1e-300)
            mu = max(FALL * mu, LEAST) if gain > 0.75 else RISE * mu if gain < 0.25 else mu
            y, r = other, after
            if after @ after > (1.0 - (PASSING if nudge else SMALL_SAVING)) * cost:
                return y
        return y

    def nudged_residuals(self, y: Array, nudge: float) -> Array:
        """The residuals of a motion with a pull."""
        if not nudge:
            return self.residuals(y)
        found = [rows for rows, _ in self.frames(y, nudge, along=False)]
        apart = np.concatenate(found) if found else np.zeros(0)
        if len(apart) < 3 * int(self.goal.observed.sum()):  # it ran away
            apart = np.full(3 * int(self.goal.observed.sum()), FAR)
        return np.concatenate([self.scale * apart, WEAK * (y - self.start)])

    def frames(self, y: Array, nudge: float, along: bool) -> Iterator[tuple[Array, Array]]:
        """Of each frame of the target, in turn: the distances (3 s,) of the s vertices that it shows, and their change
        (3 s, V) along each logarithm, or (3 s, 0). Ends early where the motion runs away.
        """
        assert self.tool.sweep is not None
        interrupts.check()
        goal, own = self.goal, self.tool.sweep(np.exp(y), along)
        self.simulations += 1
        nudges = nudge_of(goal) if nudge else None
        x, dx, frame = own.x.copy(), own.dx.copy(), 0
        for t in range(goal.last_step + 1):
            while frame < len(goal.step) and goal.step[frame] + (goal.fraction[frame] > 0) == t:
                part, seen = float(goal.fraction[frame]) or 1.0, goal.observed[frame]
                place = (1.0 - part) * x[seen] + part * own.x[seen]
                change = (1.0 - part) * dx[seen] + part * own.dx[seen]
                yield (place - goal.positions[frame, seen]).reshape(-1), change.reshape(3 * int(seen.sum()), -1)
                frame += 1
            if t == goal.last_step or not np.isfinite(own.x).all():
                return
            if nudges is not None and t:  # move the state a part of the way to the target, and its changes with it
                shown, goes = nudges.seen[t] & own.free, nudges.goes[t] & own.free
                own.x[shown] += nudge * (nudges.place[t, shown] - own.x[shown])
                own.v[goes] += nudge * (nudges.way[t, goes] / own.h - own.v[goes])
                own.dx[shown] *= 1.0 - nudge
                own.dv[goes] *= 1.0 - nudge
            x, dx = own.x.copy(), own.dx.copy()
            own.advance(t)

    def by_normal_equations(self, y: Array, r: Array, nudge: float, mu: float) -> Iterator[tuple[float, Array, float]]:
        """Steps with growing μ: μ, the step, and the cost that is predicted after it."""
        from scipy.linalg import cho_factor, cho_solve

        size = len(y)
        square, slope, cost, row = WEAK**2 * np.eye(size), WEAK**2 * (y - self.start), float(r @ r), 0
        for apart, change in self.frames(y, nudge, along=True):
            square += self.scale**2 * (change.T @ change)
            slope += self.scale * (change.T @ r[row : row + len(apart)])
            row += len(apart)
        unit = float(np.trace(square))
        for _ in range(TRIES):
            step = -cho_solve(cho_factor(square + (mu + LEAST) * unit * np.eye(size)), slope)
            step = np.clip(step, -LONGEST, LONGEST)
            yield mu, step, cost + float(2.0 * slope @ step + step @ (square @ step))
            mu = max(RISE * mu, 1e-9)

    @property
    def scale(self) -> float:
        """What a distance counts, 1/m."""
        return float(1.0 / (self.travel * np.sqrt(max(int(self.goal.observed.sum()), 1))))
