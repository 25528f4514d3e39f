"""The descent of a model of few values over all frames, where the target is not what it can reproduce.

Gauss–Newton first: near a motion that the model almost reproduces it comes to the minimum in few simulations. Where its
steps end early, L-BFGS in its metric goes on (`preconditioned`). A motion jumps where the guard shortens a step or a
contact comes late, and its cost has steps at which both end; so points around the best one are polled at last, along
the axes of the metric H = V Λ Vᵀ,

    y = y₀ ± r √(c₀/λᵢ) vᵢ,    at which a smooth cost c would rise from c₀ to (1 + r²) c₀,

and the descent goes on from one that costs clearly less. T. G. Kolda, R. M. Lewis, V. Torczon, Optimization by direct
search, 2003.
"""

from __future__ import annotations

import contextlib
from dataclasses import replace

import numpy as np

from clothfit.motion.divergence import Diverged
from clothfit.optimise import gauss_newton, preconditioned
from clothfit.optimise.gauss_newton import Patience
from clothfit.optimise.prior import none
from clothfit.optimise.search import Search
from clothfit.optimise.status import Status
from clothfit.optimise.trajectory import Trajectory

FEW_VALUES = preconditioned.FEW
"""Values up to which a step of Gauss–Newton costs no more than a few gradients."""

FEW_OVER_TIME = 128
"""The same where the others are values over time, of which most do not change the beginning."""

STEPS, STEPS_OVER_TIME = 4, 12
"""Steps of Gauss–Newton over all frames; by values over time each of them saves more than a round of L-BFGS."""

PATIENCE = Patience(1, 1e-3, 1e-3)
"""A step of it that saves less than this fraction of the cost is the last."""

RADIUS, POLLS = 0.3, 3
"""r of the points that are polled, where a smooth cost is a tenth higher, and how often that is done."""

PAYS = 0.01
"""Share of the cost that a point must save for another descent."""


def in_a_round(own: Search) -> None:
    """A short descent, enough for a comparison. Raises Stop."""
    if not settled(own):
        preconditioned.one_round(own)


def to_the_minimum(own: Search) -> None:
    """The descent to the minimum near the best point of a search. Raises Stop."""
    if not is_for_few(own):
        preconditioned.minimise(own)
        return
    before = np.inf
    while own.best.cost < (1.0 - PAYS) * before and not settled(own):
        before = own.best.cost
        in_metric(own)


def in_metric(own: Search) -> None:
    """A round of L-BFGS in the metric of the best point. Raises Stop."""
    root = preconditioned.metric(preconditioned.for_metric(own), own.y)
    if root is None:
        preconditioned.minimise(own)
        return
    own.budget.enter_stage()  # a round has its own end
    if preconditioned.descend(own, root, preconditioned.Patience(own.progress.clock), settled=preconditioned.SETTLED):
        own.settled = own.best.p


def beyond_steps(own: Search) -> None:
    """The same, and on from points around it that cost less. Raises Stop."""
    to_the_minimum(own)
    for _ in range(POLLS):
        if not polled(own):
            break
        to_the_minimum(own)


def settled(own: Search) -> bool:
    """Whether a few steps of Gauss–Newton come to the minimum, which they do only where few values are fitted. Raises
    Stop.
    """
    whole, part = Trajectory(own, own.objective), preconditioned.for_metric(own)
    if not (is_for_few(own) and part.fits()):
        return False
    problem = replace(whole.problem(preconditioned.SETTLED, PATIENCE), model=part.model, widths=part.widths)
    status, steps = Status.STALLED, STEPS_OVER_TIME if over_time(own) else STEPS
    with contextlib.suppress(Diverged), np.errstate(over="ignore", invalid="ignore"):
        status = gauss_newton.minimise(problem, own.y, none(part.size), iterations=steps)[2]
    if status == Status.CONVERGED:
        own.settled = own.best.p
    return own.is_settled


def polled(own: Search) -> bool:
    """Whether a point around the best one costs clearly less; it is the best one then. Raises Stop."""
    part, before = preconditioned.for_metric(own), own.best.cost
    needed = own.each * 2 * len(own.y)
    root = preconditioned.metric(part, own.y) if is_for_few(own) and own.has_time(needed) else None
    if root is None:
        return False
    values, axes = np.linalg.eigh(root @ root.T)
    y, (lower, upper) = own.y, np.array(own.bounds).T
    for value, axis in zip(values, axes.T, strict=True):
        for side in (RADIUS, -RADIUS):
            own.visit(own.parameters(np.clip(y + side / np.sqrt(value) * axis, lower, upper)))
    return bool(own.best.cost < (1.0 - PAYS) * before)


def is_for_few(own: Search) -> bool:
    """Whether a search is of few values, has a point, and has time."""
    others = int(own.fitted.sum()) - over_time(own)
    few = others <= FEW_VALUES and over_time(own) <= FEW_OVER_TIME
    return bool(few and np.isfinite(own.best.cost) and not own.is_late)


def over_time(own: Search) -> int:
    """How many values of a search are those of keys."""
    return sum(int(own.fitted[block.part].sum()) for block in own.objective.blocks if block.name == "gusts")
