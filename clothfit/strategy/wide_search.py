"""A wide search by few values, where a motion in wind forgets where it began.

The cost of such a motion has many minima, and gradients show the nearest one only. An evolution strategy
(`optimise.evolution`) draws values around the best ones that are known, a factor e to either side, and learns from the
order of their costs where to draw next. Its coordinates are those in which a motion changes evenly:

    log p of masses, stiffnesses, lengths, dampings and drags,    c W of the wind beside a drag c that is fitted,

since it is the push c W that moves a cloth: with c alone c W would change as well.
"""

from __future__ import annotations

from concurrent.futures import ThreadPoolExecutor
from functools import partial

import numpy as np

from clothfit.base.arrays import Array
from clothfit.kernels.clock import computing
from clothfit.kernels.parallel import processors
from clothfit.objective.objective import Objective
from clothfit.optimise.evolution import TOGETHER, Evolution, minimise
from clothfit.optimise.search import Search

DRAWN = 16
"""Points that are drawn at a time: twice as many as are usual for few values, as the cost is rough."""

LONGEST, FEWEST = 22.0, 300
"""Seconds of computing of each thread, at most, and the simulations for which they must be enough."""

FACTOR, LENGTHS = 1.0, 0.1
"""Standard deviation of logarithms at first, and of those of rest lengths."""

SHARE = 0.3
"""The same of other values, relative to their typical size."""

FLOOR = 1e-6
"""The least value that has a logarithm, relative to what is typical."""

STAGES = ((0.35, 0.2), (0.65, 0.5), (1.0, 1.0))
"""Shares of the frames, and of the time until the next ones: over short times the cost is smoother, and known sooner.
"""

LEFT = 100
"""Evaluations that are left to what comes after."""

POSITIVE = ("damping", "drag")
"""Kinds that are not moved by their logarithm elsewhere, as they may be 0."""


class Wide:
    """The coordinates x (Q,) of the values that a search fits."""

    def __init__(self, search: Search) -> None:
        objective, own = search.objective, search.coordinates
        self.search, self.p = search, search.best.p
        named = [(block.name, block.kind.scale, block.count) for block in objective.blocks]
        names = np.repeat([name for name, _, _ in named], [count for *_, count in named])
        typical = np.maximum(np.abs(self.p), np.repeat([s for _, s, _ in named], [count for *_, count in named]))
        self.log = own.log | np.isin(names, POSITIVE)
        self.least = np.where(own.log, 0.0, FLOOR * typical)
        self.drag = np.flatnonzero((names == "drag") & search.fitted)
        self.wind = np.flatnonzero((names == "wind") & search.fitted)
        push = float(np.linalg.norm(self.p[self.wind])) if len(self.wind) else 0.0
        self.unit = np.where(self.log, 1.0, typical)
        self.unit[self.wind] = max(push, float(typical[self.wind].min(initial=np.inf)))
        widths = np.where(self.log, np.where(names == "rest", LENGTHS, FACTOR), SHARE)
        widths[self.wind] = 1.0
        self.widths = widths[search.fitted]
        self.blown = self.air(self.p)

    def air(self, p: Array) -> float:
        """The drag that is fitted, in the geometric mean of the cloths, at p (P,); 1 without one."""
        return float(np.exp(np.log(np.maximum(p, self.least)[self.drag]).mean())) if len(self.drag) else 1.0

    def x(self, p: Array) -> Array:
        """Coordinates (Q,) of parameters (P,)."""
        plain = np.where(self.log, np.log(np.where(self.log, np.maximum(p, self.least), 1.0)), p / self.unit)
        plain[self.wind] *= self.air(p) / self.blown
        return np.asarray(plain[self.search.fitted])

    def parameters(self, x: Array) -> Array:
        """Parameters (P,) at coordinates (Q,)."""
        whole = np.zeros(len(self.p))
        whole[self.search.fitted] = x
        p = np.where(self.log, np.exp(np.where(self.log, whole, 0.0)), whole * self.unit)
        p[self.wind] *= self.blown / self.air(p)
        return np.where(self.search.fitted, self.search.coordinates.clipped(p), self.p)


def is_quick(own: Search) -> bool:
    """Whether the time is enough for a wide search."""
    return FEWEST * own.each <= LONGEST * threads()


def threads() -> int:
    """Threads that simulate."""
    return min(processors(), TOGETHER)


def widely(own: Search, seed: int = 0) -> None:
    """Search around the best point of a search, over the first frames, more, and all of them. Raises Stop."""
    wide, whole, count, began = Wide(own), own.objective, threads(), computing()
    used, allowed = len(own.budget.history), own.budget.limit - len(own.budget.history) - LEFT
    free = np.full(len(wide.widths), np.inf)
    evolution = Evolution(wide.x(own.best.p), wide.widths, (-free, free), DRAWN, seed)
    with ThreadPoolExecutor(count) as pool:
        for frames, share in STAGES:
            steps = int(frames * whole.steps)
            part = whole if steps == whole.steps else whole.until(steps + 1, whole.tolerance)
            own.enter("evolution", part)
            is_over = partial(is_spent, own, began + share * LONGEST * count, used + share * allowed)
            found = minimise(Costs(own, wide, part, pool if count > 1 else None), evolution, is_over)[0]
            for x in (found, evolution.mean):
                own.visit(wide.parameters(x))


def is_spent(own: Search, until: float, evaluations: float) -> bool:
    """Whether the time is over, in seconds of computing, or the search has had so many evaluations."""
    return computing() >= until or len(own.budget.history) + DRAWN > evaluations


class Costs:
    """The costs of points over the frames of an objective; those over all frames may be the best of a search."""

    def __init__(self, own: Search, wide: Wide, part: Objective, pool: ThreadPoolExecutor | None) -> None:
        self.own, self.wide, self.part, self.pool = own, wide, part, pool

    def __call__(self, points: Array, limit: float) -> Array:
        """The costs (k,) of points (k, Q), those above a limit by numbers above it. Raises Stop."""
        given = [self.wide.parameters(x) for x in points]
        within = partial(self.part.cost_within, limit=limit)
        found = list(self.pool.map(within, given) if self.pool else map(within, given))
        for p, cost in zip(given, found, strict=True):
            self.own.count()
            if self.part is self.own.objective:
                self.own.accept(p, cost)
        return np.array(found)
