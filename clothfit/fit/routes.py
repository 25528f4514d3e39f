"""The routes of a fit: what it may try, in which order, and where each applies.

`CHOICES` settle what is fitted: the start, the time step, the kinds and the model. `ROUTES` then fit it. Each is given
the best values so far and the time that is left, and leaves better ones in the search; the first of `ROUTES` that has a
status to return ends the search. Each trial is a visit of the search, so the result is never worse than the best of
them.

1. The momentum fit, where the target shows whole successive frames; it is exact where the target is.
2. One value for a whole cloth: a scan over the bounds, for the global minimum.
3. Otherwise the trajectory fit (`trajectory_fit`), from the best of the start, a uniform fabric and equal values; or
   from a momentum fit that is exact but for the rounding of a file. One that is not is no such start: its motion may be
   near, but noise has scattered its values.
4. From coarse to fine (`hierarchy`), where a choice of the step, or the first windows of 3, show that no values
   reproduce the target. `WITH_TIME_LEFT` then goes on.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from contextlib import suppress
from dataclasses import dataclass, field
from functools import partial
from typing import NamedTuple

import numpy as np

from clothfit.base import interrupts, threads
from clothfit.base.arrays import Array
from clothfit.base.errors import InvalidInput
from clothfit.base.limits import FIT_TOLERANCE
from clothfit.fit import auto, continuation, few_values, frame_blocks, hierarchy, holdout, step_choice
from clothfit.fit.continuation import with_substeps
from clothfit.fit.few_values import FEW_VALUES
from clothfit.fit.holdout import Judged
from clothfit.fit.options import AUTO, LONGEST, LONGEST_KEYED, Request
from clothfit.fit.preparation import counts_of
from clothfit.fit.start import choose_start, first_point, other_starts, start_warnings, values_by
from clothfit.fit.step_choice import Step, Trial
from clothfit.fit.trajectory_fit import (
    ModelDiffers,
    best_prior,
    by_gauss_newton,
    first_frames,
    go_on,
    is_far,
    is_near,
)
from clothfit.motion.divergence import Diverged
from clothfit.objective.objective import Objective
from clothfit.objective.target import sample
from clothfit.optimise import momentum
from clothfit.optimise.checkpoint import Checkpoint, State
from clothfit.optimise.scipy_methods import METHODS, minimise
from clothfit.optimise.search import Search
from clothfit.optimise.status import Budget, Status, Stop
from clothfit.scene.block import Block
from clothfit.scene.fit_vector import of_kinds, parameters, with_parameters
from clothfit.scene.kinds import KIND, REST
from clothfit.scene.scene import Scene

BENDINGS = np.exp(0.2375 * np.array([0, *(sign * i for i in range(1, 9) for sign in (-1, 1))])).tolist()
"""Factors on the bending of the start of a cloth at rest that are tried, 0.15 to 6.7: each has folds of its own."""

CLOSER = np.exp(0.03 * np.array([-4, -3, -2, -1, 1, 2, 3, 4])).tolist()
"""Factors on the best of them that are tried then: a few percent change the folds."""

APART, BEST = 1.1, 3
"""Factor between bendings that count as others, and how many a search goes on from."""

SMOOTH, SURE = 3, 2.0
"""Degree of the polynomial in the logarithm of bending that shadows grow by, and standard deviations from it that folds
may scatter them by.
"""

SCATTERED = (
    "folds scatter the coefficient, so it may be that of {} to {} times this bending; an outline, or a finer mesh, "
    "says more"
)

FABRICS = 0.2
"""Standard deviation of the logarithms of factors around those of a fabric, where a shadow alone shows them."""

CHOICE = 0.7
"""Share of the time of a fit that the choice of its model may take, with that of the step."""

UNLIKE = 0.02
"""Error relative to how far the target moves above which the time that is left is used."""

FEWEST, PART = "F", 0.5
"""The model that a fit that chooses by itself begins with, and the share of its time that this may take, as long as it
reproduces the first frames.
"""

ALIKE_MOTION = 1e-4
"""Error relative to how far the target moves that the rounding of files may leave."""

COST_SECONDS = 0.5
"""Seconds for the costs of the values that were found, where the time is up."""

ALIKE = "some values change the motion too alike to be told apart; fit fewer of them (--model F), or give a --prior"
"""What is said where equations of a fit have no solution."""

SOLVED_AS = (
    "the cloth buckles, and how it does depends on how its linear systems are solved: the target shows them solved to "
    "{:g}, so the fit has the same"
)
"""What is said of a fit to a target that was solved less accurately than fits are."""


@dataclass
class Fitting:
    """A fit under way: what its routes are given, and what they have found."""

    search: Search  # by what was chosen so far, with the best values
    options: Request
    start: float | Array | Scene | None  # that the user gives
    twin: bool = False  # whether the scene's own values are the truth, which the fit may not know
    kept_out: Objective | None = None
    checkpoint: Checkpoint | None = None
    state: State | None = None  # that it goes on from
    known: bool = False  # whether values were found beside those of the user
    step: tuple[int, int] | None = None  # steps to a frame and the method that were chosen; None: the scene's own
    model: str = ""  # that was chosen
    left_out: Sequence[str] = ()  # kinds that are not fitted
    tried: tuple[Step, ...] = ()  # time steps
    kinds: Sequence[frame_blocks.Choice] = ()  # what was found of them
    notes: Sequence[str] = ()  # on what was chosen
    chaotic: int = 0  # steps from which on rounding decides how the cloth moves; 0: it does not
    few: Few | None = None  # values of few kinds that do not explain the target
    judged: list[Judged] | None = None  # the models among which one was chosen
    wanted: list[str] | None = None  # models that are left to try, where no values reproduce the target
    as_it_is: float = np.inf  # cost of the scene's own values, where equal ones are fitted
    exact: list[Array] = field(default_factory=list)  # momentum fits (P,), the best last
    centre: Array = field(default_factory=lambda: np.zeros(0))  # (P,), around which values scatter

    def __post_init__(self) -> None:
        self.own, self.tau = self.search.objective, self.options.prior_width()
        self.first = self.search.start  # (P,), of the scene's own flags

    @property
    def has_result(self) -> bool:
        """Whether there are values yet, of all kinds or of few."""
        return bool(np.isfinite(min(self.search.best.cost, self.few.cost if self.few else np.inf)))

    @classmethod
    def of(
        cls, objective: Objective, start: float | Array | Scene | None, options: Request, twin: bool,
        kept_out: Objective | None = None, checkpoint: Checkpoint | None = None, state: State | None = None,
    ) -> Fitting:  # fmt: skip
        """The fit of an objective, with its time. Raises InvalidInput where a start is none."""
        first = parameters(objective.scene) if twin else choose_start(objective, start, twin)
        search = Search(objective, first, options.rmse_tolerance, options.max_evaluations, options.observer.progress)
        search.own = twin
        if options.tolerance == FIT_TOLERANCE < objective.scene.tolerance and objective.tolerance == FIT_TOLERANCE:
            search.loose_tolerance = objective.scene.tolerance
        longest = LONGEST if objective.scene.mode("gusts") == "n" else LONGEST_KEYED
        search.longest = longest if options.time_limit is None else np.inf
        return cls(search, options, start, twin, kept_out, checkpoint, state)

    @property
    def counts(self) -> Sequence[int]:
        """Numbers of BDF2 steps to a frame that are to be tried."""
        return [] if self.twin or self.state else counts_of(self.options, self.own.scene)

    def like(self, other: Objective | None) -> Objective | None:
        """Another objective with all that was chosen, the tolerance as well."""
        return None if other is None else self.by(self.step, other)

    def by(self, step: tuple[int, int] | None, other: Objective) -> Objective:
        """The same with another step; None for its own."""
        if step:
            other = with_substeps(other, *step)
        if self.left_out:
            other = other.flagging(frame_blocks.without(other.scene, self.first, self.left_out))
        if self.model:
            other = other.flagging(hierarchy.as_model(other.scene, self.model, exactly=True))
        tolerance = self.search.objective.tolerance
        return other if other.tolerance == tolerance else other.until(other.steps + 1, tolerance)

    def adopt(self, objective: Objective, p: Array, cost: float = np.inf) -> None:
        """Go on with another objective, from values p (P,) of that cost."""
        before = self.search
        origin = values_by(with_parameters(before.objective.scene, before.origin), flags=objective.scene)
        self.search = before.subsearch(objective, p, cost)
        self.search.origin, self.search.loose_tolerance = origin, before.loose_tolerance

    def keep(self) -> None:
        """Let the search keep its state from now on."""
        search = self.search
        search.checkpoint, search.model, search.left_out = self.checkpoint, self.model, self.left_out
        search.substeps, search.integrator = self.step or (0, 0)
        search.origin = search.start if self.twin else search.origin
        search.progress.p = search.best.p  # choices have other parameters


class Route(NamedTuple):
    """A way to settle something of a fit, or to fit."""

    name: str
    applies: Callable[[Fitting], bool]
    run: Callable[[Fitting], Status | None]  # the status, where it ends the fit; raises Stop


def through_routes(fit: Fitting) -> Status:
    """Take the routes of a fit; returns how it ended. Raises Stop."""
    for choice in CHOICES:
        if choice.applies(fit):
            choice.run(fit)
    fit.keep()
    status = next(filter(None, (route.run(fit) for route in ROUTES if route.applies(fit))))
    for route in WITH_TIME_LEFT:
        if route.applies(fit):
            status = route.run(fit) or status
    hierarchy.warn_where_late(fit.search, status)
    return status


def by_routes(fit: Fitting) -> Status:
    """Search until it or the user ends it; returns the status."""
    try:
        with threads.single(), interrupts.heard():
            status = through_routes(fit)
    except Stop as stop:
        status = stop.status
    except interrupts.OutOfTime:
        status = Status.LIMIT
        if not fit.has_result:
            with interrupts.grace(np.inf), suppress(Stop):  # which may be there already
                fit.search.visit(fit.search.start)
            fit.search.warn("the time was used up before the first step, so the values are those of the start")
    except KeyboardInterrupt:
        if not fit.has_result:
            raise
        interrupts.request()
        interrupts.answer()
        status = Status.INTERRUPTED
    except (Diverged, MemoryError, np.linalg.LinAlgError) as error:
        if not fit.has_result:
            raise
        fit.search.warn(f"the search ended early: {in_words(error)}")
        status = Status.STALLED
    if fit.few and fit.few.cost < fit.search.best.cost:
        fit.kinds, fit.step, fit.judged, fit.tried = (), None, None, ()
        with_few(fit, fit.few)
        fit.keep()
        status = Status.STALLED if status == Status.CONVERGED else status
    return fit.search.finish(status)


def in_words(error: Exception) -> str:
    """Why something ended, in the user's terms."""
    return ALIKE if isinstance(error, np.linalg.LinAlgError) else str(error) or "out of memory"


# --- what is fitted


def with_given_step(fit: Fitting) -> None:
    """As many steps to a frame as the user asks for."""
    assert isinstance(fit.options.substeps, int)
    fit.adopt(with_substeps(fit.own, fit.options.substeps, None), fit.first)


def as_before(fit: Fitting) -> None:
    """What a fit had chosen that goes on. Raises InvalidInput where that does not fit."""
    state = fit.state
    assert state is not None
    fit.step = (state.substeps, state.integrator) if state.substeps else None
    fit.left_out, fit.model = state.left_out, state.model
    objective = fit.by(fit.step, fit.own)
    if len(parameters(objective.scene)) != len(state.best):
        raise InvalidInput("the checkpoint is not what a fit has written; begin anew, without --resume")
    fit.adopt(objective, state.start)
    fit.search.restore(state)


class Few(NamedTuple):
    """What one factor on stiffnesses, damping, and some others alone have come to."""

    objective: Objective
    p: Array  # (P′,)
    start: Array  # (P,), which has the rest
    others: Sequence[str]
    cost: float  # there, over all frames
    explains: bool  # the target, but for noise or rounding, or what a motion makes of that at its end
    chaotic: int = 0  # steps that they reproduce before rounding decides


def by_few_kinds(fit: Fitting) -> None:
    """One factor on stiffnesses, and damping, where these alone reproduce the target but for noise or rounding: with
    more values a motion has more minima. The friction is that of the scene, else none, else one value that is fitted;
    the wind that of the scene, else fitted. What comes nearest is kept, in case other kinds end farther away.
    """
    scene, found, began = fit.search.objective.scene, list[Few](), fit.search.progress.computing
    smooth = parameters(with_parameters(scene, fit.first))
    smooth[of_kinds(scene, ("friction",))] = 0.0
    tried: list[tuple[Array, Sequence[str]]] = [(fit.first, ())]
    tried += [(smooth, ()), (fit.first, ("friction",))] if scene.laws else []
    tried += [(fit.first, ("wind",))] if any(cloth.feels_air for cloth in scene.cloths) else []
    for start, others in tried:
        found.append(by_few(fit, start, others))
        fit.few = min(found, key=lambda each: each.cost)
        if found[-1].explains:
            break
    best = max(found, key=lambda each: (each.explains, each.chaotic))
    if best.explains or best.chaotic:
        fit.few = None
        with_few(fit, best)
    else:
        fit.search.longest += fit.search.progress.computing - began  # which is no time of other kinds


def with_few(fit: Fitting, best: Few) -> None:
    """Go on with few kinds alone."""
    known = " and ".join(["the damping", *(KIND[kind].title for kind in best.others)])
    known += "" if np.array_equal(best.start, fit.first) else ", without friction"
    what = "the target" if best.explains else "more of the target than all that was tried beside them"
    what += "; nothing else is fitted"
    if best.chaotic:
        what = f"the target's first {best.chaotic} steps; {few_values.TEXT}"
    fit.notes = [f"one factor on the stiffnesses, and {known}, reproduce {what}"]
    fit.adopt(best.objective, best.p, best.cost)
    fit.left_out = tuple(kind for kind in ("drag", *frame_blocks.CHOSEN) if kind not in best.others)
    fit.first, fit.model, fit.known, fit.chaotic = best.start, FEWEST, True, best.chaotic


def by_few(fit: Fitting, start: Array, others: Sequence[str]) -> Few:
    """What few values come to, the rest as in the `start` (P,)."""
    whole = fit.search.objective
    fewer = whole.flagging(of_few_kinds(whole.scene, start, others))
    search = fit.search.subsearch(fewer, parameters(fewer.scene), np.inf)
    search.longest = PART * (LONGEST if fit.options.time_limit is None else fit.options.time_limit)
    trial, exact = Trial(search), list[tuple[Objective, Array]]()
    trial.run(lambda own: step_choice.by_exact_windows(own, exact))
    near = search.best.cost <= ALIKE_MOTION**2 * whole.cost_at_rest
    there = np.isfinite(search.best.cost) and not trial.ended
    explains = bool(near or (there and (step_choice.is_whole(exact, fewer) or step_choice.leaves_noise(search))))
    chaotic = 0 if explains or interrupts.requested() else few_values.steps_before_chaos(fewer, exact)
    p = exact[-1][1] if chaotic else search.best.p
    cost = fewer.cost_or_infinity(p) if chaotic else search.best.cost
    return Few(fewer, p, start, others, cost, explains, chaotic)


def of_few_kinds(scene: Scene, start: Array, others: Sequence[str] = ()) -> Scene:
    """The scene with one factor on stiffnesses, damping and some `others` fitted, the rest as in the `start` (P,)."""
    gone = tuple(kind for kind in ("drag", *frame_blocks.CHOSEN) if kind not in others)
    return hierarchy.as_model(frame_blocks.without(scene, start, gone), FEWEST, exactly=True)


def with_best_step(fit: Fitting) -> None:
    """The step that gains most."""
    root = fit.search.subsearch(fit.search.objective, fit.search.start, np.inf)
    root.budget, before = Budget(step_choice.EVALUATIONS), fit.search.budget.evaluations
    root.budget.extra = before  # what is reported goes on from there
    stepped = step_choice.chosen(root, fit.counts, fit.own, fit.options.model != AUTO)
    fit.search.budget.extra += root.budget.evaluations - before
    fit.search.own, fit.search.single = root.own, root.single
    fit.step, fit.tried, fit.known = stepped.step, stepped.tried, True
    fit.adopt(stepped.objective, stepped.p, stepped.cost)
    fit.wanted = None if stepped.leaves_noise else hierarchy.remaining_models(stepped.objective.scene)


def without_kinds(fit: Fitting) -> None:
    """No kinds that take the fit farther from frames kept out."""
    trial, known = Trial(fit.search), list[tuple[list[frame_blocks.Choice], Array]]()
    part = hierarchy.subproblem(fit.search, hierarchy.models(fit.search.objective.scene)[0], fit.search.best.p)
    trial.run(lambda _: known.append(frame_blocks.needed(part)))
    fit.kinds, values = known[0] if known else ([], part.best.p)
    if gone := frame_blocks.left_out(fit.kinds):
        fewer = frame_blocks.without(fit.search.objective.scene, fit.first, gone)
        p = hierarchy.as_whole(part, values, fewer)
        fit.adopt(fit.search.objective.flagging(fewer), p)
        fit.left_out = gone
        Trial(fit.search).run(lambda search: search.visit(p))


def with_best_model(fit: Fitting) -> None:
    """The smallest model that no finer one beats on what it has not seen, of those that begin in time."""
    search, options = fit.search, fit.options
    longest = np.inf if options.time_limit is not None else CHOICE * LONGEST - search.progress.computing
    found = holdout.chosen(
        search.objective, fit.like(fit.kept_out), search.best.p, options.rmse_tolerance, options.holdout_of,
        options.max_evaluations, longest, fitted=bool(fit.tried),
    )  # fmt: skip
    before, cost = with_parameters(search.objective.scene, search.best.p), search.best.cost
    scene = hierarchy.as_model(search.objective.scene, found.model, exactly=True)
    objective = search.objective.flagging(scene)
    candidates, costs = [parameters(before, flags=scene), found.p], [cost, np.inf]
    with suppress(interrupts.OutOfTime), interrupts.grace(COST_SECONDS):
        costs = [min(cost, objective.cost_or_infinity(each)) for cost, each in zip(costs, candidates, strict=True)]
    best = int(np.argmin(costs))
    search.budget.extra += found.evaluations
    fit.adopt(objective, candidates[best], costs[best])
    fit.model, fit.judged, fit.wanted, fit.known = found.model, found.judged, [found.model], True


def from_first_point(fit: Fitting) -> None:
    """The first point of the method, where nothing better is known."""
    p, cost, warnings = first_point(fit.search.objective, fit.start, fit.twin, fit.options.method)
    fit.adopt(fit.search.objective, p, cost)
    fit.search.warn(*warnings)


def cost_of_the_pattern(fit: Fitting) -> None:
    """The cost of the scene as it is where one value for all (G) flattens its pattern."""
    scene = fit.search.objective.scene
    flat = any(
        block.mode == "G" and block.kind.log and block.cloth is not None
        and len(np.unique(getattr(scene.cloths[block.cloth], block.name))) > 1
        for block in scene.blocks
    )  # fmt: skip
    if flat:
        kept = fit.search.objective.flagging(hierarchy.as_model(scene, "F", exactly=True))
        fit.as_it_is = kept.cost_or_infinity(parameters(kept.scene))


CHOICES = (
    Route("as before", lambda fit: fit.state is not None, as_before),
    Route("asked step", lambda fit: not (fit.twin or fit.state) and isinstance(fit.options.substeps, int),
          with_given_step),
    Route("few kinds",
          lambda fit: fit.options.auto and not (fit.twin or fit.state or fit.options.windows)
          and fit.options.model in (None, AUTO) and fit.options.method == AUTO,
          by_few_kinds),
    Route("time step", lambda fit: bool(fit.counts) and not fit.model, with_best_step),
    Route("kinds", lambda fit: fit.options.auto and fit.wanted is not None, without_kinds),
    Route("model", lambda fit: fit.options.model == AUTO and not (fit.twin or fit.state or fit.model),
          with_best_model),
    Route("start", lambda fit: not (fit.known or fit.state), from_first_point),
    Route("known start", lambda fit: fit.known,
          lambda fit: fit.search.warn(*start_warnings(fit.search.objective, fit.search.start))),
    Route("pattern", lambda fit: fit.start is None and not fit.twin, cost_of_the_pattern),
)  # fmt: skip
"""What a fit settles before, one after the other."""


# --- the fit


def by_momentum_alone(fit: Fitting) -> Status:
    """The momentum fit."""
    if not momentum.fits(fit.search.objective):
        raise InvalidInput("memory: too little for the balance of momentum; use another method, or allow more")
    auto.by_momentum(fit.search, fit.search.start)
    return fit.search.verdict()


def as_it_ended(fit: Fitting) -> Status:
    """Not repeated."""
    assert fit.state is not None
    assert fit.state.status is not None
    fit.search.best.found_with(best_prior(fit.search, fit.state, fit.tau))
    return fit.state.status


def was_descending(fit: Fitting) -> bool:
    """Whether a fit goes on that was in a stage of Gauss–Newton."""
    return fit.state is not None and len(fit.state.before) > 0 and not auto.one_value_each(fit.search)


def going_on(fit: Fitting) -> Status | None:
    """Gauss–Newton from where it was."""
    assert fit.state is not None
    try:
        return go_on(fit.search, fit.state, fit.tau, watched=fit.options.method != "gauss-newton")
    except ModelDiffers:
        fit.wanted = models_left(fit.search, fit.state) if fit.state.rungs else None
        return auto.by_hierarchy(fit.search, fit.tau, [fit.search.start], fit.wanted)


def models_left(search: Search, state: State) -> list[str]:
    """The models of a hierarchy that a fit has not finished which goes on from a `state`; it has one alone where that
    was chosen.
    """
    done = {level.model for level in state.rungs}
    every = [state.model] if state.model else hierarchy.models(search.objective.scene)
    return [model for model in every if model not in done]


def by_models_left(fit: Fitting) -> Status:
    """From coarse to fine, from the best values."""
    wanted = fit.wanted if fit.wanted is not None or fit.state is None else models_left(fit.search, fit.state)
    return auto.by_hierarchy(fit.search, fit.tau, [], wanted)


def by_balances(fit: Fitting) -> None:
    """The momentum fits, where the balances can hold."""
    search, start = fit.search, fit.search.start
    if search.proven or (auto.is_exact(search) and auto.too_many(search)):
        fit.exact = [search.best.p]
        return
    early, balances = first_frames(search.objective), momentum.Momentum(search.objective, start, search.fitted)
    if not auto.balances_can_hold(search, balances, early):
        return
    try:
        fit.exact = auto.by_momentum(search, start, auto.treatments(search), early, balances)
    except auto.SolvedLoosely as loose:
        fit.adopt(search.objective.until(search.objective.steps + 1, loose.tolerance), loose.p)
        fit.keep()
        fit.search.loose_tolerance, fit.known = None, True
        fit.search.warn(SOLVED_AS.format(loose.tolerance))
        by_balances(fit)


def by_scan(fit: Fitting) -> Status:
    """The exact minimum of a momentum fit, or the best points of a scan."""
    search = fit.search
    if fit.exact and not is_far(search):
        status = by_gauss_newton(search, search.best.p, search.best.p, fit.tau, windows=False)
        if is_near(search):
            return status
    return auto.by_scan(search, search.start, fit.tau)


def around_the_best_guess(fit: Fitting) -> None:
    """The centre of a prior: the start or other values, whichever cost least over the first frames."""
    search = fit.search
    search.enter("starts")
    guesses = [search.start]
    if not (fit.known or is_near(search, search.visit(search.start))):
        others = other_starts(search.objective, search.start, fit.twin, fit.start is not None)
        guesses += [np.where(search.fitted, p, search.start) for p in others]
    fit.centre = min(guesses, key=partial(search.measure, objective=first_frames(search.objective)))


def by_few_values(fit: Fitting) -> Status:
    """From coarse to fine, from the start and the centre."""
    start = fit.search.start
    return auto.by_hierarchy(fit.search, fit.tau, [start] if fit.centre is start else [start, fit.centre])


def has_few(fit: Fitting) -> bool:
    """Whether the fit is of few values, none of them of a single vertex or spring."""
    few = fit.search.fitted.sum() <= FEW_VALUES
    return bool(few and all(block.mode in "FGR" for block in fit.search.objective.blocks))


def by_single_values(fit: Fitting) -> Status | None:
    """Gauss–Newton by a prior; None where the model cannot reproduce the target."""
    found = auto.singly(fit.search, fit.centre, fit.centre, fit.tau)
    if found is not None and fit.exact and np.array_equal(fit.search.best.p, fit.exact[-1]):
        return from_the_best(fit)  # noisy as it is, it costs less
    return found


def is_accurate(fit: Fitting) -> bool:
    """Whether the best point leaves hardly anything or, where tracking a scan found it, nothing but noise: no other
    minimum is nearer.
    """
    tracked = fit.search.objective.scanned and step_choice.leaves_noise(fit.search)
    return tracked or (bool(fit.exact) and auto.is_accurate(fit.search))


def from_the_best(fit: Fitting) -> Status:
    """Gauss–Newton from the best point."""
    return by_gauss_newton(fit.search, fit.search.best.p, fit.centre, fit.tau)


def from_coarse_to_fine(fit: Fitting) -> Status:
    """All models, from the start."""
    return auto.by_hierarchy(fit.search, fit.tau, [fit.search.start])


# --- with the time that is left


def is_unlike(fit: Fitting) -> bool:
    """Whether models from coarse to fine have left much, and time."""
    search = fit.search
    return bool(search.levels) and not search.is_late and search.best.cost > UNLIKE**2 * search.objective.cost_at_rest


def by_shorter_steps(fit: Fitting) -> Status | None:
    """The finest model by shorter steps, as long as that pays."""
    status = None
    while is_unlike(fit):
        before = fit.search.levels
        model = before[-1].model
        trial = step_choice.shorter(fit.search, model, fit.tried, fit.counts, partial(fit.by, other=fit.own))
        if trial is None:
            break
        fit.step, fit.tried = trial.chosen, (*fit.tried, trial.step)
        fit.adopt(trial.search.objective, trial.search.best.p, trial.search.best.cost)
        fit.search.levels = before[:-1]
        fit.keep()
        status = auto.by_hierarchy(fit.search, fit.tau, [], [model])
    return status


def from_other_points(fit: Fitting) -> Status:
    """The finest model from points around its end."""
    last = fit.search.levels[-1]
    hierarchy.hop(fit.search, last.model, last.seconds)
    return auto.ended(fit.search)


def throws_shadow(objective: Objective) -> bool:
    """Whether nothing but the shadows of cloths at rest is compared."""
    return objective.scene.method == REST and set(objective.weights) <= {"outline", "coverage"}


def by_shadow(fit: Fitting) -> Status:
    """Gauss–Newton from the best of many bending stiffnesses: with one far from the truth a drape has other folds, and
    its outline says little of the way.
    """
    search, bends = fit.search, np.concatenate([shares_of_bending(block) for block in fit.search.objective.blocks])

    def at(factor: float) -> Array:
        return np.asarray(search.coordinates.clipped(search.start * factor**bends))

    if "outline" in search.objective.weights:
        starts = best_bendings(lambda factor: search.visit(at(factor)))
    else:
        starts = [by_size(fit, at)]
    status = Status.CONVERGED
    for start in map(at, starts):
        search.objective.begin_at(start)
        status = by_gauss_newton(search, start, start, FABRICS if fit.tau is None else fit.tau)
    return status


def best_bendings(measure: Callable[[float], float]) -> list[float]:
    """Factors on the bending stiffness, the one with the least measure first, and others apart from it, of those that
    are tried before the time is up. All of them are: folds may be near the target's and yet be others.
    """
    found = dict[float, float]()
    with suppress(interrupts.OutOfTime):
        for stage in (lambda: BENDINGS, lambda: [min(found, key=found.__getitem__) * each for each in CLOSER]):
            for factor in stage():
                found[factor] = measure(factor)
    chosen = list[float]()
    for factor in sorted(found, key=found.__getitem__):
        if all(abs(np.log(factor / other)) > np.log(APART) for other in chosen):
            chosen.append(factor)
    return chosen[:BEST]


def by_size(fit: Fitting, at: Callable[[float], Array]) -> float:
    """The factor on the bending stiffness by which shadows become as large as those of the target, the largest such
    one, as below a cell the size hardly depends on it; says how far the scatter by folds leaves it open.
    """
    objective, sizes = fit.search.objective, dict[float, float]()
    with suppress(interrupts.OutOfTime):
        for factor in BENDINGS:
            if np.isfinite(fit.search.visit(at(factor))):
                shown = zip(objective.runs, objective.positions(at(factor)), strict=True)
                left = [run.comparison.residual_of(sample(run.comparison.goal, x)).sum() for run, x in shown]
                sizes[factor] = float(sum(left))
    if not sizes:
        return 1.0
    logs, off = np.array(sorted((np.log(factor), size) for factor, size in sizes.items())).T
    found = float(logs[np.abs(off).argmin()])
    if (crossed := np.flatnonzero(off[:-1] * off[1:] < 0.0)).size:
        k = int(crossed[-1])
        found = float(logs[k] - off[k] * (logs[k + 1] - logs[k]) / (off[k + 1] - off[k]))
    if len(logs) > 2 * SMOOTH:
        curve = np.polyfit(logs, off, SMOOTH)
        scatter = np.sqrt(((off - np.polyval(curve, logs)) ** 2).sum() / (len(logs) - SMOOTH - 1))
        tried = np.linspace(logs[0], logs[-1], 500)
        open_to = np.append(tried[np.abs(np.polyval(curve, tried)) <= SURE * scatter], found)
        fit.search.warn(SCATTERED.format(*(f"{np.exp(end - found):.2g}" for end in (open_to.min(), open_to.max()))))
    return float(np.exp(found))


def shares_of_bending(block: Block) -> Array:
    """Which factors (count,) of a block, 1 or 0, are on the stiffness of bending springs, or of all."""
    if block.name != "stiffness" or block.factors is None:
        return np.zeros(block.count)
    own = [float(name == "all" or name.startswith("bending")) for name in block.factors.names]
    return np.repeat(own, block.factors.modes)


ROUTES = (
    Route("as it ended",
          lambda fit: fit.state is not None and fit.state.status in (Status.CONVERGED, Status.STALLED), as_it_ended),
    Route("nothing to fit", lambda fit: bool(fit.chaotic) or not fit.search.fitted.any(),
          lambda fit: auto.ended(fit.search)),
    Route("SciPy", lambda fit: fit.options.method in METHODS, lambda fit: minimise(fit.search, fit.options.method)),
    Route("momentum alone", lambda fit: fit.options.method == "momentum", by_momentum_alone),
    Route("going on", was_descending, going_on),
    Route("shadow", lambda fit: fit.options.method == "gauss-newton" and throws_shadow(fit.search.objective),
          by_shadow),
    Route("Gauss–Newton alone", lambda fit: fit.options.method == "gauss-newton",
          lambda fit: by_gauss_newton(fit.search, fit.search.start, fit.search.start, fit.tau)),
    Route("models left", lambda fit: fit.wanted is not None or bool(fit.state and fit.state.rungs), by_models_left),
    Route("balances of momentum", lambda fit: not fit.search.objective.scanned, by_balances),
    Route("single steps", lambda fit: fit.search.proven is not None, lambda fit: Status.CONVERGED),
    Route("scan", lambda fit: auto.one_value_each(fit.search), by_scan),
    Route("exact balances", lambda fit: auto.too_many(fit.search) and bool(fit.exact) and auto.is_exact(fit.search),
          lambda fit: Status.CONVERGED),
    Route("too many for a matrix", lambda fit: auto.too_many(fit.search), from_coarse_to_fine),
    Route("best guess", lambda fit: True, around_the_best_guess),
    Route("accurate start", is_accurate, from_the_best),
    Route("few values", has_few, by_few_values),
    Route("single values", lambda fit: True, by_single_values),
    Route("coarse to fine", lambda fit: True, from_coarse_to_fine),
)  # fmt: skip
"""How the values are found: the first that returns a status ends the fit."""

WITH_TIME_LEFT = (
    Route("shorter steps", lambda fit: bool(fit.counts and fit.tried) and is_unlike(fit), by_shorter_steps),
    Route("other points", lambda fit: is_unlike(fit) and continuation.can_nudge(fit.search.objective),
          from_other_points),
)  # fmt: skip
"""What is tried after that, where models from coarse to fine have not come to the target."""
