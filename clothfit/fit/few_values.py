"""The descent of a model of few values over all frames, where the target is not what it can reproduce.

Gauss–Newton first: near a motion that the model almost reproduces it comes to the minimum in few simulations. Where its
steps end early, L-BFGS in its metric goes on (`preconditioned`). Before that: windows of the first frames, which show
gravity and other values that all frames hide behind what a late frame is off by. Contacts that switch bar the way
there: points around the end of a window are polled, and the descent goes on from one that costs clearly less
(T. G. Kolda, R. M. Lewis, V. Torczon, Optimization by direct search, 2003).

Motions in which rounding decides: a cloth that buckles, or hops on what it touches, from some step on.

Two motions with the same values whose starts differ by as much as the numbers of files are rounded grow apart. Where
they end about as far from each other as from the target, and values reproduce all of it before, no values can bring the
rest nearer, and a search there follows chance: those of the first steps are kept.
"""

from __future__ import annotations

import contextlib
from collections.abc import Sequence
from contextlib import suppress
from dataclasses import replace

import numpy as np

from clothfit.base.arrays import Array
from clothfit.fit import continuation
from clothfit.fit.trajectory_fit import (
    FIRST_WINDOW,
    MOSTLY,
    NEAR_ERROR,
    WINDOW_GROWTH,
    is_long,
    loosened,
    window_lengths,
)
from clothfit.motion.divergence import Diverged
from clothfit.motion.motion import rms
from clothfit.motion.simulate import simulate
from clothfit.objective.objective import Objective
from clothfit.objective.whiteness import residual_test
from clothfit.optimise import gauss_newton, preconditioned
from clothfit.optimise.gauss_newton import Patience
from clothfit.optimise.prior import none
from clothfit.optimise.search import Search
from clothfit.optimise.status import Status
from clothfit.optimise.trajectory import Trajectory
from clothfit.scene.fit_vector import with_parameters
from clothfit.scene.scene import Scene

FEW_VALUES = preconditioned.FEW_VALUES
"""Values up to which a step of Gauss–Newton costs no more than a few gradients."""

FEW_KEYED = 128
"""The same where the others are values over time, of which most do not change the beginning."""

STEPS, STEPS_KEYED = 4, 12
"""Steps of Gauss–Newton over all frames; by values over time each of them saves more than a round of L-BFGS."""

PATIENCE = Patience(1, 1e-3, 1e-3)
"""A step of it that saves less than this fraction of the cost is the last."""

POLL_STEPS = 3
"""How often points around the end of a window are polled."""

PAYS = 0.01
"""Share of the cost that a point must save for another descent."""


def in_a_round(own: Search) -> None:
    """A short descent, enough for a comparison. Raises Stop."""
    if not minimised(own):
        preconditioned.one_round(own, preconditioned.metric(preconditioned.for_metric(own), own.y))


def to_the_minimum(own: Search) -> None:
    """The descent to the minimum near the best point of a search. Raises Stop."""
    if not is_for_few(own):
        preconditioned.minimise(own)
        return
    before = np.inf
    while own.best.cost < (1.0 - PAYS) * before and not minimised(own):
        before, root = own.best.cost, preconditioned.metric(preconditioned.for_metric(own), own.y)
        if root is None:
            preconditioned.minimise(own)
        else:
            preconditioned.one_round(own, root, preconditioned.ROUND)


def minimised(own: Search) -> bool:
    """Whether a few steps of Gauss–Newton come to the minimum, which they do only where few values are fitted. Raises
    Stop.
    """
    whole, part = Trajectory(own, own.objective), preconditioned.for_metric(own)
    if not (is_for_few(own) and part.fits()):
        return False
    problem = replace(whole.problem(preconditioned.STATIONARY, PATIENCE), model=part.model, widths=part.widths)
    status, steps = Status.STALLED, STEPS_KEYED if keyed_values(own) else STEPS
    with contextlib.suppress(Diverged), np.errstate(over="ignore", invalid="ignore"):
        status = gauss_newton.minimise(problem, own.y, none(part.size), iterations=steps)[2]
    if status == Status.CONVERGED:
        own.stationary = own.best.p
    return own.is_stationary


def is_for_few(own: Search) -> bool:
    """Whether a search is of few values, has a point, and has time."""
    others = int(own.fitted.sum()) - keyed_values(own)
    few = others <= FEW_VALUES and keyed_values(own) <= FEW_KEYED
    return bool(few and np.isfinite(own.best.cost) and not own.is_late)


def keyed_values(own: Search) -> int:
    """How many values of a search are those of keys."""
    return sum(int(own.fitted[block.part].sum()) for block in own.objective.blocks if block.name == "gusts")


FIRST_STEPS, LATER_STEPS = 8, 4
"""Steps of Gauss–Newton in the first window and in each later one, which goes on from near its minimum; half as many of
a long fit.
"""

WINDOW_SAVING, HASTY = 0.05, Patience(1, 0.05, 0.05)
"""Relative savings that end a window."""

CONTACT_GROWTH, CONTACT_SAVING, CONTACT_PATIENCE = 1.3, 1e-4, Patience(1, 1e-4, 1e-4)
"""The ratio of one window to the one before, and the savings that end one, where a cloth may touch colliders or windows
are close: each contact that switches narrows the valley of the minimum. A window must end within that of the next one,
and the noise of a target hides much of what it shows.
"""

RADII, CLOSE = (1.0, 0.3, 0.1), 2e-4
"""r of the points around the end of a window that are polled there, and the error relative to how far the target moves
below which nothing bars the way.
"""


LOUDER = 1.1
"""Times the noise of the first frames that all frames leave at most: of 300 numbers it scatters by 4 %."""


def through_windows(
    own: Search, windows: slice = slice(None), reproduced: list[tuple[Objective, Array]] | None = None
) -> Array:
    """A few steps of Gauss–Newton on the first frames, on more and more, or on some of these windows: they show gravity
    and other values that all frames hide behind what a late frame is off by. None is begun that cannot end in time, as
    it takes as long for each frame as the one before.

    With a list of what is `reproduced` windows grow slowly, and each is fitted nearly to the minimum; those that are
    reproduced but for noise go there, with the values (P,) that do so, and one of which most is left ends it. Returns
    the last values (P,).
    """
    close = reproduced is not None
    y, pace = own.y, 0.0
    for number, window in list(enumerate(windows_of(own.objective, close)))[windows]:
        part, began = Trajectory(own, window), own.progress.computing
        own.enter("windows", window)
        if own.is_late or not own.has_time(pace * window.steps) or not np.isfinite(part.cost(y)):
            break
        thorough = close or may_touch(window)
        most = FIRST_STEPS if thorough or not number else LATER_STEPS
        y = some_steps(part, y, most // (2 if is_long(own) else 1), thorough)
        noise = min((each.rmse(each.cost(p)) for each, p in reproduced or ()), default=np.inf)
        if not is_long(own) and (may_touch(window) or (close and unexplained(window, own.parameters(y), noise))):
            y = beyond_switches(part, y, most, close)
        pace = (own.progress.computing - began) / window.steps
        own.visit(own.parameters(y))
        left = unexplained(window, own.parameters(y), noise) if close else 0.0
        if left > MOSTLY:
            break
        if reproduced is not None and not left:
            reproduced.append((window, own.parameters(y)))
    return own.parameters(y)


def unexplained(objective: Objective, p: Array, noise: float = np.inf) -> float:
    """The share of the squares at p (P,) that is no noise; 0 where all may be, or hardly anything is left. What is left
    beyond a `noise` that is known, m, is none: of some dozen frames a test says little. Raises Diverged.
    """
    cost = objective.cost_or_infinity(p)
    test = None if cost <= NEAR_ERROR**2 * objective.cost_at_rest else residual_test(objective, p)
    if test is None:
        return 0.0
    error = objective.rmse(cost)
    return max(0.0 if test.is_noise else test.structured, 1.0 - (noise / error) ** 2 if error > LOUDER * noise else 0.0)


def some_steps(part: Trajectory, y: Array, most: int, thorough: bool = True) -> Array:
    """Where some steps of Gauss–Newton on a window lead from y (Q,): nearly to the minimum where they are `thorough`.
    Raises Diverged.

    They may change a value by a factor e at first: in a ball of coordinates, by which a factor on a whole cloth counts
    as often as that has springs, it would hardly change, and a step that saves so little is the last.
    """
    ends = (CONTACT_SAVING, CONTACT_PATIENCE) if thorough else (WINDOW_SAVING, HASTY)
    return continuation.some_steps(part, y, most, *ends, widths=part.own_widths)


def beyond_switches(part: Trajectory, y: Array, most: int, wide: bool = False) -> Array:
    """Where steps of Gauss–Newton lead from points around y (Q,) that cost clearly less, where contacts that switch bar
    its way: along the axes of M = V diag(μ) Vᵀ = H / c + 1 / w², y ± r vᵢ / √μᵢ, with the cost c and the widths w; a
    `wide` look is along those of 1 / w² as well: where a cloth buckles another way, H says nothing of what is near.
    """
    flat = np.diag(1.0 / part.own_widths**2)
    for _ in range(POLL_STEPS):
        if part.cost(y) <= CLOSE**2 * part.objective.cost_at_rest or part.search.is_late:
            break
        model = part.model(y)
        metrics = [np.nan_to_num(model.H / model.cost, posinf=1e100, neginf=-1e100) + flat, *([flat] if wide else [])]
        found, least = map(np.linalg.eigh, metrics), flat.diagonal().min()  # of all, but for rounding
        steps = np.concatenate([(axes / np.sqrt(np.maximum(values, least))).T for values, axes in found])
        around = [np.clip(y + r * side * step, *part.bounds) for r in RADII for step in steps for side in (1.0, -1.0)]
        costs = [part.cost(each) for each in around]
        best = int(np.argmin(costs))
        if not costs[best] < (1.0 - PAYS) * model.cost:
            break
        y = some_steps(part, around[best], most)
    return y


def windows_of(objective: Objective, close: bool = False) -> list[Objective]:
    """The objective over the first frames, over more and more, all of them left out; `close` windows begin with fewer,
    and grow as slowly as those of cloths that may touch something.
    """
    touches, frames = may_touch(objective), FIRST_WINDOW // (2 if close else 1)
    growth = CONTACT_GROWTH if close or touches else WINDOW_GROWTH
    first = objective.first_step + frames * frame_steps(objective)
    lengths = window_lengths(first, objective.steps + 1, growth)[:-1]
    return [objective.until(end, objective.tolerance) if touches else loosened(objective, end) for end in lengths]


def may_touch(objective: Objective) -> bool:
    """Whether a cloth may touch something."""
    return objective.scene.obstacles > 0 or objective.scene.self_contact is not None


def frame_steps(objective: Objective) -> int:
    """Steps from one compared frame to the next, in the median."""
    gaps = [np.diff(run.comparison.goal.step) for run in objective.runs]
    steps = np.concatenate([np.zeros(0, int), *gaps])
    return max(int(np.median(steps)), 1) if len(steps) else 1


TEXT = (
    "then rounding decides: starts that differ by as much as numbers in files grow as far apart as this motion and the "
    "target are, so these values are those of the first steps"
)

ROUNDING = 1e-7
"""Change of the start relative to the size of the cloth: that of single precision."""

EXACT = 1e-4
"""Error relative to how far the target moves, up to which the first steps are reproduced."""

SHARE, SPAN = 0.2, 0.2
"""Share of the error that the twins must be apart, and of all steps that must be reproduced."""


def steps_before_chaos(objective: Objective, exact: Sequence[tuple[Objective, Array]]) -> int:
    """The steps that are reproduced before rounding decides, from windows with the values (P,) that do so; 0 where it
    does not decide, or they are too few.
    """
    good = [(window, p) for window, p in exact if window.cost_or_infinity(p) <= EXACT**2 * window.cost_at_rest]
    if not good or len(good) < len(exact) or len(objective.experiments) > 1:
        return 0
    window, p = good[-1]
    if window.steps < SPAN * objective.steps:
        return 0
    with suppress(Diverged):
        scene = with_parameters(objective.experiments[0].scene, p)
        apart = twins(scene, objective.steps + 1)
        if apart >= SHARE * objective.rmse(objective.cost_or_infinity(p)):
            return int(window.steps)
    return 0


def twins(scene: Scene, frames: int) -> float:
    """How far two motions of a scene are apart whose starts differ by rounding, m (RMS)."""
    random = np.random.default_rng(0)
    cloths = []
    for cloth in scene.cloths:
        size = float(np.linalg.norm(np.ptp(cloth.positions, axis=0)))
        noise = ROUNDING * size * random.uniform(-1.0, 1.0, cloth.positions.shape)
        cloths.append(replace(cloth, positions=cloth.positions + np.where(cloth.fixed[:, None], 0.0, noise)))
    one, other = (simulate(each, frames).positions for each in (scene, replace(scene, cloths=tuple(cloths))))
    return rms(one - other)
