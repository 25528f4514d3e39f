"""The time step of a fit: how many steps to a frame of the target, and by which integrator.

A step as long as a frame damps more than most targets do, and no values make up for that. With K steps to a frame the
motion is off by the model's own error and by what the step adds to it, for the second-order step c / K²:

    RMSE² ≈ e² + (c / K²)²

so fits with K and K/2 predict what K doubled would gain. Each K is fitted by the coarsest model of the scene
(`ladder`), first its own step, then K = 1, 2, 4 … by BDF2, from the values of the best before; it ends where finer
steps gain, or promise, too little.
"""

from __future__ import annotations

import contextlib
import time
from collections.abc import Sequence
from dataclasses import dataclass
from math import ceil
from typing import NamedTuple

import numpy as np

from clothfit.base import interrupts, threads
from clothfit.base.arrays import Array
from clothfit.engine.system import BDF2
from clothfit.motion.divergence import Diverged
from clothfit.motion.times import frame_places
from clothfit.objective.experiment import Experiment
from clothfit.objective.objective import Objective
from clothfit.objective.residual_tests import residual_test
from clothfit.optimise import momentum
from clothfit.optimise.search import Search
from clothfit.optimise.status import Stop
from clothfit.scene.kinds import INTEGRATORS
from clothfit.scene.scene import Scene
from clothfit.strategy import ladder
from clothfit.strategy.trajectory_fit import is_near

PAYS = 0.05
"""Relative reduction of the error that is worth twice the steps."""

COUNTS = (1, 2, 4, 8, 16, 32)
"""Steps to a frame that are tried one after the other, while they pay."""

ROUNDING = 1e-6
"""Steps by which a whole number of them may be off by rounding."""

LOOK, MOMENT = 4, 4.0
"""Steps to a frame with which a look at finer steps is taken, and the seconds that it may take."""

SEARCH_EVALUATIONS = 1000


@dataclass(frozen=True)
class Step:
    """A time step that was tried."""

    substeps: int  # K, steps to a frame of the target
    integrator: str  # its name
    rmse: float  # m, of the coarsest model
    seconds: float


class Stepped(NamedTuple):
    """An objective with the step of its fit, and what its choice has found."""

    objective: Objective
    substeps: int  # K of BDF2; 0: the scene's own step
    p: Array  # (P,), the best values of the coarsest model
    cost: float  # there
    tried: tuple[Step, ...]
    evaluations: int
    explained: bool  # whether the motion is the target's but for noise


def frame_interval(given: Experiment) -> float:
    """Time between two frames of a target, s, in the median: steps of its scene, without the rounding of a whole number
    of them.
    """
    times, delta = given.motion.times, given.scene.delta
    steps = float(np.median(np.diff(times))) / delta if len(times) > 1 else 1.0
    whole = max(round(steps), 1)
    return delta * (whole if abs(steps - whole) < ROUNDING else steps)


def substeps_of(given: Experiment) -> float:
    """How many steps of its scene a frame of a target has."""
    return frame_interval(given) / given.scene.delta


def with_substeps(objective: Objective, count: int, method: int | None) -> Objective:
    """The objective with so many steps to a frame, each of its own target; `method` None: as they are. The scene's own
    step is that for the first target. The same frames are compared.
    """
    scene, given = objective.scene, objective.experiments
    last = max((last_time(each) for each in given if each.scene is scene), default=0.0)
    main = with_interval(scene, frame_interval(given[0]) / count, method, last)
    pairs = [
        Experiment(
            each.motion,
            main if each.scene is scene
            else with_interval(each.scene, frame_interval(each) / count, method, last_time(each)),
        )
        for each in given
    ]  # fmt: skip
    return objective.against(main, pairs, [pair.scene.frames for pair in pairs])


def last_time(given: Experiment) -> float:
    """When the last frame of a target is that its scene reaches, s."""
    step, part = frame_places(given.motion, given.scene.delta)
    places = step + part
    return float(places[places <= given.scene.frames - 1].max(initial=0.0)) * given.scene.delta


def with_interval(scene: Scene, delta: float, method: int | None, last: float = 0.0) -> Scene:
    """The scene with steps of `delta`, s, as many as its time has, and no fewer than reach the time `last`, s."""
    within = int((scene.frames - 1) * scene.delta / delta + ROUNDING)
    needed = ceil(last / delta - ROUNDING)
    return scene.with_step(delta, max(within, needed, 1) + 1, method)


def chosen(objective: Objective, start: Array, enough: float, counts: Sequence[int]) -> Stepped:
    """The step that gains most on the targets, from `start` (P,): the scene's own, or of these numbers of BDF2 steps to
    a frame one that is worth its time. An RMSE of `enough`, m, is good enough.
    """
    own = objective.scene.method, substeps_of(objective.experiments[0])
    best = Stepped(objective, 0, start, np.inf, (), 0, False)
    errors: dict[int, float] = {}
    for count in (0, *counts):
        if count and own[0] == BDF2 and abs(count - own[1]) < ROUNDING:
            continue
        began = time.monotonic()
        part = with_substeps(objective, count, BDF2) if count else objective
        search, ended = fitted(part, best.p, enough, not count)
        rmse = part.rmse(search.best.cost)
        steps, method = (count, BDF2) if count else (max(round(own[1]), 1), own[0])
        step = Step(steps, INTEGRATORS[method], rmse, time.monotonic() - began)
        tried, evaluations = (*best.tried, step), best.evaluations + search.budget.evaluations
        better = search.best.cost < best.cost
        if better:
            best = Stepped(part, count, search.best.p, search.best.cost, tried, evaluations, is_enough(search))
        best = best._replace(tried=tried, evaluations=evaluations)
        if ended or best.explained or (count > 1 and not better):
            break
        if method == BDF2:
            errors[steps] = rmse
            if predicted_gain(errors, steps) < PAYS:
                break
    return best


def finer(objective: Objective, p: Array) -> float | None:
    """The RMSE, m, of the coarsest model with finer steps from p (P,), where that is lower than at p by as much as
    pays; None where it is not, or where a moment's look does not find it.
    """
    now = objective.rmse(objective.cost(p))
    search = Search(with_substeps(objective, LOOK, BDF2), p, 0.0, SEARCH_EVALUATIONS)
    with contextlib.suppress(Stop, Diverged, interrupts.OutOfTime), interrupts.limited(MOMENT):
        ladder.stage(search, ladder.models(objective.scene)[0], [p], rough=True)
    found = search.objective.rmse(search.best.cost)
    return found if found < (1.0 - PAYS) * now else None


def predicted_gain(rmse: dict[int, float], count: int) -> float:
    """By which fraction of the error `count` steps to a frame doubled would reduce it; 1 where nothing is known."""
    if count // 2 not in rmse or count < 2:
        return 1.0
    coarse, fine = rmse[count // 2] ** 2, rmse[count] ** 2
    added = max(coarse - fine, 0.0) * 16.0 / 15.0  # of the coarse one, by its steps
    rest = max(coarse - added, 0.0)
    return 1.0 - float(np.sqrt((rest + added / 256.0) / fine)) if fine > 0 else 0.0


def fitted(objective: Objective, p: Array, enough: float, first: bool) -> tuple[Search, bool]:
    """The fit of the coarsest model from p (P,), and whether the user or the time ended it. The first one tries the
    balances of momentum, which an exact target of the scene's own step fulfils.
    """
    search = Search(objective, p, enough, SEARCH_EVALUATIONS)
    try:
        with threads.single(), interrupts.heard():
            search.visit(p)
            if first and momentum.fits(objective):
                search.visit(momentum.fit(objective, p, search.fitted, momentum.TREATMENTS[0]))
            ladder.stage(search, ladder.models(objective.scene)[0], [p], rough=True)
    except (Stop, Diverged):
        pass
    except KeyboardInterrupt:
        if first and not np.isfinite(search.best.cost):
            raise  # there is no result yet
        return search, True
    except interrupts.OutOfTime:
        return search, True
    return search, False


def is_enough(search: Search) -> bool:
    """Whether the step can be no better: the motion is the target's but for noise. A request to end counts as no, and
    is heard by the next simulation.
    """
    if is_near(search):
        return True
    try:
        with threads.single(), interrupts.heard():
            test = residual_test(search.objective, search.best.p)
    except (Diverged, KeyboardInterrupt, interrupts.OutOfTime):
        return False
    return test is not None and test.is_noise

