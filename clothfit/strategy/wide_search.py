"""A wide search by few values, where a motion in wind forgets where it began.

The cost of such a motion has many minima, and gradients show the nearest one only. Values are drawn around those that
the user gave, far to all sides; from the nearest few of them that differ, and from the best ones that are known, an
evolution strategy each (`optimise.evolution`) draws values around them and learns from the order of their costs where
to draw next. After a while the better half of them goes on, and then the best (successive halving: K. Jamieson,
A. Talwalkar, Non-stochastic best arm identification and hyperparameter optimization, 2016). Its coordinates are those
in which a motion changes evenly:

    log p of masses, stiffnesses, lengths, dampings and drags,    c W of the wind beside a drag c that is fitted,

since it is the push c W that moves a cloth: with c alone c W would change as well. What is drawn far off pushes about
as strongly as the cloth is heavy.

All is counted by what is simulated and not by seconds, so the same fit ends at the same values, however many threads
simulate and whatever else the machine does.

The cheapest of several points, known after the fewest simulated steps.

A sum of squared distances only grows along a motion, so the points run a race: the motion of the one that has cost
least so far goes on, as in a search for the shortest path (E. W. Dijkstra, A note on two problems in connexion with
graphs, 1959). Motions end in the order of their costs, and those that have not ended when enough have cost more.
`TOGETHER` motions go on at a time, so that as many threads can simulate them; which ones does not depend on how many
threads there are, nor on which of them is the faster one.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from functools import cached_property, partial
from heapq import heapify, heappop, heappush
from typing import NamedTuple

import numpy as np

from clothfit.base.arrays import Array
from clothfit.kernels.clock import RATE
from clothfit.kernels.parallel import processors
from clothfit.objective.objective import Growing, Objective
from clothfit.optimise.evolution import Evolution, minimise
from clothfit.optimise.search import Search
from clothfit.scene.cloth import wind_of

TOGETHER = 2
"""Motions that go on at a time."""

Each = Callable[[Callable[[Iterator[Growing]], Growing], Iterable[Iterator[Growing]]], Iterable[Growing]]
"""Calls a function for each of some things, like `map`."""


class Raced(NamedTuple):
    """What a race has found."""

    costs: Array  # (k,), of the points, m²; of one that has not ended a number above those of enough others
    ended: Array  # (k,), whether each cost is known
    steps: int  # that were simulated
    work: int  # of these (`rollout.work_of`)


def race(objective: Objective, points: Sequence[Array], enough: int, limit: float = np.inf, each: Each = map) -> Raced:
    """The costs of points (P,), until `enough` of the cheapest are known, or all others cost more than `limit`, m²."""
    motions = [objective.growing_cost(p) for p in points]
    now = [Growing(0.0, 1, 0, 0)] * len(points)
    running, ended = [(0.0, number) for number in range(len(points))], list[float]()
    heapify(running)
    steps = work = 0
    while running and running[0][0] <= limit and len(ended) < enough:
        ahead = [heappop(running)[1] for _ in range(min(TOGETHER, len(running)))]
        for number, found in zip(ahead, each(next, [motions[number] for number in ahead]), strict=True):
            now[number] = found
            steps, work = steps + found.steps, work + found.work
            if found.ahead:
                heappush(running, (found.cost, number))
        least = running[0][0] if running else np.inf
        ended = sorted(own.cost for own in now if not own.ahead and own.cost <= least)
    bar = min(ended[enough - 1] if len(ended) >= enough else np.inf, limit)
    costs = [own.cost if not own.ahead else bar * (1.0 + own.ahead / max(objective.steps, 1)) for own in now]
    return Raced(np.array(costs), np.array([not own.ahead for own in now]), steps, work)


DRAWN = 10
"""Points that an evolution strategy draws at a time."""

WORK, FEWEST = 2_000_000_000, 150
"""Work (`rollout.work_of`) at most, some 20 s of two threads, and the motions for which it must be enough."""

OVER_BY, LEAST_WORK = 50.0, 500_000_000
"""Seconds after which a fit is to be over, with two threads in its wide search, and the work that it has even so."""

TOLERANCE = 1e-5
"""Of the linear systems of points that are compared; those that are kept are looked at with the fit's own."""

FACTOR, LENGTHS = 1.0, 0.1
"""Standard deviation of logarithms at first, and of those of rest lengths."""

SHARE = 0.3
"""The same of other values, relative to their typical size."""

FLOOR = 1e-6
"""The least value that has a logarithm, relative to what is typical."""

SCANNED, FAR = 200, 1.5
"""Points that are drawn far off, and their standard deviations relative to the first ones of an evolution strategy."""

AT_ONCE = 20
"""Of these that are simulated at once, as each takes memory."""

KNOWN, APART, CLOSE = 12, 2.0, 0.5
"""How many of the nearest ones are looked at; the distance of two that differ, in standard deviations; and those around
the best values that are known, relative to others.
"""

HALVING = ((4, 0.1), (2, 0.12), (1, 1.0))
"""How many evolution strategies go on, and the share of the work that each has then."""

LEFT = 100
"""Evaluations that are left to what comes after."""

MOTIONS = 5.0
"""Whole motions that count as an evaluation: a step of Gauss–Newton simulates as many for few values."""

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
        self.widths, self.blows = widths[search.fitted], np.flatnonzero((names == "wind")[search.fitted])
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


    def around(self, x: Array, share: float = 1.0) -> Array:
        """Standard deviations (Q,) around coordinates (Q,), times a share; those of the wind are as large as it is."""
        widths = self.widths.copy()
        if len(self.blows):
            widths[self.blows] = float(np.linalg.norm(x[self.blows])) or self.lift
        return np.asarray(share * widths)

    def far(self, x: Array, random: np.random.Generator) -> Array:
        """Coordinates (`SCANNED`, Q) far around x (Q,), and x before them; the push of the wind around nothing."""
        drawn = random.standard_normal((SCANNED, len(x)))
        strength = np.exp(random.standard_normal(SCANNED))
        points = x + FAR * self.widths * drawn
        if len(self.blows):
            points[:, self.blows] = self.lift * strength[:, None] * drawn[:, self.blows]
        return np.vstack([x, points])

    @cached_property
    def lift(self) -> float:
        """The coordinate of the wind that carries the weight of the cloths; as large as it is typically where they have
        none.
        """
        scene = self.search.objective.scene
        cloths = [cloth for cloth in scene.cloths if cloth.feels_air]
        weight = float(np.linalg.norm(scene.gravity)) * sum(float(each.mass[~each.fixed].sum()) for each in cloths)
        drag = [self.blown if len(self.drag) else each.drag for each in cloths]
        return wind_of(weight, cloths, drag) / float(self.unit[self.wind[0]]) or 1.0


def is_quick(own: Search) -> bool:
    """Whether the work is enough for a wide search around the best point."""
    return FEWEST * race(loosened(own.objective), [own.best.p], 1).work <= WORK


def loosened(objective: Objective) -> Objective:
    """The objective as points are compared by it."""
    return objective.until(objective.steps + 1, max(TOLERANCE, objective.tolerance))


def threads() -> int:
    """Threads that simulate."""
    return min(processors(), TOGETHER)


def work_left(seconds: float) -> float:
    """The work of a wide search after so many seconds of a fit (`kernels.clock`)."""
    return float(np.clip((OVER_BY - seconds) * TOGETHER * RATE, LEAST_WORK, WORK))


def widely(own: Search, seed: int = 0, work: float = np.inf) -> None:
    """Search far around the start of a search, and around its best point, with some work at most. Raises Stop."""
    work = min(work, WORK)
    wide, random = Wide(own), np.random.default_rng(seed)
    own.enter("evolution")
    with ThreadPoolExecutor(threads()) as pool:
        costs = Costs(wide, loosened(own.objective), pool)
        known, starts = wide.x(own.best.p), distinct(wide, costs, wide.far(wide.x(own.start), random))
        shares = [CLOSE] + [1.0] * len(starts)
        going = [
            begun(wide, x, share, seed + number)
            for number, (x, share) in enumerate(zip([known, *starts], shares, strict=True))
        ]
        for count, share in HALVING:
            going = sorted(going, key=lambda each: each.least)[:count]
            for each in going:
                goal = min(costs.work + share * work, work)
                minimise(costs, each, partial(costs.is_over, goal))
    for each in going:
        for x in (each.best, each.mean):
            own.visit(wide.parameters(x))


def begun(wide: Wide, x: Array, share: float, seed: int) -> Evolution:
    """An evolution strategy around coordinates (Q,), with this share of the usual standard deviations."""
    free = np.full(len(x), np.inf)
    return Evolution(x, wide.around(x, share), (-free, free), DRAWN, seed)


def distinct(wide: Wide, costs: Costs, points: Array) -> list[Array]:
    """The cheapest of points (k, Q) that differ, one for each evolution strategy but that around the best known. Raises
    Stop.
    """
    known = np.zeros(0)
    for first in range(0, len(points), AT_ONCE):
        limit = np.partition(known, KNOWN - 1)[KNOWN - 1] if len(known) >= KNOWN else np.inf
        known = np.append(known, costs(points[first : first + AT_ONCE], KNOWN, float(limit)))
    order = np.argsort(known, kind="stable")[:KNOWN]
    unit, found = wide.around(np.zeros(points.shape[1])), list[Array]()
    for x in points[order]:
        if all(float(np.linalg.norm((x - other) / unit)) > APART for other in found):
            found.append(x)
    return found[: HALVING[0][0] - 1]


class Costs:
    """The costs of points, and what they took."""

    def __init__(self, wide: Wide, objective: Objective, pool: ThreadPoolExecutor) -> None:
        self.wide, self.objective, self.pool = wide, objective, pool
        self.work, self.motions = 0, 0.0  # motions that do not count as an evaluation yet

    def __call__(self, points: Array, enough: int, limit: float) -> Array:
        """The costs (k,) of points (k, Q) as `evolution.Costs` says. Raises Stop."""
        found = race(self.objective, [self.wide.parameters(x) for x in points], enough, limit, self.pool.map)
        self.work += found.work
        self.motions += found.steps / max(sum(run.steps for run in self.objective.runs), 1)
        while self.motions >= MOTIONS:
            self.motions -= MOTIONS
            self.wide.search.count()
        return found.costs

    def is_over(self, until: float) -> bool:
        """Whether so much work is done, or hardly an evaluation is left to what comes after."""
        budget = self.wide.search.budget
        return self.work >= until or len(budget.history) + DRAWN + LEFT > budget.limit
