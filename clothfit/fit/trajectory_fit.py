"""The trajectory fit by stages: Gauss–Newton from a start, on the first frames, on more and more, and at last on all.

Near the start of a motion the cost is smooth in the parameters; later that of a windy cloth is chaotic. Stages before
the last one solve the linear systems loosely and end early. Each stage uses the dense model where that is small enough,
else the matrix-free method, else L-BFGS-B.

Where what a window finds makes the next longer one worse, small differences grow along it: a compressed cloth buckles
one way or the other, and its steps switch their form. Then springs pull the whole motion to its target, strongly, and
then weakly (`NUDGES`): such a motion forgets what was wrong before, and hardly ever takes another form than its target.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from clothfit.base.arrays import Array
from clothfit.base.errors import InvalidInput
from clothfit.fit.continuation import StepLimit, can_nudge, nudged
from clothfit.fit.step_forms import Held, through_forms
from clothfit.motion.divergence import Diverged
from clothfit.objective.comparison import WHOLE
from clothfit.objective.objective import Objective
from clothfit.objective.whiteness import residual_test
from clothfit.optimise import matrix_free, scipy_methods
from clothfit.optimise.checkpoint import State
from clothfit.optimise.gauss_newton import PATIENT, SMALL_GAIN, Model, Patience, minimise
from clothfit.optimise.prior import FIRST_TAU, Prior, none
from clothfit.optimise.search import SAME_POINT, Descent, Search
from clothfit.optimise.status import Status
from clothfit.optimise.trajectory import LARGEST, Trajectory

NEAR_ERROR = 2e-3
"""Error relative to how far the target moves, below which all frames are fitted at once."""

FAR_ERROR = 0.05
"""Error relative to how far the target moves, above which the model cannot reproduce it: the fit ends there. Nearer, a
last stage with the fit's own tolerance goes to the very minimum.
"""

UNLIKE, MOSTLY = 0.01, 0.5
"""Error of a window relative to how far the target moves in it, above which the model may differ, and the share of its
squares that is no noise, above which it does.
"""

FIRST_WINDOW, WINDOW_GROWTH = 10, 2
"""Frames of the first window after the first that shows something, and the ratio of one window to the one before."""

WINDOW_ITERATIONS, WHOLE_ITERATIONS = 8, 200
"""Iterations of Gauss–Newton in each window, and where all frames are fitted."""

WINDOW_SAVING, LOOSE_SAVING = 1e-3, 1e-4
"""A window, and a loose stage of all frames, end where a step would save less than this fraction of the cost."""

NOISE_SAVING = 0.3
"""… or, of Q values and N residuals, less than the fraction Q / N, which is what they save where all is noise, up to
this: a window is not followed below its noise.
"""

STAGE_TOLERANCE = 1e-5
"""Of the linear systems before the last stage: its error is far below that of the motion."""

LONG_POSITIONS = 100_000
"""Compared positions from which on a fit saves time: it tries the balances of momentum on a few frames before it solves
those of all, has looser stages before the last one, and ends early where the motion stays far from its target.
"""

NUDGES, NUDGED_ITERATIONS = (3.0, 0.3), 12
"""ω of the springs that pull motions to their target, in radians per frame, one after the other; and the iterations of
Gauss–Newton with each.
"""

SAME_COST = 1e-3
"""Relative difference of costs at one minimum."""

TRIAL_FRAMES = 30
"""Steps after the first that shows something, in which a look finds whether single values may explain a target."""

TRIAL_SECONDS = 8.0
"""Seconds of computing that it may take. Where a model is right, Gauss–Newton comes to the noise of so few frames in a
few steps.
"""

STAGE_PATIENCE = Patience(4, 1e-2, 1e-3)
"""Of a long fit before its last stage."""


class Stage(NamedTuple):
    """Gauss–Newton over some frames, as well as is needed there."""

    objective: Objective
    least: float  # relative saving that ends it
    iterations: int
    patience: Patience


class ModelDiffers(Exception):
    """Ends Gauss–Newton in its windows: the model cannot reproduce what they show."""


def by_gauss_newton(
    search: Search, p: Array, centre: Array, tau: float | None, windows: bool = True, watched: bool = False
) -> Status:
    """Gauss–Newton from p (P,), in windows of more and more frames where p is far from the target; the prior is centred
    on `centre` (P,), its width `tau` is learned where None. Raises Stop, and ModelDiffers where it is `watched`.
    """
    search.enter("gauss-newton")
    cost = search.visit(p)
    near = is_near(search, cost) or (cost == search.best.cost and is_near_but_for_noise(search))
    every = Trajectory(search, search.objective)
    descent = Descent(every.prior(every.y(centre), tau), every.y(p), 0.0, 0, search.best.p, search.best.cost)
    return by_stages(search, descent, stages(search, near, windows), watched)


def go_on(search: Search, state: State, tau: float | None, watched: bool = False) -> Status:
    """Begin the stage anew in which a fit was ended, and go on from there; returns the status. Raises Stop, and
    ModelDiffers where it is `watched`.
    """
    prior = resumed_prior(search, state, tau)
    search.best.found_with(best_prior(search, state, tau))
    *found, last = stages(search, False, windows=True)
    last = last._replace(patience=last.patience._replace(flat=SMALL_GAIN))  # as no step may lower the cost
    left = [stage for stage in found if stage.objective.frames >= state.window and not state.radius] + [last]
    descent = Descent(prior, state.y, state.radius, state.window, state.before, state.before_cost)
    status = by_stages(search, descent, left, watched)
    centre = search.parameters(prior.centre)
    if np.array_equal(search.best.p, state.before) and not np.allclose(state.before, centre, rtol=1e-9):
        return by_gauss_newton(search, search.best.p, centre, tau)  # as `fit.routes` does
    return status


def resumed_prior(search: Search, state: State, tau: float | None) -> Prior:
    """The prior of a fit that was ended, with the widths that it had learned. Raises InvalidInput where they are of
    another number than the groups.
    """
    every = Trajectory(search, search.objective)
    prior = every.prior(state.centre, tau)
    if (len(state.centre), len(state.tau)) != (every.size, len(prior.tau)):
        raise InvalidInput("the checkpoint is not what a fit has written; begin anew, without --resume")
    return replace(prior, tau=state.tau)


def best_prior(search: Search, state: State, tau: float | None) -> Prior | None:
    """The prior that the best point of a fit was found with, which may be of a stage before the one that was ended.
    Raises as `resumed_prior`.
    """
    own = state._replace(centre=state.best_centre, tau=state.best_tau)
    return resumed_prior(search, own, tau) if len(own.centre) else None


class Route(NamedTuple):
    """Stages that are left, and where they begin."""

    stages: list[Stage]
    y: Array  # (Q,)
    prior: Prior
    learned: bool = False  # whether its widths were learned from all frames
    differs: bool = False  # whether more than noise was left where it was left


def by_stages(search: Search, descent: Descent, parts: Sequence[Stage], watched: bool = False) -> Status:
    """Gauss–Newton through all stages, and where they go astray through motions that are pulled; the best point of the
    search is never worse than before. Raises Stop, and ModelDiffers where it is `watched`.
    """
    routes, status = [Route(list(parts), descent.y, descent.prior)], Status.STALLED
    may_turn = bool(parts) and may_nudge(search)
    while routes:
        route, before, known = routes.pop(0), search.best.p, search.best.cost
        ended, y, remaining = along(search, descent, route, watched, may_turn)
        descent = descent._replace(radius=0.0, window=0)
        if search.best.p is not before or status == Status.STALLED:
            status = ended
        if remaining is not None:
            last, may_turn = [parts[-1]], False
            found = by_nudging(search, descent.prior) if not watched or may_leave_noise(search) else None
            if watched and found is None and remaining.differs:
                raise ModelDiffers
            routes = [Route(last, y, prior, learned=True) for y, prior in found or []]
            routes += [remaining] if remaining.stages else []
        elif routes:
            cost = search.measure(search.parameters(y))  # two routes may have come to one minimum
            if (np.isfinite(cost) and np.isclose(cost, known, rtol=SAME_COST, atol=0.0)) or leaves_noise(search):
                break
    search.best.descent = None
    return Status.STALLED if status == Status.CONVERGED and search.on_plateau() else status


def along(
    search: Search, descent: Descent, route: Route, watched: bool, may_turn: bool
) -> tuple[Status, Array, Route | None]:
    """The stages of a route; how the last one ended, where (Q,), and what is left of the route where it goes astray and
    `may_turn`: the next window is worse with what one finds, or more than noise is left. Raises as `by_stages`.

    Each stage begins with a prior that is wide again, but for one that has learned from all frames: where steps switch
    their form the residuals of the motion alone are no noise until it is near, so a wide one would not narrow.
    """
    best, y, prior, status = search.best, route.y, route.prior, Status.STALLED
    for number, stage in enumerate(route.stages):
        part, whole = Trajectory(search, stage.objective), stage.objective is search.objective
        resumed = descent.radius or descent.window == stage.objective.frames  # it began before its best point was found
        prior = prior if resumed or route.learned else prior.reopened()
        search.enter("gauss-newton", stage.objective)
        best.descent = descent._replace(prior=prior, y=y, window=stage.objective.frames)
        if not np.isfinite(part.cost(y)):
            break
        if not resumed:
            best.go_on(before=best.p, before_cost=best.cost)
        found, learned, status = fitted(part, stage, y, prior, descent.radius or None)
        descent = descent._replace(radius=0.0, window=0)
        better = whole or is_better(search, found, y, route.stages[number + 1].objective)
        if better:
            y, prior = found, learned
        late_there = search.is_late and status == Status.STALLED and not has_model(part)
        if not whole and stage.objective.steps == search.objective.steps and (late_there or is_far(search)):
            break
        late = len(route.stages) < 2 or stage is route.stages[-2]
        other = watched and not whole and has_model(part) and differs(stage, search.parameters(found), status, late)
        best.belief = None
        if may_turn and (other or not better or (whole and not is_near_but_for_noise(search))):
            return status, y, Route(list(route.stages[number + 1 :]), y, prior, differs=other or whole)
        if other:
            raise ModelDiffers
    if np.allclose(search.y, y, rtol=SAME_POINT):
        best.found_with(prior)
    return status, y, None


def fitted(
    part: Trajectory, stage: Stage, y: Array, prior: Prior, radius: float | None = None
) -> tuple[Array, Prior, Status]:
    """One stage from y (Q,), by the method that it is small enough for: the last point, the prior that it learned, and
    how it ended.
    """
    search, whole = part.search, part.objective is part.search.objective
    if has_model(part):
        problem, accepted = part.problem(stage.least, stage.patience), part.accepted if whole else part.passed
        model, prior, status = minimise(problem, y, prior, accepted, stage.iterations, radius)
        return model.y, prior, status
    if matrix_free.fits(part):
        search.enter("matrix-free", stage.objective)
        return matrix_free.minimise(part, y, prior, whole)
    search.warn("too little memory for the matrices of gauss-newton: l-bfgs-b took its place (--memory)")
    status = scipy_methods.minimise(search, "l-bfgs-b") if whole else Status.STALLED
    return (search.y if whole else y), none(part.size), status


def has_model(part: Trajectory) -> bool:
    """Whether a dense model of a trajectory is small enough."""
    return part.operations() <= LARGEST and part.fits()


def leaves_noise(search: Search) -> bool:
    """Whether what is left at the best point is noise."""
    return not beside_noise(search)


def beside_noise(search: Search) -> float:
    """The part of the cost at the best point that is no noise."""
    test = residual_test(search.objective, search.best.p)
    return 0.0 if test is None or test.is_noise else test.structured * search.best.cost


def by_nudging(search: Search, prior: Prior) -> list[tuple[Array, Prior]] | None:
    """Coordinates (Q,) that bring motions nearest to their target which springs pull there, more and more weakly, from
    the centre of a prior on, with the priors that were learned; those first with which the whole motion costs least
    without springs. None where more than noise is left with the strongest: the model cannot reproduce the target.
    Raises Stop.
    """
    prior = replace(prior, tau=(FIRST_TAU,) * len(prior.tau)) if prior.learns else prior  # a resumed fit has another
    y, ends = np.clip(prior.centre, *Trajectory(search, search.objective).bounds), list[tuple[float, Array, Prior]]()
    first = y, prior
    for omega in NUDGES:
        part = Trajectory(search, nudged(search.objective, omega))
        stage = Stage(part.objective, least_saving(search, part.objective), NUDGED_ITERATIONS, PATIENT)
        search.enter("nudging", stage.objective)
        if not np.isfinite(part.cost(y)):  # explicit steps are unstable with the stiffest springs
            continue
        y, prior, status = fitted(part, stage, y, prior)
        if not ends and differs(stage, search.parameters(y), status, True):
            return None
        ends.append((search.visit(search.parameters(y)), y, prior))
        held = with_forms(search, *first) if len(ends) == 1 else None
        if held is not None:
            ends.append((search.visit(search.parameters(held.y)), held.y, held.prior))
            if leaves_noise(search):
                return [(held.y, held.prior)]
    return [(y, prior) for _, y, prior in sorted(ends, key=lambda end: end[0])]


def with_forms(search: Search, y: Array, prior: Prior) -> Held | None:
    """Where a fit of motions whose steps have the forms that fit best comes to from y (Q,); None where all forms are
    plain, or none of their motions stays finite. Raises Stop.
    """

    def by_stage(objective: Objective, y: Array, prior: Prior, iterations: int) -> tuple[Array, Prior]:
        stage = Stage(objective, least_saving(search, objective), iterations, PATIENT)
        found, learned, _ = fitted(Trajectory(search, objective), stage, y, prior)
        return found, learned

    try:
        return through_forms(search, y, prior, by_stage)
    except Diverged:
        return None


def may_nudge(search: Search) -> bool:
    """Whether springs may pull the motions of a search to their target."""
    return can_nudge(search.objective) and not is_long(search)


def may_leave_noise(search: Search) -> bool:
    """Whether what single values leave of the first frames may be noise, where springs pull these to their target: what
    is wrong with a model shows there, what a motion makes of small differences does not. One that takes too long says
    no. Raises Stop.
    """
    if not may_nudge(search):
        return False
    frames = search.objective.first_step + TRIAL_FRAMES
    part = Trajectory(search, nudged(loosened(search.objective, frames), NUDGES[0]))
    problem, y = part.problem(least_saving(search, part.objective)), part.y(search.best.p)
    if not (has_model(part) and np.isfinite(part.cost(y))):
        return False
    search.enter("nudging", part.objective)
    began = search.progress.computing

    def accepted(prior: Prior, model: Model, radius: float) -> None:
        part.passed(prior, model, radius)
        if search.progress.computing - began > TRIAL_SECONDS:
            raise StepLimit

    try:
        model, _, _ = minimise(problem, y, part.prior(y, None), accepted, WINDOW_ITERATIONS)
    except StepLimit:
        return False
    test = residual_test(part.objective, search.parameters(model.y))
    return test is not None and test.is_noise


def is_better(search: Search, found: Array, before: Array, longer: Objective) -> bool:
    """Whether coordinates (Q,) that a part of the frames has `found` cost no more over the `longer` part that comes
    next than those `before`, which otherwise stay: of thousands of values few frames do not show how all go on.
    """
    search.enter("gauss-newton")
    search.visit(search.parameters(found))
    part = Trajectory(search, longer)
    return not part.cost(found) > part.cost(before)


def differs(stage: Stage, p: Array, status: Status, last: bool) -> bool:
    """Whether most of what the fit of a window leaves at p (P,) is no noise. One that has not converged says nothing,
    but for the `last` one.
    """
    part = stage.objective
    if not (last or status == Status.CONVERGED) or part.cost_or_infinity(p) <= UNLIKE**2 * part.cost_at_rest:
        return False
    test = residual_test(part, p)
    return test is not None and not test.is_noise and test.structured > MOSTLY


def stages(search: Search, near: bool, windows: bool) -> list[Stage]:
    """What is fitted one after the other, all frames last; in `windows` only where the start is not `near` the target.
    """
    objective, whole = search.objective, search.objective.steps + 1
    last = Stage(objective, 0.0, WHOLE_ITERATIONS, PATIENT)
    if near:
        return [last]
    windows = windows and not WHOLE & set(objective.weights)
    lengths = window_lengths(first_window(objective), whole) if windows else [whole]
    patience = STAGE_PATIENCE if is_long(search) else PATIENT
    parts = [loosened(objective, frames) for frames in lengths[:-1]]
    found = [Stage(part, least_saving(search, part), WINDOW_ITERATIONS, patience) for part in parts]
    if objective.tolerance < STAGE_TOLERANCE and is_long(search):
        found.append(Stage(loosened(objective, whole), LOOSE_SAVING, WHOLE_ITERATIONS, STAGE_PATIENCE))
    return [*found, last]


def least_saving(search: Search, part: Objective) -> float:
    """The saving, relative to the cost, that ends a window: no less than fitting its noise saves."""
    residuals = Trajectory(search, part).residuals()
    return max(WINDOW_SAVING, min(float(search.fitted.sum()) / max(residuals, 1), NOISE_SAVING))


def first_window(objective: Objective) -> int:
    """Frames of the first window: some after the first that shows anything."""
    return objective.first_step + FIRST_WINDOW


def first_frames(objective: Objective) -> Objective:
    """The objective over the first window, solved loosely."""
    return loosened(objective, first_window(objective))


def window_lengths(frames: int, last: int, growth: float = WINDOW_GROWTH) -> list[int]:
    """Frames of each window, from the first to the last, which is whole; each is `growth` times the one before."""
    lengths = []
    while frames < 0.8 * last:
        lengths.append(frames)
        frames = max(int(frames * growth), frames + 1)
    return [*lengths, last]


def loosened(objective: Objective, frames: int) -> Objective:
    """The objective over some frames, its linear systems solved as where the motion is still far from the target's."""
    return objective.until(frames, max(STAGE_TOLERANCE, objective.tolerance))


def is_long(search: Search) -> bool:
    """Whether a fit takes so long that it saves time."""
    return search.objective.observations >= LONG_POSITIONS


def is_near(search: Search, cost: float | None = None) -> bool:
    """Whether a cost, by default that of the best point, means that the motion is nearly the target's."""
    best = search.best.cost if cost is None else cost
    return bool(np.isfinite(best)) and best < NEAR_ERROR**2 * search.objective.cost_at_rest


def is_near_but_for_noise(search: Search) -> bool:
    """The same of the best point, without the part of its cost that is noise, which takes a simulation to tell."""
    return is_near(search) or (bool(np.isfinite(search.best.cost)) and is_near(search, beside_noise(search)))


def is_far(search: Search) -> bool:
    """Whether the best point is so far from the target that the model cannot reproduce it."""
    return search.best.cost > FAR_ERROR**2 * search.objective.cost_at_rest
