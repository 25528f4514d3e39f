"""The time step of a fit: how many steps to a frame of the target, and by which integrator.

A step as long as a frame damps more than most targets do, and no values make up for that. The errors of the model e and
of the step s add up like independent ones,

    RMSE² ≈ e² + s²

so a step is fine enough where s is small beside the RMSE, and a simulation with half of it says how large s is. Each K
is fitted by the coarsest model of the scene (`ladder`), first its own step, then K = 1, 2, 4 … by BDF2, from the values
of the best before.
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
from clothfit.base.errors import InvalidInput
from clothfit.engine.fallbacks import NO_FALLBACKS
from clothfit.engine.system import BDF2
from clothfit.motion.divergence import Diverged
from clothfit.motion.simulate import simulate_cloths
from clothfit.motion.times import frame_places
from clothfit.objective.experiment import Experiment
from clothfit.objective.objective import Objective
from clothfit.objective.whiteness import residual_test
from clothfit.optimise import momentum
from clothfit.optimise.search import Search
from clothfit.optimise.status import Stop
from clothfit.scene.fit_vector import fitted_cloths, with_parameters
from clothfit.scene.kinds import INTEGRATORS
from clothfit.scene.scene import Scene
from clothfit.strategy import ladder
from clothfit.strategy.ladder import STAGE_TOLERANCE
from clothfit.strategy.trajectory_fit import is_near

HIDDEN = 0.3
"""Error of a step relative to that of the fit, below which twice the steps could lower that by 5 % at most."""

LONGEST_TRIAL = 6.0
"""Seconds of simulations that a trial may take, compilation and derivatives apart."""

CARRIED = 4.0
"""Rise of the cost by another step, above which the fit goes through the windows again."""

ALLOWED = 0.05
"""Rise of the coarsest model's error by a finer step that finer models are expected to make up for."""

PAYS = 0.05
"""Relative reduction of the error by a finer step that a hint is worth."""

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
    seconds: float  # of computing


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
    """The step for the targets, from `start` (P,): the scene's own, or the first of these numbers of BDF2 steps to a
    frame whose error hides behind what the model leaves. An RMSE of `enough`, m, is good enough.
    """
    own = objective.scene.method, substeps_of(objective.experiments[0])
    best = Stepped(objective, 0, start, np.inf, (), 0, False)
    for count in (0, *counts):
        if count and own[0] == BDF2 and abs(count - own[1]) < ROUNDING:
            continue
        began = time.process_time()
        part = with_substeps(objective, count, BDF2) if count else objective
        search, ended = fitted(part, best.p, enough, best.cost)
        rmse, before = part.rmse(search.best.cost), best.objective.rmse(best.cost)
        steps, method = (count, BDF2) if count else (max(round(own[1]), 1), own[0])
        tried = (*best.tried, Step(steps, INTEGRATORS[method], rmse, time.process_time() - began))
        evaluations = best.evaluations + search.budget.evaluations
        good = rmse < (1.0 + ladder_gain(objective.scene)) * before
        if good:
            best = Stepped(part, count, search.best.p, search.best.cost, tried, evaluations, is_enough(search))
        best = best._replace(tried=tried, evaluations=evaluations)
        if ended or best.explained or (count > 1 and not good):
            break
        if method == BDF2 and not is_worth_more(search, rmse):
            break
    return best


def ladder_gain(scene: Scene) -> float:
    """By which fraction a finer step may raise the error of the coarsest model, where finer ones follow, of which a
    smaller error of the step shows.
    """
    return ALLOWED if len(ladder.models(scene)) > 1 else 0.0


def is_worth_more(search: Search, rmse: float) -> bool:
    """Whether steps half as long may pay after a fit with this RMSE, m: where its motion needs fallbacks, with which it
    jumps with the values, or where the error of its steps shows; unless that takes long. Not where the user or the time
    ends the look.
    """
    objective, p, began = search.objective, search.best.p, time.process_time()
    try:
        needed = objective.remedies(p) != NO_FALLBACKS
        twice = 2.0 * (time.process_time() - began) * search.budget.evaluations
        return twice < LONGEST_TRIAL and (needed or step_error(objective.scene, p) > HIDDEN * rmse)
    except Diverged:
        return True
    except (KeyboardInterrupt, interrupts.OutOfTime):
        return False


def step_error(scene: Scene, p: Array) -> float:
    """How far, m, RMS over all vertices, the motion of p (P,) is from that with steps half as long; infinite where one
    diverges. By a step of second order that is 3/4 of what the step adds to the error.
    """
    at = with_parameters(scene, p)
    try:
        coarse = simulate_cloths(at, fitted_cloths(at), tolerance=STAGE_TOLERANCE)
        half = with_interval(at, at.delta / 2.0, None)
        fine = simulate_cloths(half, fitted_cloths(at), tolerance=STAGE_TOLERANCE)
    except Diverged:
        return np.inf
    squares = (coarse.positions - fine.positions[::2]) ** 2
    return float(np.sqrt(np.nanmean(squares.sum(axis=-1))))


def finer(objective: Objective, p: Array) -> float | None:
    """The RMSE, m, of the coarsest model with finer steps from p (P,), where that is lower than at p by as much as
    pays; None where it is not, or where a moment's look does not find it.
    """
    now = objective.rmse(objective.cost(p))
    search = Search(with_substeps(objective, LOOK, BDF2), p, 0.0, SEARCH_EVALUATIONS)
    with contextlib.suppress(Stop, Diverged, InvalidInput, interrupts.OutOfTime), interrupts.limited(MOMENT):
        ladder.stage(search, ladder.models(objective.scene)[0], [p], rough=True)
    found = search.objective.rmse(search.best.cost)
    return found if found < (1.0 - PAYS) * now else None


def fitted(objective: Objective, p: Array, enough: float, before: float) -> tuple[Search, bool]:
    """The fit of the coarsest model from p (P,), whose cost was that `before` with another step, infinite for the first
    one, and whether the user or the time ended it. The first one tries the balances of momentum, which an exact target
    of the scene's own step fulfils.
    """
    search, first = Search(objective, p, enough, SEARCH_EVALUATIONS), not np.isfinite(before)
    try:
        with threads.single(), interrupts.heard():
            search.visit(p)
            if first and momentum.fits(objective):
                search.visit(momentum.fit(objective, p, search.fitted, momentum.TREATMENTS[0]))
            starts = [p] if first or search.best.cost > CARRIED * before else []
            first_model, *finer_models = ladder.models(objective.scene)
            ladder.stage(search, first_model, starts, rough=first or bool(finer_models))
    except (Stop, Diverged):
        pass
    except InvalidInput:  # too little memory for so many steps
        if first:
            raise
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

