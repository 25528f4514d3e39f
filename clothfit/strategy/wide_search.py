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
from clothfit.kernels.parallel import processors
from clothfit.objective.objective import Objective
from clothfit.objective.race import TOGETHER, Raced, race
from clothfit.optimise.evolution import Evolution, minimise
from clothfit.optimise.search import Search

DRAWN = 16
"""Points that are drawn at a time: twice as many as are usual for few values, as the cost is rough."""

WORK, FEWEST = 2_000_000_000, 300
"""Work (`rollout.work_of`) at most, some 20 s of two threads, and the motions for which it must be enough."""

TOLERANCE = 1e-5
"""Of the linear systems of points that are compared; those that are kept are looked at with the fit's own."""

FACTOR, LENGTHS = 1.0, 0.1
"""Standard deviation of logarithms at first, and of those of rest lengths."""

SHARE = 0.3
"""The same of other values, relative to their typical size."""

FLOOR = 1e-6
"""The least value that has a logarithm, relative to what is typical."""

STAGES = ((0.35, 0.2, 0.3), (0.65, 0.5, 0.3), (1.0, 1.0, 1e-3))
"""Shares of the frames; of the work until the next ones; and standard deviations, relative to the first ones, at which
these come sooner. Over short times the cost is smoother, and known sooner, but its minimum is not that of all frames.
"""

NEARLY = 0.9
"""Share of the work after which there is no other round."""

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
    """Whether the work is enough for a wide search around the best point."""
    return FEWEST * race(own.objective, [own.best.p], 1).work <= WORK


def threads() -> int:
    """Threads that simulate."""
    return min(processors(), TOGETHER)


def widely(own: Search, seed: int = 0) -> None:
    """Search around the best point of a search, over the first frames, more, and all of them, and where that comes to
    a minimum before the work is done, around the best point anew. Raises Stop.
    """
    work = Work(own)
    with ThreadPoolExecutor(threads()) as pool:
        while not work.is_over(NEARLY * WORK):
            one_round(own, work, pool, seed)
            seed += 1


def one_round(own: Search, work: Work, pool: ThreadPoolExecutor, seed: int) -> None:
    """The stages, with the work that is left. Raises Stop."""
    wide, whole, begun = Wide(own), own.objective, work.done
    free = np.full(len(wide.widths), np.inf)
    evolution = Evolution(wide.x(own.best.p), wide.widths, (-free, free), DRAWN, seed)
    for frames, share, narrow in STAGES:
        part = whole.until(int(frames * whole.steps) + 1, max(TOLERANCE, whole.tolerance))
        own.enter("evolution", part)
        costs = Costs(wide, part, pool, work)
        best, _ = minimise(costs, evolution, partial(work.is_over, begun + share * (WORK - begun)), narrow)
        for x in (best, evolution.mean):
            own.visit(wide.parameters(x))


class Work:
    """The work that is done, and the evaluations that it counts as: whole motions, and parts of one."""

    def __init__(self, own: Search) -> None:
        self.own, self.done, self.motions = own, 0, 0.0

    def add(self, race: Raced) -> None:
        """Count that of a race. Raises Stop when the budget of the search is used up."""
        self.done += race.work
        self.motions += race.steps / max(sum(run.steps for run in self.own.objective.runs), 1)
        while self.motions >= 1.0:
            self.motions -= 1.0
            self.own.count()

    def is_over(self, until: float) -> bool:
        """Whether so much is done, or hardly an evaluation is left to what comes after."""
        budget = self.own.budget
        return self.done >= until or len(budget.history) + DRAWN + LEFT > budget.limit


class Costs:
    """The costs of points over the frames of an objective."""

    def __init__(self, wide: Wide, part: Objective, pool: ThreadPoolExecutor, work: Work) -> None:
        self.wide, self.part, self.pool, self.work = wide, part, pool, work

    def __call__(self, points: Array, enough: int, limit: float) -> Array:
        """The costs (k,) of points (k, Q) as `evolution.Costs` says. Raises Stop."""
        found = race(self.part, [self.wide.parameters(x) for x in points], enough, limit, self.pool.map)
        self.work.add(found)
        return found.costs
