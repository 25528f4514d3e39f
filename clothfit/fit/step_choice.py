"""The choice of a time step: how many steps to a frame of the target, and by which integrator.

A step as long as a frame damps more than most targets do, and no values make up for that. So models of few values
(`hierarchy`) come to their target by `continuation`: by one step of implicit Euler to a frame, then by two, then by the
scene's own step, which comes first near the target, and by K = 2, 4 … steps of BDF2 or of implicit Euler, each from the
best values before. Finer models come before the shorter steps, which then start from their maps. It ends where two
finer steps in a row do not pay, or the time is up; what comes nearest is kept. A target that the scene's own step
explains keeps that at once.
"""

from __future__ import annotations

import contextlib
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from clothfit.base import interrupts, threads
from clothfit.base.arrays import Array
from clothfit.base.errors import InvalidInput
from clothfit.engine.system import BDF2, IMPLICIT
from clothfit.fit import continuation, hierarchy
from clothfit.fit.auto import balances_can_hold, by_momentum, treatments
from clothfit.fit.continuation import ROUNDING, frame_interval, with_substeps
from clothfit.fit.few_values import (
    FEW_VALUES,
    FIRST_STEPS,
    beyond_switches,
    in_a_round,
    through_windows,
    to_the_minimum,
    unexplained,
    windows_of,
)
from clothfit.fit.trajectory_fit import NEAR_ERROR, UNLIKE, first_frames, is_near, may_leave_noise
from clothfit.kernels.clock import clock_of, computing
from clothfit.motion.divergence import Diverged
from clothfit.objective.objective import Objective
from clothfit.objective.whiteness import residual_test
from clothfit.optimise import momentum
from clothfit.optimise.search import Search
from clothfit.optimise.status import Stop
from clothfit.optimise.trajectory import Trajectory
from clothfit.scene.kinds import INTEGRATORS

LONGEST, CLOSE, LONGEST_TRIAL = 25.0, 12.0, 10.0
"""Seconds of computing that a choice may take, those more where coarse steps come close, from where finer models soon
come to their end, and that a trial is expected to take at most where it is begun.
"""

PAYS = 0.05
"""Relative reduction of the error by a finer step that a hint, or another step, is worth."""

ALLOWED = 0.05
"""Rise of the error of few values by steps shorter than a frame that finer models are expected to make up for."""

COUNTS = (1, 2, 4, 8, 16, 32)
"""Steps to a frame that are tried one after the other, while they pay."""

ABOUT, FAILED = 1.5, 2.0
"""Errors up to so many times another one are about as large; beyond so many times the search has failed."""

MAPS = 1.5
"""Times that finer models take as long as few values."""

FINER = 2.5
"""Times that a trial takes as long as one with steps twice as long, and more of them."""

FINE_SUBSTEPS, FINE_SECONDS = 4, 4.0
"""Steps to a frame with which a look at finer steps is taken, and the seconds of computing that it may take."""

EVALUATIONS = 10_000
"""That a choice may take."""

EXPECTED = 30
"""Simulations that a trial takes at least."""


@dataclass(frozen=True)
class Step:
    """A time step that was tried."""

    substeps: int  # K, steps to a frame of the target
    integrator: str  # its name
    rmse: float  # m, of the coarsest model, as far as it was fitted with that step
    seconds: float  # of computing


class Stepped(NamedTuple):
    """An objective with the step of its fit, and what its choice has found."""

    objective: Objective
    step: tuple[int, int] | None  # steps to a frame, and the method; None: the scene's own
    p: Array  # (P,), the best values of a model of few
    cost: float  # there
    tried: tuple[Step, ...]
    leaves_noise: bool  # whether the motion is the target's but for noise


class Trial:
    """Models of few values with one step."""

    def __init__(self, search: Search, step: tuple[int, int] | None = None, first: bool = False) -> None:
        """`search` of the scene with that step; `step`: how many to a frame, and the method, None for the scene's own;
        `first`: there is no result before.
        """
        self.search, self.chosen, self.first = search, step, first
        self.explains = False  # whether single values by this step may leave nothing but noise
        self.ended = False  # by the user
        self.seconds = 0.0  # of computing

    @property
    def rmse(self) -> float:
        """The error of the best values, m."""
        return self.search.objective.rmse(self.search.best.cost)

    @property
    def step(self) -> Step:
        """What has come of it."""
        scene, given = self.search.objective.scene, self.search.objective.experiments[0]
        count = max(round(frame_interval(given) / scene.delta), 1)
        return Step(count, INTEGRATORS[scene.method], self.rmse, self.seconds)

    def try_step(self) -> None:
        """Try whether the step explains the target: by the balances of momentum, which an exact target of that step
        fulfils, and in the first frames by single values and by few.
        """
        objective, model = self.search.objective, few_valued(self.search.objective)[-1]

        def look(search: Search) -> None:
            search.visit(search.start)
            balances = momentum.Momentum(objective, search.start, search.fitted)
            fits = momentum.fits(objective) and not objective.scanned
            if fits and balances_can_hold(search, balances, first_frames(objective)):
                by_momentum(search, search.start, treatments(search)[:1], balances=balances)
            single = hierarchy.model_of(objective.scene) == "L"
            known = is_best_possible(search) or search.proven is not None
            self.explains = known or (single and may_leave_noise(search))
            if not (self.explains or single):
                hierarchy.run_subproblem(search, hierarchy.subproblem(search, model, search.start), by_windows_of_noise)

        self.run(look)
        self.explains = not self.ended and (self.explains or is_best_possible(self.search))

    def arrive(self, model: str, p: Array, method: Callable[[Search], object]) -> None:
        """Fit a model by a method, from p (P,)."""
        self.run(lambda own: hierarchy.run_subproblem(own, hierarchy.subproblem(own, model, p), method))

    def run(self, method: Callable[[Search], object]) -> None:
        """Let a method search; whatever ends it ends the trial alone."""
        began = computing()
        with self._ending():
            method(self.search)
        self.seconds += computing() - began

    @contextlib.contextmanager
    def _ending(self) -> Iterator[None]:
        """Raises InvalidInput where there is too little memory, and KeyboardInterrupt, where there is no result yet."""
        try:
            with threads.single(), interrupts.heard():
                yield
        except (Stop, Diverged, np.linalg.LinAlgError):
            pass
        except (InvalidInput, KeyboardInterrupt) as end:  # the former: too little memory for so many steps
            if self.first and not np.isfinite(self.search.best.cost):
                raise
            self.ended = isinstance(end, KeyboardInterrupt)
        except interrupts.OutOfTime:
            self.ended = True


def chosen(root: Search, counts: Sequence[int], origin: Objective | None = None, finer: bool = True) -> Stepped:
    """The step for the targets of a search, from its start: its own, one of implicit Euler to a frame, or one of these
    numbers of BDF2 steps, whichever comes nearest. `origin` is the objective with the step of the user's scene, where
    that was changed. Without `finer` the coarsest model alone is fitted.
    """
    origin, own = origin or root.objective, Trial(root, first=True)
    own.try_step()
    if own.explains or own.ended:
        made, best = [own], own
    else:
        root.longest = root.progress.computing + LONGEST
        models = hierarchy.models(root.objective.scene)[1:] if finer else []
        made, best = compared(own, root.start, counts, origin, models)
    if best.chosen == (1, IMPLICIT):  # solved as tightly as a fit does
        p = best.search.best.p
        best = Trial(root.subsearch(with_substeps(origin, 1, IMPLICIT), p, np.inf), best.chosen)
        best.run(lambda search: search.visit(p))
        best = best if np.isfinite(best.search.best.cost) else own  # it was interrupted
    no_better = own.explains or is_best_possible(best.search)
    found, tried = best.search.best, tuple(each.step for each in made)
    return Stepped(best.search.objective, best.chosen, found.p, found.cost, tried, no_better)


def compared(
    own: Trial, start: Array, counts: Sequence[int], origin: Objective, finer: Sequence[str]
) -> tuple[list[Trial], Trial]:
    """Trials of steps that may be chosen, from `start` (P,), as `chosen` takes them, and the best; `own` is that of the
    scene's own step. Steps are compared by what the coarsest model comes to, each from the values of the `finer` ones
    with coarse steps, or of the best step before.
    """
    root, objective = own.search, own.search.objective
    model, finer = hierarchy.models(objective.scene)[0], [each for each in finer if each != "L"]
    is_coarse = objective.scene.method == IMPLICIT and own.step.substeps == 1
    rough, step = (objective, None) if is_coarse else (continuation.coarse(origin), (1, IMPLICIT))
    coarse = own if is_coarse else Trial(root.subsearch(rough, start, np.inf), step)
    coarse.arrive(model, start, continuation.from_afar)
    root.longest += CLOSE if is_close(coarse.search) else 0.0
    made, freer = [coarse], with_finer(coarse, finer)
    for step in steps_of(made, counts, own, origin):
        best = nearest(made)
        late = root.progress.computing + min(FINER * made[-1].seconds, LONGEST_TRIAL) > root.longest
        if (late and len(made) > 1) or made[-1].ended or is_best_possible(best.search) or is_poor(made):
            break
        p = (freer if best is coarse else best).search.best.p
        made.append(own if step is None else Trial(root.subsearch(with_substeps(origin, *step), p, np.inf), step))
        if step is None and is_close(best.search):
            own.arrive(model, start, through_windows_to_the_minimum)
        made[-1].arrive(model, p, through_nudging_to_the_minimum)
    if not (1 in counts or is_coarse):
        made = made[1:] or [own]  # coarse steps are the way alone
    best = nearest(made)
    for trial in sorted(made, key=lambda each: each.rmse):  # with time left, the finest model judges between them
        late = root.progress.computing + MAPS * trial.seconds > root.longest
        if not (late or trial is coarse or trial.ended or trial.rmse > ABOUT * best.rmse):
            go_on(trial, finer[-1:])
    best = nearest([*made, own])  # whose own step may not have had its turn
    return made, freer if best is coarse and freer.rmse < best.rmse else best


def with_finer(trial: Trial, models: Sequence[str]) -> Trial:
    """The trial of finer models with the step of another one, from its best values."""
    own = trial.search
    found = Trial(own.subsearch(own.objective, own.best.p, own.best.cost), trial.chosen)
    go_on(found, models)
    return found


def go_on(trial: Trial, models: Sequence[str]) -> None:
    """Fit models from the best values of a trial, one after the other, as far as their steps are quick."""
    for model in models:
        if hierarchy.is_quick(hierarchy.subproblem(trial.search, model, trial.search.best.p)):
            trial.arrive(model, trial.search.best.p, continuation.through_weak_nudging)


def shorter(
    search: Search, model: str, tried: Sequence[Step], counts: Sequence[int],
    by: Callable[[tuple[int, int]], Objective],
) -> Trial | None:  # fmt: skip
    """The trial of a model `by` steps half as long, of either method, from the best values of a search; None where it
    is no nearer, or there is no time. Methods that were `tried` with a coarser model come last.
    """
    own, took = Trial(search), search.levels[-1].seconds
    count, known = 2 * own.step.substeps, [(each.substeps, each.integrator) for each in tried]
    for step in sorted([(count, IMPLICIT), (count, BDF2)], key=lambda step: (step[0], INTEGRATORS[step[1]]) in known):
        if count in counts and search.has_time(min(took, LONGEST_TRIAL)):
            trial = Trial(search.subsearch(by(step), search.best.p, np.inf), step)
            go_on(trial, [model])
            if trial.rmse < (1.0 - PAYS) * own.rmse:
                return trial
    return None


def steps_of(
    made: Sequence[Trial], counts: Sequence[int], own: Trial, origin: Objective
) -> Iterator[tuple[int, int] | None]:
    """The steps to try one after the other, None for the scene's own, as far as those that were `made` tell: implicit
    Euler damps and BDF2 hardly does, which a target may need or not bear.
    """
    objective, is_coarse, coarse = own.search.objective, made[0] is own, made[0]
    close, halves = is_close(coarse.search), 1 in counts and 2 in counts
    if halves and not close:
        yield 2, IMPLICIT
    if not is_coarse:
        yield None
    if halves and close and not made[-1].rmse < coarse.rmse:
        yield 2, IMPLICIT
    for count in counts:
        errors = {
            method: [each.rmse for each in made if each.search.objective.scene.method == method]
            for method in (BDF2, IMPLICIT)
        }
        fails = len(errors[BDF2]) > 1 and errors[BDF2][-1] > FAILED * min(each.rmse for each in made)
        if not (fails or is_own(objective, origin, count)):
            yield count, BDF2
        if 1 in counts and count > 2 and not min(errors[BDF2], default=np.inf) < errors[IMPLICIT][-1]:
            yield count, IMPLICIT


def by_windows_of_noise(own: Search) -> None:
    """Windows of more and more frames to the minimum, where a fit of the first leaves noise. Raises Stop."""
    first = windows_of(own.objective)[:1]
    if own.fitted.sum() <= FEW_VALUES and first:
        p = through_windows(own, slice(0, 1))
        if first[0].cost_or_infinity(p) < UNLIKE**2 * first[0].cost_at_rest or is_noise(first[0], p):
            own.visit(through_windows(own, slice(1, None)))
            to_the_minimum(own)


def by_exact_windows(own: Search, exact: list[tuple[Objective, Array]]) -> None:
    """Windows of more and more frames to the minimum, as far as each is reproduced but for noise; those that are, with
    the values (P,) that do so, go to `exact`. Raises Stop.
    """
    own.visit(own.start)
    if own.fitted.sum() > FEW_VALUES:
        return
    with np.errstate(over="ignore", invalid="ignore"):  # of sensitivities where a cloth buckles
        through_windows(own, reproduced=exact)
        if own.best.cost < UNLIKE**2 * own.objective.cost_at_rest or is_whole(exact, own.objective):
            to_the_minimum(own)
            if unexplained(own.objective, own.best.p):
                beyond_switches(Trajectory(own, own.objective), own.y, FIRST_STEPS, wide=True)


def is_whole(exact: Sequence[tuple[Objective, Array]], objective: Objective) -> bool:
    """Whether the longest window of an objective is among those that are reproduced."""
    return bool(exact) and exact[-1][0].frames == windows_of(objective, close=True)[-1].frames


def through_windows_to_the_minimum(own: Search) -> None:
    """Come from the start by windows of more and more frames nearly to the minimum. Raises Stop."""
    if own.fitted.sum() <= FEW_VALUES:
        through_windows(own)
        in_a_round(own)


def through_nudging_to_the_minimum(own: Search) -> None:
    """Come from values that another step has found nearly to the minimum. Raises Stop."""
    continuation.through_nudging(own)
    in_a_round(own)


def is_close(search: Search) -> bool:
    """Whether a search has come so near that windows from the start may lead to the minimum."""
    return search.best.cost < continuation.NEAR**2 * search.objective.cost_at_rest


def nearest(made: Sequence[Trial]) -> Trial:
    """The trial that has come nearest; of those that have come about as near the first. Steps of implicit Euler as long
    as a frame damp so much that finer models make up for a little more with shorter ones.
    """
    found = made[0]
    for trial in made[1:]:
        about = ALLOWED if found.chosen == (1, IMPLICIT) else -PAYS
        found = trial if trial.rmse < (1.0 + about) * found.rmse else found
    return found


def is_poor(made: Sequence[Trial]) -> bool:
    """Whether the last trials do not pay: two that have come about as near as the nearest before, or any four."""
    errors = [trial.rmse for trial in made]
    last = max(i for i, error in enumerate(errors) if not i or error < (1.0 - PAYS) * min(errors[:i]))
    since = errors[last + 1 :]
    return len(since) > 3 or (len(since) > 1 and max(since[-2:]) < ABOUT * errors[last])


def is_own(objective: Objective, origin: Objective, count: int) -> bool:
    """Whether so many steps of BDF2 to a frame are the objective's own."""
    own = frame_interval(origin.experiments[0]) / objective.scene.delta
    return objective.scene.method == BDF2 and abs(count - own) < ROUNDING


def few_valued(objective: Objective) -> list[str]:
    """The coarsest model of an objective, and those after it that have few values as well."""
    first, *others = hierarchy.models(objective.scene)
    counts = {model: hierarchy.count(hierarchy.as_model(objective.scene, model)) for model in others}
    return [first, *(model for model, count in counts.items() if count <= FEW_VALUES)]


def finer(objective: Objective, p: Array) -> float | None:
    """The RMSE, m, of the coarsest model with finer steps from p (P,), where that is lower than at p by as much as
    pays; None where it is not, or where a moment's look does not find it.
    """
    now = objective.rmse(objective.cost(p))
    if seconds_of(objective, p) * FINE_SUBSTEPS * EXPECTED > FINE_SECONDS:
        return None
    search = Search(with_substeps(objective, FINE_SUBSTEPS, BDF2), p, 0.0, EVALUATIONS)
    search.longest = FINE_SECONDS
    with contextlib.suppress(Stop, Diverged, InvalidInput, interrupts.OutOfTime):
        hierarchy.stage(search, hierarchy.models(objective.scene)[0], [p], rough=True)
    found = search.objective.rmse(search.best.cost)
    return found if found < (1.0 - PAYS) * now else None


def seconds_of(objective: Objective, p: Array) -> float:
    """Seconds of computing that the cost at p (P,) takes where its motion is not known yet."""
    anew, clock = objective.flagging(objective.scene), clock_of(int(objective.identifiable.sum()))
    began = clock()
    anew.cost_or_infinity(p)
    return clock() - began


def is_best_possible(search: Search) -> bool:
    """Whether the step can be no better: the motion is the target's but for noise. A request to end counts as no, and
    is heard by the next simulation.
    """
    return is_near(search) or leaves_noise(search)


def leaves_noise(search: Search) -> bool:
    """Whether the motion at the best point is the target's but for noise."""
    if search.objective.rmse(search.best.cost) <= search.rmse_tolerance:
        return True
    try:
        with threads.single(), interrupts.heard():
            return is_noise(search.objective, search.best.p)
    except (Diverged, KeyboardInterrupt, interrupts.OutOfTime):
        return False


def is_noise(objective: Objective, p: Array) -> bool:
    """Whether what is left at p (P,) is noise, but for so little that a motion counts as near. Raises Diverged."""
    test = residual_test(objective, p)
    near = NEAR_ERROR**2 * objective.cost_at_rest
    return test is not None and (test.is_noise or test.structured * objective.cost(p) < near)
