"""The cheapest of several points, known after the fewest simulated steps.

A sum of squared distances only grows along a motion, so the points run a race: the motion of the one that has cost
least so far goes on, as in a search for the shortest path (E. W. Dijkstra, A note on two problems in connexion with
graphs, 1959). Motions end in the order of their costs, and those that have not ended when enough have cost more.
`TOGETHER` motions go on at a time, so that as many threads can simulate them; which ones does not depend on how many
threads there are, nor on which of them is the faster one.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Sequence
from heapq import heapify, heappop, heappush
from typing import NamedTuple

import numpy as np

from clothfit.base.arrays import Array
from clothfit.objective.objective import Growing, Objective

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
