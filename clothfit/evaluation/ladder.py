"""The cost on both sides of a point along a direction: where it is smooth, and whether the gradient describes it there.

The cost G(p ± t d), for t from 1e-7 up to 1e-1, has an even and an odd part,

    S(t) = G(p + t d) + G(p − t d) − 2 G(p),      D(t) = [G(p + t d) − G(p − t d)] / 2t.

S does not depend on the gradient g: it falls as t² where the cost is smooth on that scale, as t across a kink, and not
at all across a jump. A contact that switches makes both; over long steps of a chaotic motion S follows no power. So g
is judged only by steps that are short enough: those with the contacts of p on both sides, over which S falls as t².
There

    Taylor        S/2 + t |D − g·d| must fall as t² as well,
    difference    D must be g·d.

A test is unclear, neither passed nor failed, where rounding leaves too few steps.

A step is smooth in its state and its parameters except where contacts switch (`switches`). Two motions with the same
contacts wherever forces are evaluated lie on one smooth piece of the cost.
"""

from __future__ import annotations

from itertools import pairwise
from typing import NamedTuple

import numpy as np

from clothfit.base.arrays import Array
from clothfit.derivative.verify import ABOVE_NOISE, DIFFERENCE, FEWEST_RUNGS, NOISE_STEPS, ORDER
from clothfit.engine.tape import Tape
from clothfit.evaluation.switches import Parts, contacts, first_switch, name_of
from clothfit.motion.divergence import Diverged
from clothfit.objective.objective import Objective
from clothfit.objective.run import Run, check
from clothfit.objective.running_cost import running_cost

RELATIVE_STEPS = tuple(10.0 ** (-k / 2) for k in range(14, 1, -1))
"""Steps, relative to p, from short to long; half as far apart as in `verify`, as kinks may leave few usable ones."""

ORDER_SLACK = 0.1
"""The order at which S falls may differ from 2 by this much, due to rounding at `ABOVE_NOISE`."""

BEYOND_ROUNDING = 10.0
"""A difference this many times larger than the rounding is not due to rounding."""

SMALLEST_FLOAT = float(np.finfo(float).tiny)

PASSED, FAILED, UNCLEAR = "passed", "failed", "unclear"


class Finding(NamedTuple):
    """The outcome of one test."""

    name: str  # "Taylor", "difference" or "dot product"
    measured: float | None  # the order, or a relative error; None where rounding left nothing to measure
    bar: float  # that it must be above (Taylor) or below
    verdict: str  # "passed", "failed" or "unclear"
    why: str = ""  # it is unclear


class Known(NamedTuple):
    """A number and its uncertainty by rounding."""

    value: float
    blur: float


class Rung(NamedTuple):
    """The cost on both sides of p, at a distance t."""

    t: float
    even: float  # S
    odd: float  # t D
    switch: str  # the first contact that differs from p, as text; empty: none


def look(objective: Objective, p: Array) -> tuple[float, list[Parts]]:
    """G(p), m², and the contacts of each run. Raises Diverged."""
    total, switches = 0.0, []
    for run in objective.runs:
        system, cost, seen = run.changed(p), running_cost(run.comparison), []
        tape = Tape(system, run.steps, objective.tolerance)
        for part in tape.forward():
            cost.update(part)
            seen.append(contacts(system, part))
        check(run, tape.good)
        total += cost.value
        switches.append(np.concatenate(seen))
    return total, switches


def ladder(objective: Objective, p: Array, d: Array, least: float) -> tuple[list[Rung], float]:
    """All rungs, from short to long steps, and the rounding error of the cost, m², at the `least` so much."""
    start, own = look(objective, p)

    def rung(t: float) -> Rung:
        costs, switch = [], ""
        for sign in (1.0, -1.0):
            try:
                cost, switches = look(objective, p + sign * t * d)
            except Diverged as error:
                return Rung(t, np.inf, np.inf, str(error))
            costs.append(cost)
            switch = switch or difference_of(objective.runs, own, switches)
        return Rung(t, costs[0] + costs[1] - 2.0 * start, 0.5 * (costs[0] - costs[1]), switch)

    noise = max(least, np.finfo(float).eps * abs(start), *(abs(rung(t).even) for t in NOISE_STEPS))
    return [rung(t) for t in RELATIVE_STEPS], float(noise)


def difference_of(runs: tuple[Run, ...], a: list[Parts], b: list[Parts]) -> str:
    """Where the contacts of the runs first differ, as text; empty where they do not."""
    for run, one, other in zip(runs, a, b, strict=True):
        found = first_switch(one, other)
        if found is not None:
            return f"contacts switch (objects[{run.cloth}] {found.at(name_of(run.scene, found.obstacle))})"
    return ""


def calm(rungs: list[Rung], noise: float) -> list[Rung]:
    """The rungs, from the shortest, before a contact switches or S, above rounding, does not fall as t²."""
    floor = max(ABOVE_NOISE * noise, SMALLEST_FLOAT)
    found: list[Rung] = []
    for rung in rungs:
        if rung.switch or not np.isfinite(rung.even):
            break
        if found and abs(rung.even) > floor:
            before = abs(found[-1].even)
            order = np.log(abs(rung.even) / max(before, floor)) / np.log(rung.t / found[-1].t)
            if order > 2.0 + ORDER_SLACK or (before > floor and order < 2.0 - ORDER_SLACK):
                break
        found.append(rung)
    return found


def taylor(rungs: list[Rung], derivative: Known, noise: float) -> Finding:
    """Measure the lowest order at which the remainder of the first-order expansion falls."""
    known = []
    for rung in rungs:
        remainder = 0.5 * abs(rung.even) + abs(rung.odd - rung.t * derivative.value)
        if remainder > ABOVE_NOISE * (noise + rung.t * derivative.blur):
            known.append((rung.t, remainder))
    if len(known) < FEWEST_RUNGS:
        usable = f"{len(known)} of {len(RELATIVE_STEPS)} steps"
        why = f"{usable} are short enough and above rounding, {FEWEST_RUNGS} are needed"
        return Finding("Taylor", None, ORDER, UNCLEAR, why)
    order = min(float(np.log(s / r) / np.log(u / t)) for (t, r), (u, s) in pairwise(known))
    return Finding("Taylor", order, ORDER, PASSED if order > ORDER else FAILED)


def difference(rungs: list[Rung], derivative: Known, noise: float) -> Finding:
    """Measure the relative difference between the derivative and D, at the step where D is most accurate."""
    known = []
    for shorter, longer in pairwise(rungs):
        D = longer.odd / longer.t
        size = max(abs(D), abs(derivative.value), SMALLEST_FLOAT)
        blur = noise / longer.t + abs(D - shorter.odd / shorter.t) + derivative.blur
        known.append((blur / size, abs(D - derivative.value) / size))
    if not known:
        return Finding("difference", None, DIFFERENCE, UNCLEAR, "no two steps are short enough")
    if derivative.value == 0.0 and not any(rung.odd for rung in rungs):
        return Finding("difference", None, DIFFERENCE, UNCLEAR, "nothing that is checked changes the cost")
    return judged("difference", *min(known), DIFFERENCE)


def judged(name: str, blur: float, measured: float, bar: float) -> Finding:
    """Judge a relative difference with uncertainty `blur`; NaN where that overflows."""
    blur = np.inf if np.isnan(blur) else blur
    if measured < bar and blur < BEYOND_ROUNDING * DIFFERENCE:
        return Finding(name, measured, bar, PASSED)
    if measured > max(bar, BEYOND_ROUNDING * blur):
        return Finding(name, measured, bar, FAILED)
    return Finding(name, measured, bar, UNCLEAR, f"known to {blur:.1g} only")
