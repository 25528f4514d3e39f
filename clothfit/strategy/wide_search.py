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
from clothfit.engine.solve.two_threads import processors
from clothfit.kernels.clock import computing
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

FARTHER = 4.0
"""Times the best cost that is known, above which motions of the first points end."""

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
    """Search around the best point of a search. Raises Stop."""
    wide = Wide(own)
    own.enter("evolution")
    ends = np.full(len(wide.widths), np.inf)
    evolution = Evolution(wide.x(own.best.p), wide.widths, (-ends, ends), DRAWN, seed)
    began, budget, count = computing(), own.budget, threads()

    def is_over() -> bool:
        return computing() - began > LONGEST * count or len(budget.history) + DRAWN + LEFT > budget.limit

    with ThreadPoolExecutor(count) as pool:

        def costs(points: Array, limit: float) -> Array:
            given = [wide.parameters(x) for x in points]
            within = partial(own.objective.cost_within, limit=limit)
            found = list(pool.map(within, given) if count > 1 else map(within, given))
            for p, cost in zip(given, found, strict=True):
                own.count()
                own.accept(p, cost)
            return np.array(found)

        minimise(costs, evolution, is_over, FARTHER * own.best.cost)
