"""The choice of a time step: how many steps to a frame of the target, and by which integrator.

A step as long as a frame damps more than most targets do, and no values make up for that. The scene's own step and
then K = 1, 2, 4 … steps of BDF2 to a frame are compared by the coarsest model of the scene (`ladder`): first by a look
at the first window of frames, which takes a tenth of a fit and already shows a step that is too coarse. The first one
that is not is fitted to all frames. It is halved from there while its error shows beside that of the fit, and each fit
goes on from the values of the one before.

The errors of the model e and of the step s add up like independent ones,

    RMSE² ≈ e² + s²

so a step is fine enough where s is small beside the RMSE, and a simulation with half of it says how large s is.
"""

from __future__ import annotations

import contextlib
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from math import ceil
from typing import NamedTuple

import numpy as np

from clothfit.base import interrupts, threads
from clothfit.base.arrays import Array
from clothfit.base.errors import InvalidInput
from clothfit.engine.fallbacks import NO_FALLBACKS
from clothfit.engine.system import BDF2
from clothfit.kernels.clock import clock_of, computing
from clothfit.motion.divergence import Diverged
from clothfit.motion.simulate import simulate_cloths
from clothfit.motion.times import frame_places
from clothfit.objective.experiment import Experiment
from clothfit.objective.objective import Objective
from clothfit.objective.whiteness import residual_test
from clothfit.optimise import momentum
from clothfit.optimise.search import Search
from clothfit.optimise.status import Stop
from clothfit.scene.fit_vector import fitted_cloths, parameters, with_parameters
from clothfit.scene.kinds import INTEGRATORS
from clothfit.scene.scene import Scene
from clothfit.strategy import few_values, ladder
from clothfit.strategy.auto import balances_can_hold
from clothfit.strategy.trajectory_fit import first_frames, is_near, may_explain

HIDDEN = 0.3
"""Error of a step relative to that of the fit, below which twice the steps could lower that by 5 % at most."""

LONGEST_TRIAL = 6.0
"""Seconds of simulations that a trial may take, compilation and derivatives apart."""

LONGEST, ALONE = 12.0, 20.0
"""Seconds of computing after which a trial ends with what it has; of a large cloth, which has one trial only."""

CARRIED = 4.0
"""Rise of the cost by another step, above which the fit goes through the windows again."""

ALLOWED = 0.05
"""Rise of the coarsest model's error by a finer step that finer models are expected to make up for."""

PAYS = 0.05
"""Relative reduction of the error by a finer step that a hint, or another step, is worth."""

COUNTS = (1, 2, 4, 8, 16, 32)
"""Steps to a frame that are tried one after the other, while they pay."""

LOOK, MOMENT = 4, 4.0
"""Steps to a frame with which a look at finer steps is taken, and the seconds of computing that it may take."""

ROUNDING = 1e-6
"""Steps by which a whole number of them may be off by rounding."""

SEARCH_EVALUATIONS = 1000

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
    substeps: int  # K of BDF2; 0: the scene's own step
    p: Array  # (P,), the best values of the coarsest model
    cost: float  # there
    tried: tuple[Step, ...]
    evaluations: int
    explained: bool  # whether the motion is the target's but for noise
    settled: bool  # whether they are a minimum
    fitted: bool  # whether the coarsest model was fitted to all frames, not only to the first ones


class Trial:
    """The coarsest model of a scene with one step."""

    def __init__(self, objective: Objective, count: int, p: Array, enough: float, step: Step) -> None:
        """`count` is K of BDF2, 0 for the scene's own step; the fit goes on from p (P,); `step` names what is tried."""
        self.objective, self.count, self.p, self.step = objective, count, p, step
        self.search = Search(objective, p, enough, SEARCH_EVALUATIONS)
        self.search.longest = LONGEST
        self.model = ladder.models(objective.scene)[0]
        self.early_rmse = np.inf  # m, over the first window, of the values that were fitted to it
        self.looked, self.shows = False, False  # whether there is such a window, and the error of the step in it
        self.fitted = False  # whether all frames were
        self.ended = False  # by the user or the time
        self.explains = False  # whether single values by this step may leave nothing but noise
        self.alone = False  # whether a trial of finer steps would take too long

    @property
    def rmse(self) -> float:
        """The error of the best values, m."""
        return self.objective.rmse(self.search.best.cost)

    @property
    def by_bdf2(self) -> bool:
        """Whether the step is one of BDF2."""
        return self.objective.scene.method == BDF2

    def look(self) -> None:
        """Fit the first window. The scene's own step tries the balances of momentum before, which an exact target of
        that step fulfils.
        """
        with self._ending():
            self.search.visit(self.p)
            if self._takes_long() and self._takes_long():  # the first one also loads compiled code
                self.alone, self.search.longest = True, ALONE
            may_balance = not self.count and momentum.fits(self.objective)
            if may_balance and balances_can_hold(self.search, self.p, first_frames(self.objective)):
                self.search.visit(momentum.fit(self.objective, self.p, self.search.fitted, momentum.TREATMENTS[0]))
            if is_near(self.search) or not self._through(slice(0, 1)):
                return
            window, self.looked = few_values.windows_of(self.objective)[0], True
            self.early_rmse = window.rmse(window.cost_or_infinity(self.p))
            scene = window.scene.with_step(window.scene.delta, window.steps + 1)
            error = step_error(scene, self.p)
            self.shows = error > HIDDEN * self.early_rmse and not is_noise(window, self.p)
            if not (self.count or self.alone) and ladder.model_of(scene) == "L":
                self.explains = may_explain(self.search, None)

    def _takes_long(self) -> bool:
        """Whether a trial of finer steps would take too long, by the seconds of a simulation."""
        return EXPECTED * 2.0 * seconds_of(self.objective, self.p) >= LONGEST_TRIAL

    def finish(self, before: float, rough: bool) -> None:
        """Fit all frames, by a short round where `rough`; first the windows that are left, or all of them where the
        cost is far above that `before`, by another step and from the same values. Where no other step is compared with
        this one, the windows are enough, and the search that follows does the rest.
        """
        with self._ending():
            if self.looked:
                self._through(slice(1, None))
            elif not self.search.visit(self.p) <= CARRIED * before:
                self._through(slice(None))
            if not self.alone:
                ladder.stage(self.search, self.model, rough=rough)
                self.fitted = not self.search.is_late

    def _through(self, windows: slice) -> bool:
        """Fit some windows; whether there are any, and a model of few values, which windows are for."""
        part, scene = ladder.part_of(self.search, self.model, self.p), self.objective.scene
        if part.fitted.sum() > few_values.FEW_VALUES or not few_values.windows_of(self.objective)[windows]:
            return False

        def through(own: Search) -> None:
            p = few_values.through_windows(own, windows)
            self.p = parameters(with_parameters(own.objective.scene, p), flags=scene)

        ladder.carried(self.search, part, through)
        return True

    @contextlib.contextmanager
    def _ending(self) -> Iterator[None]:
        """Let whatever ends the block end it alone. Raises InvalidInput where there is too little memory, and
        KeyboardInterrupt, where these end the first trial.
        """
        began, first = computing(), not self.count
        try:
            with threads.single(), interrupts.heard():
                yield
        except (Stop, Diverged) as end:
            self.fitted, self.shows = True, isinstance(end, Diverged)
        except InvalidInput:  # too little memory for so many steps
            if first:
                raise
            self.fitted = True
        except KeyboardInterrupt:
            if first and not np.isfinite(self.search.best.cost):
                raise  # there is no result yet
            self.ended = True
        except interrupts.OutOfTime:
            self.ended = True
        self.step = replace(self.step, rmse=self.rmse, seconds=self.step.seconds + computing() - began)


class Trials:
    """The trials of a choice, and the steps that are left."""

    def __init__(self, objective: Objective, enough: float, counts: Sequence[int], origin: Objective) -> None:
        """As `chosen` takes them."""
        self.objective, self.enough, self.origin, self.made = objective, enough, origin, list[Trial]()
        self.own = frame_interval(origin.experiments[0]) / objective.scene.delta
        bdf2 = objective.scene.method == BDF2
        self.left = [count for count in counts if not (bdf2 and abs(count - self.own) < ROUNDING)]
        self.several = len(ladder.models(objective.scene)) > 1

    def begin(self, count: int, p: Array) -> Trial:
        """The trial of a step, from p (P,)."""
        part = with_substeps(self.origin, count, BDF2) if count else self.objective
        step = Step(count or max(round(self.own), 1), INTEGRATORS[part.scene.method], np.inf, 0.0)
        self.made.append(Trial(part, count, p, self.enough, step))
        return self.made[-1]

    def by_looks(self, start: Array) -> Trial:
        """The first step whose error does not show in the first window, or that half of it does not improve."""
        trial = self.begin(0, start)
        trial.look()
        while self.left and trial.shows and not (trial.alone or trial.explains):
            finer = self.begin(self.left.pop(0), trial.p)
            finer.look()
            pays = is_near(finer.search) or finer.early_rmse < (1.0 - PAYS) * trial.early_rmse
            if trial.by_bdf2 and not pays:
                break
            trial = finer
        return trial

    def by_fits(self, best: Trial) -> Trial:
        """The step, from one that a look has found, after which finer ones do not pay for all frames either."""
        if best.explains:
            return best
        trial, before, gain = best, np.inf, ALLOWED if self.several else 0.0
        while True:
            if not (trial.fitted or trial.ended):
                trial.finish(before, rough=self.several or not trial.count)
            good = trial is best or trial.rmse < (1.0 + gain) * best.rmse
            best = trial if good else best
            late = trial.alone or trial.search.is_late  # halved steps take twice the time
            if late or trial.ended or not self.left or is_enough(best.search) or (trial.count > 1 and not good):
                return best
            if trial.by_bdf2 and not is_worth_more(trial.search, trial.rmse):
                return best
            before = best.search.best.cost
            trial = self.begin(self.left.pop(0), best.search.best.p)


def chosen(
    objective: Objective, start: Array, enough: float, counts: Sequence[int], origin: Objective | None = None
) -> Stepped:
    """The step for the targets, from `start` (P,): the scene's own, or the first of these numbers of BDF2 steps to a
    frame whose error hides behind what the model leaves. An RMSE of `enough`, m, is good enough. `origin` is the
    objective with the step of the user's scene, where that was changed.
    """
    trials = Trials(objective, enough, counts, origin or objective)
    best = trials.by_fits(trials.by_looks(start))
    best = min([best, *trials.made], key=lambda each: each.rmse if each is best or not each.fitted else np.inf)
    return Stepped(
        best.objective, best.count, best.search.best.p, best.search.best.cost,
        tuple(each.step for each in trials.made), sum(each.search.budget.evaluations for each in trials.made),
        best.explains or is_enough(best.search), best.search.is_settled, best.fitted,
    )  # fmt: skip


def is_worth_more(search: Search, rmse: float) -> bool:
    """Whether steps half as long may pay after a fit with this RMSE, m: where its motion needs fallbacks, with which it
    jumps with the values, or where the error of its steps shows; unless that takes long. Not where the user or the time
    ends the look.
    """
    objective, p = search.objective, search.best.p
    try:
        needed = objective.remedies(p) != NO_FALLBACKS
        twice = 2.0 * search.each * max(search.budget.evaluations, EXPECTED)
        return twice < LONGEST_TRIAL and (needed or step_error(objective.scene, p) > HIDDEN * rmse)
    except Diverged:
        return True
    except (KeyboardInterrupt, interrupts.OutOfTime):
        return False


def finer(objective: Objective, p: Array) -> float | None:
    """The RMSE, m, of the coarsest model with finer steps from p (P,), where that is lower than at p by as much as
    pays; None where it is not, or where a moment's look does not find it.
    """
    now = objective.rmse(objective.cost(p))
    if seconds_of(objective, p) * LOOK * EXPECTED > MOMENT:
        return None
    search = Search(with_substeps(objective, LOOK, BDF2), p, 0.0, SEARCH_EVALUATIONS)
    search.longest = MOMENT
    with contextlib.suppress(Stop, Diverged, InvalidInput, interrupts.OutOfTime):
        ladder.stage(search, ladder.models(objective.scene)[0], [p], rough=True)
    found = search.objective.rmse(search.best.cost)
    return found if found < (1.0 - PAYS) * now else None


def seconds_of(objective: Objective, p: Array) -> float:
    """Seconds of computing that the cost at p (P,) takes where its motion is not known yet."""
    anew, clock = objective.flagging(objective.scene), clock_of(int(objective.identifiable.sum()))
    began = clock()
    anew.cost_or_infinity(p)
    return clock() - began


def is_enough(search: Search) -> bool:
    """Whether the step can be no better: the motion is the target's but for noise. A request to end counts as no, and
    is heard by the next simulation.
    """
    if is_near(search):
        return True
    try:
        with threads.single(), interrupts.heard():
            return is_noise(search.objective, search.best.p)
    except (Diverged, KeyboardInterrupt, interrupts.OutOfTime):
        return False


def is_noise(objective: Objective, p: Array) -> bool:
    """Whether what is left at p (P,) is noise. Raises Diverged."""
    test = residual_test(objective, p)
    return test is not None and test.is_noise


def frame_interval(given: Experiment) -> float:
    """Time between two frames of a target, s, in the median: steps of its scene, without the rounding of a whole number
    of them.
    """
    times, delta = given.motion.times, given.scene.delta
    steps = float(np.median(np.diff(times))) / delta if len(times) > 1 else 1.0
    whole = max(round(steps), 1)
    return delta * (whole if abs(steps - whole) < ROUNDING else steps)


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


def step_error(scene: Scene, p: Array) -> float:
    """How far, m, RMS over all vertices, the motion of p (P,) is from that with steps half as long; infinite where one
    diverges. By a step of second order that is 3/4 of what the step adds to the error.
    """
    at = with_parameters(scene, p)
    try:
        coarse = simulate_cloths(at, fitted_cloths(at), tolerance=ladder.STAGE_TOLERANCE)
        half = with_interval(at, at.delta / 2.0, None)
        fine = simulate_cloths(half, fitted_cloths(at), tolerance=ladder.STAGE_TOLERANCE)
    except Diverged:
        return np.inf
    squares = (coarse.positions - fine.positions[::2]) ** 2
    return float(np.sqrt(np.nanmean(squares.sum(axis=-1))))
