"""What a fit settles before it begins: its model, and the time step that its scene is to be played with.

Targets cut into windows that begin in the target's own states: multiple shooting, with the states given.

A motion from its start hides what a few frames show: what the model lacks adds up, and in wind a motion forgets where
it began. So each window of some frames is an experiment of its own, whose cloths begin where the target is then, with
the velocities of the frames around,

    x = y_s,    v = (y_{s+1} − y_{s−1}) / (t_{s+1} − t_{s−1}),

and values are those with which the next frames follow. The first window begins as the scene does. The values are exact
where the target is; noise of σ in the positions makes one of σ √2 / (t_{s+1} − t_{s−1}) in these velocities, so windows
of noisy targets must be long.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from functools import partial
from math import ceil
from typing import Any, TypeVar

import numpy as np

from clothfit.base import interrupts, threads
from clothfit.base.arrays import Array, Flags
from clothfit.base.errors import InvalidInput
from clothfit.engine.system import BDF2
from clothfit.fit import holdout
from clothfit.fit.holdout import Judged
from clothfit.fit.options import AUTO, LONGEST, FitOptions
from clothfit.fit.result import Fit
from clothfit.kernels import clock
from clothfit.motion.motion import Motion, at_frames
from clothfit.motion.times import TIME_SLACK, frame_places
from clothfit.objective.experiment import Experiment
from clothfit.objective.objective import Objective
from clothfit.optimise.checkpoint import State
from clothfit.scene.cloth import Cloth
from clothfit.scene.fit_vector import fitted_cloths, parameters, with_parameters
from clothfit.scene.scene import Scene
from clothfit.strategy import kinds, ladder, step_choice
from clothfit.strategy.kinds import Choice
from clothfit.strategy.start import choose_start, with_air
from clothfit.strategy.step_choice import Step
from clothfit.strategy.time_step import with_substeps

CHOICE = 0.7
"""Share of the time of a fit that the choice of its model may take, with that of the step."""

MOMENT = 0.5
"""Seconds for the costs of the values that were found, where the time is up."""

T = TypeVar("T")


@dataclass(frozen=True)
class Prepared:
    """What a fit begins with."""

    objective: Objective
    kept_out: Objective | None
    whole: Objective | None = None  # over whole motions, where the fit compares windows of them
    p: Array | None = None  # (P,), the best values that are known
    cost: float = np.inf  # there, as far as it is known
    settled: bool = False  # whether they are a minimum
    wanted: list[str] | None = None  # models that are left to try, where no values reproduce the target
    judged: list[Judged] | None = None  # the models among which one was chosen
    model: str = ""  # that was chosen
    step: tuple[int, int] | None = None  # steps to a frame and the method that were chosen; None: the scene's own
    tried: tuple[Step, ...] = ()  # time steps that were tried
    kinds: Sequence[Choice] = ()  # what was found of the kinds, where they were chosen
    left_out: Sequence[str] = ()  # those that are not fitted
    evaluations: int = 0
    seconds: float = 0.0
    computing: float = 0.0  # s, without other work of the machine

    def solved(self, tolerance: float, p: Array) -> Prepared:
        """The same from the values p (P,), with linear systems solved to another tolerance, relative."""
        return self.changed(lambda each: each.until(each.steps + 1, tolerance), p=p, cost=np.inf)

    def changed(self, change: Callable[[Objective], Objective], **others: Any) -> Prepared:
        """The same with a change of all its objectives, and with other fields."""
        kept_out, whole = (each and change(each) for each in (self.kept_out, self.whole))
        return replace(self, objective=change(self.objective), kept_out=kept_out, whole=whole, **others)


def flagged(scene: Scene, model: str | None) -> Scene:
    """The scene with a model in place of its own flags, where one is asked for; "auto" has all values free."""
    return scene if model is None else ladder.as_model(scene, "L" if model == AUTO else model, exactly=True)


def prepared(
    own: Prepared, start: float | Array | Scene | None, options: FitOptions, state: State | None = None
) -> Prepared:
    """What a fit to given targets begins with, from its `own` objectives. A fit that goes on from a `state` keeps what
    it had chosen.
    """
    now = clock.clock_of(int(own.objective.identifiable.sum()))
    began, computing = clock.passing(), now()
    plan, objective = own, own.objective
    if isinstance(options.substeps, int):
        plan = with_steps(plan, options.substeps, None)
    first = choose_start(plan.objective, start, hidden=False)
    if state is not None:
        return chosen_before(plan, first, state)
    if start is None and options.method == AUTO:
        blown = in_time(partial(with_air, plan.objective, first), first)
        plan = plan if blown is first else replace(plan, p=blown)
        first = blown
    if counts_of(options, objective.scene):
        plan = with_chosen_step(plan, first, options, own)
    if options.model == AUTO:
        p = first if plan.p is None else plan.p
        longest = CHOICE * LONGEST - (now() - computing) if options.budget is None else np.inf
        plan = with_chosen_model(plan, p, options, longest)
    return replace(plan, seconds=clock.passing() - began, computing=now() - computing)


def in_time(look: Callable[[], T], otherwise: T, seconds: float | None = None, known: bool = False) -> T:
    """What `look` finds within some seconds; `otherwise` where the time ends it, or a request does where a result is
    `known` already.
    """
    try:
        with threads.single(), interrupts.heard(), interrupts.limited(seconds):
            return look()
    except KeyboardInterrupt:
        if not known:
            raise
        interrupts.request()
        interrupts.answer()
    except interrupts.OutOfTime:
        pass
    return otherwise


def counts_of(options: FitOptions, scene: Scene) -> Sequence[int]:
    """The numbers of BDF2 steps to a frame that are to be tried. A scene with the editor's step keeps it where nobody
    asks for another.
    """
    if isinstance(options.substeps, int):
        return [options.substeps]
    asked = options.substeps == AUTO or (scene.method == BDF2 and options.method == AUTO)
    return step_choice.COUNTS if asked and not options.keep_step else []


def with_steps(plan: Prepared, count: int, method: int | None) -> Prepared:
    """The plan with so many steps to a frame."""
    return plan.changed(lambda each: with_substeps(each, count, method))


def chosen_before(plan: Prepared, start: Array, state: State) -> Prepared:
    """The plan with the step, the kinds and the model of a fit from `start` (P,) that goes on. Raises InvalidInput
    where they do not fit.
    """
    step = (state.substeps, state.integrator) if state.substeps else None
    if step:
        plan = with_steps(plan, *step)
    if state.left_out:
        plan = with_kinds_left_out(plan, start, state.left_out)
    if state.model:
        plan = with_model(plan, state.model)
    if len(parameters(plan.objective.scene)) != len(state.best):
        raise InvalidInput("the checkpoint is not what a fit has written; begin anew, without --resume")
    return replace(plan, model=state.model, step=step)


def with_model(plan: Prepared, model: str) -> Prepared:
    """The plan with a model in place of its scene's."""
    scene = ladder.as_model(plan.objective.scene, model, exactly=True)
    return plan.changed(lambda each: each.flagging(scene), model=model)


def with_kinds_left_out(plan: Prepared, start: Array, gone: Sequence[str]) -> Prepared:
    """The plan without the flags of some kinds, which have the values of `start` (P,)."""
    return plan.changed(lambda each: each.flagging(kinds.without(each.scene, start, gone)), left_out=gone)


def with_chosen_step(plan: Prepared, start: Array, options: FitOptions, own: Prepared) -> Prepared:
    """The plan with the step that gains most; `own` has that of the user's scene."""
    counts = counts_of(options, own.objective.scene)
    found = step_choice.chosen(
        plan.objective, start, options.enough, counts, own.objective, options.on_progress, options.auto,
        options.model != AUTO,
    )
    if found.step:
        plan = replace(with_steps(own, *found.step), step=found.step)
    if gone := kinds.left_out(found.kinds):
        plan = with_kinds_left_out(plan, start, gone)
    return replace(
        plan, kinds=found.kinds, p=found.p, cost=found.cost, tried=found.tried, evaluations=found.evaluations,
        wanted=None if found.explained else ladder.left(plan.objective.scene),
    )  # fmt: skip


def with_chosen_model(plan: Prepared, p: Array, options: FitOptions, longest: float) -> Prepared:
    """The plan with the smallest model that no finer one beats on what it has not seen, from values p (P,), of those
    that begin within the `longest` time, s of computing.
    """
    found = holdout.chosen(
        plan.objective, plan.kept_out, p, options.enough, options.holdout_of, options.max_evaluations, longest,
        fitted=bool(plan.tried),
    )  # fmt: skip
    before = with_parameters(plan.objective.scene, p)
    plan = with_model(plan, found.model)
    scene = plan.objective.scene
    candidates, costs = [parameters(before, flags=scene), found.p], [plan.cost, np.inf]
    with suppress(interrupts.OutOfTime), interrupts.grace(MOMENT):
        costs = [min(cost, plan.objective.cost_or_infinity(each)) for cost, each in zip(costs, candidates, strict=True)]
    best = int(np.argmin(costs))
    return replace(
        plan, p=candidates[best], cost=costs[best], settled=False, wanted=[found.model], judged=found.judged,
        evaluations=plan.evaluations + found.evaluations,
    )  # fmt: skip


def in_windows(whole: Objective, frames: int) -> Objective:
    """The objective over windows of so many frames each after the one that they begin with. Raises InvalidInput where
    something of a scene depends on when it began, or a target shows no state.
    """
    found = [window for each in whole.experiments for window in windows_of(each, frames)]
    return whole.against(whole.scene, found, [each.scene.frames for each in found])


def with_whole(found: Fit, whole: Objective) -> Fit:
    """The fit with its error over whole motions from their start; infinite where one diverges."""
    return replace(found, whole=holdout.error_of(whole, parameters(found.scene, whole.scene)))


def windows_of(given: Experiment, frames: int) -> list[Experiment]:
    """The windows of one target."""
    motion, scene = given
    check(scene)
    step, part = frame_places(motion, scene.delta)
    last = int(np.searchsorted(step + part, scene.frames - 1, side="right")) - 1
    starts = starts_of(motion, scene, frames, last)
    if last > frames and not starts:
        raise InvalidInput(
            f"{motion.name}: windows: no three frames one after the other show all vertices, as a window needs to "
            "begin in one; leave this out"
        )
    found = [first_window(given, starts[0] if starts else last)]
    for start, end in zip(starts, [*starts[1:], last], strict=True):
        if end > start:
            found.append(window(given, start, end))
    return found


def check(scene: Scene) -> None:
    """Raise InvalidInput where a scene cannot begin in another state."""
    fitted = [scene.cloths[cloth] for cloth in fitted_cloths(scene)]
    keyed = any(each is not None for each in (scene.wind_keys, scene.gravity_keys, scene.frame))
    moved = any(each.position or each.rotation or (each.body and each.body.motion) for each in scene.colliders)
    if keyed or moved or any(cloth.pins for cloth in fitted):
        raise InvalidInput(f"{scene.name}: windows: nothing of the scene may change over time, but its inputs do")
    if any(cloth.mode("velocity") != "n" for cloth in fitted):
        raise InvalidInput(f"{scene.name}: windows: the velocities at the start are fitted, which only the first shows")
    if any(cloth.mode("rest") == "G" for cloth in fitted):
        raise InvalidInput(f"{scene.name}: windows: mode G of rest lengths is relative to those at the start; use F")


def starts_of(motion: Motion, scene: Scene, frames: int, last: int) -> list[int]:
    """Frames at which windows begin after the first one: every so many, or the next that shows a state."""
    free = np.concatenate([~held for held in still(scene)])
    whole = np.asarray(motion.seen()[:, free].all(axis=1))
    shows = np.flatnonzero(whole[:-2] & whole[1:-1] & whole[2:]) + 1
    found, at = list[int](), frames
    while True:
        later = shows[(shows >= at) & (shows < last)]
        if not len(later):
            return found
        found.append(int(later[0]))
        at = found[-1] + frames


def still(scene: Scene) -> list[Flags]:
    """Which vertices (n,) of each cloth keep the state that the scene gives them: held ones, and all of a cloth that is
    not fitted.
    """
    fitted = fitted_cloths(scene)
    return [cloth.fixed | (i not in fitted) for i, cloth in enumerate(scene.cloths)]


def first_window(given: Experiment, end: int) -> Experiment:
    """The first window of a target, up to the frame `end`."""
    return whole_of(at_frames(given.motion, slice(end + 1)), given.scene)


def window(given: Experiment, start: int, end: int) -> Experiment:
    """The window of a target from one frame to another."""
    motion, scene = given
    cut = at_frames(motion, slice(start, end + 1))
    cut = replace(cut, times=cut.times - motion.times[start])
    before, after = start - 1, start + 1
    around = (motion.positions[after] - motion.positions[before]) / (motion.times[after] - motion.times[before])
    ends, cloths = np.cumsum(scene.vertex_counts)[:-1], list[Cloth]()
    states = zip(still(scene), np.split(motion.positions[start], ends), np.split(around, ends), strict=True)
    for cloth, (held, x, v) in zip(scene.cloths, states, strict=True):
        x, v = (np.where(held[:, None], *each) for each in ((cloth.positions, x), (cloth.velocity, v)))
        cloths.append(replace(cloth, positions=x, velocity=v))
    return whole_of(cut, replace(scene, cloths=tuple(cloths), main=scene.main or scene))


def whole_of(motion: Motion, scene: Scene) -> Experiment:
    """A motion, and as many frames of the scene as reach its last one; factors multiply the values of its main one."""
    frames = ceil(float(motion.times[-1]) / scene.delta - TIME_SLACK) + 1
    return Experiment(motion, replace(scene, frames=frames, main=scene.main or scene))
